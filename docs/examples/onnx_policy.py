"""A policy in an ONNX file as a controller, and a toy: spring and damper at every joint in one linear layer.

    cd docs/examples
    python onnx_policy.py toy.onnx
    ampm validate normal --controller onnx_policy:OnnxPolicy --set controller.options.file=toy.onnx

It needs the packages onnx and onnxruntime. A policy that was trained in ``validation.environment`` is
exported the same way: one input (the observation in one row, float32), one output (the action in one row).
"""

import sys

import numpy as np

from ampm.walk import ControlOutput
from validation.trial.policy import observe


class OnnxPolicy:
    """Controller whose action is a share of every motor's largest torque.

    Args:
        robot: the body.
        run: unused.
        file: ONNX file.
    """

    def __init__(self, robot, run, file):
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # equal bits on any machine
        self.session = onnxruntime.InferenceSession(file, options, ["CPUExecutionProvider"])
        self.input = self.session.get_inputs()[0].name
        self.limit = robot.torque_limit

    def update(self, state, touch, reference):
        """One tick."""
        observation = np.concatenate([*observe(state, touch, reference).values()])
        action = self.session.run(None, {self.input: observation[None].astype(np.float32)})[0][0]
        return ControlOutput(self.limit * np.clip(action.astype(np.float64), -1.0, 1.0))


def main(path: str, stiffness: float = 5.0, damping: float = 0.2) -> None:
    """Write the toy for the default body; gains are shares of the largest torque [1/rad, s/rad]."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    from validation import environment

    env = environment.load("normal", gait={"steps": 1})
    sizes = {name: spec.shape[0] for name, spec in env.observation_spec().items()}
    starts = dict(zip(sizes, np.cumsum([0, *sizes.values()]), strict=False))
    motors, inputs = env.action_spec().shape[0], sum(sizes.values())
    weights = np.zeros((inputs, motors), dtype=np.float32)
    for name, gain in (("posture_error", stiffness), ("rate_error", damping)):
        weights[starts[name] : starts[name] + motors] = gain * np.eye(motors)
    layer = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
        "toy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, motors])],
        [numpy_helper.from_array(weights, "weights")],
    )
    onnx.save(helper.make_model(layer, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)


if __name__ == "__main__":
    main(sys.argv[1])

"""A toy policy in an ONNX file: a spring and a damper at every joint, as one linear layer.

    python docs/examples/toy_policy.py toy.onnx
    ampm validate normal --controller onnx:toy.onnx

It needs the package onnx. A policy that was trained in ``validation.environment`` is exported the same way:
one input (the observation in one row, float32), one output (the action in one row).
"""

import sys

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from validation import environment


def main(path: str, stiffness: float = 5.0, damping: float = 0.2) -> None:
    """Write the policy for the default body; gains are shares of the largest torque [1/rad, s/rad]."""
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
    main(*sys.argv[1:])

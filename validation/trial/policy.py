"""Policies: from an observation of one tick to an action, a share of every motor's largest torque.

:func:`observe` is the observation of :mod:`validation.environment`, so a policy that was trained there can be
the controller of a trial: :class:`OnnxPolicy`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError
from ampm.walk import ControlOutput, Reference, State, Touch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.parameters import RunParameters
    from ampm.walk import Controller

    Array = NDArray[np.float64]


def observe(state: State, touch: Touch, reference: Reference) -> dict[str, Array]:
    """What a policy observes of one tick: name to vector.

    - ``posture_error`` [rad], ``rate_error`` [rad/s]: of the joints, plan minus state, shape (nu,);
    - ``joints`` [rad], ``rates`` [rad/s]: of the joints, shape (nu,);
    - ``root_error``: of its position, plan minus state, world, shape (3,) [m];
    - ``orientation``: quaternion x, y, z, w of the root, shape (4,);
    - ``root_rate``: linear and angular velocity in root axes, shape (6,) [m/s, rad/s];
    - ``contact``: sole points that touch, shape (P,); ``planned_contact``: groups in contact, shape (6,);
    - ``planned_velocity`` [m/s], ``planned_acceleration`` [m/s^2]: of the COM, world, shape (3,).
    """
    plan = reference.posture
    return {
        "posture_error": plan.q[7:] - state.q[7:],
        "rate_error": plan.v[6:] - state.v[6:],
        "joints": state.q[7:].copy(),
        "rates": state.v[6:].copy(),
        "root_error": plan.q[:3] - state.q[:3],
        "orientation": state.q[3:7].copy(),
        "root_rate": state.v[:6].copy(),
        "contact": touch.contact.astype(np.float64),
        "planned_contact": reference.contacts.planned.astype(np.float64).ravel(),
        "planned_velocity": reference.com_velocity.copy(),
        "planned_acceleration": reference.com_acceleration.copy(),
    }


class OnnxPolicy:
    """Makes controllers of a policy in an ONNX file.

    The model has one input, the observation as float32 in one row, in the order of :func:`observe`. Its first
    output is the action in one row.

    Args:
        path: of the file.

    Raises:
        InputError: there is no such file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(
                f"there is no policy {str(path)!r}; give an ONNX file, for example onnx:policy.onnx."
            )

    def __call__(self, robot: Robot, run: RunParameters) -> Controller:
        """A controller of the policy."""
        return _PolicyController(self.path, robot.torque_limit)


class _PolicyController:
    """The policy as a controller."""

    def __init__(self, path: Path, limit: Array) -> None:
        try:
            import onnxruntime  # of the extra "policy"
        except ImportError:
            raise InputError(
                "a policy in an ONNX file needs onnxruntime; install the extra 'policy': pip install "
                "'ampm[policy]'."
            ) from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = (
            1  # the same bits on any number of cores
        )
        self.session: Any = onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
        self.input = self.session.get_inputs()[0].name
        self.limit = limit

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick."""
        observation = np.concatenate([*observe(state, touch, reference).values()])
        action = self.session.run(None, {self.input: observation[None].astype(np.float32)})[0][0]
        return ControlOutput(self.limit * np.clip(action.astype(np.float64), -1.0, 1.0))

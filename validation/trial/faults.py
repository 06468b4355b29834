"""Faults of motors, and a start beside the plan."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ampm.geometry import Array

if TYPE_CHECKING:
    from ampm.parameters import DisturbanceParameters, RunParameters
    from ampm.walk import ControlOutput


class MotorFaults:
    """Motors that act late and with a bias; controllers get no information on it.

    Args:
        run: its section ``disturbance``, and the control frequency.
        torque_limit: of the motors, shape (nu,) [N m].
    """

    def __init__(self, run: RunParameters, torque_limit: Array) -> None:
        fault, self._limit = run.disturbance, torque_limit
        signs = np.random.default_rng([fault.seed, 1])
        self._bias = fault.torque_bias * signs.choice([-1.0, 1.0], len(torque_limit))
        late = fault.ticks_late(run.controller.frequency)
        self._commanded: deque[tuple[Array, Array | None]] = deque(maxlen=1 + late)

    def act(self, output: ControlOutput) -> ControlOutput:
        """The output of a tick, with the torques that act in it."""
        rate = None if output.rate is None else np.array(output.rate)
        self._commanded.append((np.array(output.torque), rate))
        torque, rate = self._commanded[0]
        if self._bias.any():
            torque = np.clip(torque + self._bias, -self._limit, self._limit)
        return output._replace(torque=torque, rate=rate)


def started(velocity: Array, fault: DisturbanceParameters) -> Array:
    """Velocities at the start of a walk, shape (nv,): the plan's, with an error of the root's [m/s]."""
    if not fault.start_velocity:
        return velocity
    error = np.zeros(len(velocity))
    error[:3] = fault.start_velocity * np.random.default_rng([fault.seed, 2]).standard_normal(3)
    return velocity + error

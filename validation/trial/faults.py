"""Faults of motors, and a start beside the plan."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ampm.walk import ControlOutput, Reference, State, Touch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.parameters import DisturbanceParameters, RunParameters
    from ampm.walk import Controller

    Array = NDArray[np.float64]


class FaultyController:
    """A controller of faulty motors, which gets no information on their faults.

    Args:
        controller: of them.
        run: its section ``disturbance``, and the control frequency.
        robot: limits of its motors.
    """

    def __init__(self, controller: Controller, run: RunParameters, robot: Robot) -> None:
        fault = run.disturbance
        self.controller, self.fault = controller, fault
        signs = np.random.default_rng([fault.seed, 1])
        self._limit = robot.torque_limit
        self._bias = fault.torque_bias * signs.choice([-1.0, 1.0], robot.nu)
        late = fault.ticks_late(run.controller.frequency)
        self._commanded: deque[tuple[Array, Array | None]] = deque(maxlen=1 + late)

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick: the controller's; the torques are those that act."""
        output = self.controller.update(state, touch, reference)
        rate = None if output.rate is None else np.array(output.rate)
        self._commanded.append((np.array(output.torque), rate))
        torque, rate = self._commanded[0]
        if self.fault.torque_bias:
            torque = np.clip(torque + self._bias, -self._limit, self._limit)
        return output._replace(torque=torque, rate=rate)


def started(velocity: Array, fault: DisturbanceParameters) -> Array:
    """Velocities at the start of a walk, shape (nv,): the plan's, with an error of the root's [m/s]."""
    if not fault.start_velocity:
        return velocity
    error = np.zeros(len(velocity))
    error[:3] = fault.start_velocity * np.random.default_rng([fault.seed, 2]).standard_normal(3)
    return velocity + error


def behind_faults(controller: Controller, run: RunParameters, robot: Robot) -> Controller:
    """The controller, behind the faults of the run if there are any."""
    fault = run.disturbance
    if not (fault.actuation_delay or fault.torque_bias):
        return controller
    return FaultyController(controller, run, robot)

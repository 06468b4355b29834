"""Faults between a body and its controller: delay, noise, bias, and a start beside the plan."""

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

_ROOT = 6  # velocities of the free root, which joint sensors do not measure


class FaultyController:
    """A controller behind faulty sensors and motors, which gets no information on their faults.

    Args:
        controller: behind them.
        run: its section ``disturbance``, and the control frequency.
        robot: limits of its motors.
    """

    def __init__(self, controller: Controller, run: RunParameters, robot: Robot) -> None:
        fault = run.disturbance
        self.controller, self.fault = controller, fault
        random, signs = (np.random.default_rng([fault.seed, stream]) for stream in range(2))
        self._random, self._limit = random, robot.torque_limit
        self._bias = fault.torque_bias * signs.choice([-1.0, 1.0], robot.nu)
        sensing, actuation = fault.delays(run.controller.frequency)
        self._sensed: deque[tuple[Array, Array, Touch]] = deque(maxlen=1 + sensing)
        self._commanded: deque[tuple[Array, Array | None]] = deque(maxlen=1 + actuation)

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick: the controller's, from what is sensed; the torques are those that act."""
        fault, random = self.fault, self._random
        q, v = state.q.copy(), state.v.copy()
        if fault.angle_noise:
            q[_ROOT + 1 :] += fault.angle_noise * random.standard_normal(len(q) - _ROOT - 1)
        if fault.rate_noise:
            v[_ROOT:] += fault.rate_noise * random.standard_normal(len(v) - _ROOT)
        sensed = touch._replace(contact=touch.contact.copy(), normal_force=touch.normal_force.copy())
        self._sensed.append((q, v, sensed))
        q, v, touch = self._sensed[0]
        output = self.controller.update(state._replace(q=q.copy(), v=v.copy()), touch, reference)
        rate = None if output.rate is None else np.array(output.rate)
        self._commanded.append((np.array(output.torque), rate))
        torque, rate = self._commanded[0]
        if fault.torque_bias:
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
    names = ("sensing_delay", "actuation_delay", "angle_noise", "rate_noise", "torque_bias")
    if not any(getattr(fault, name) for name in names):
        return controller
    return FaultyController(controller, run, robot)

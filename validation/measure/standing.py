"""Weigh the body: the floor and the instrument of the walk, but standing still.

A still body presses on the floor with exactly its weight, under its COM. Every run weighs its own body on its
own floor, so that an instrument that is off is found before its figures are believed. The controller's gains
are not the run's but the default ones: how fast a body comes to rest is not what is asked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.body.inverse_kinematics import InverseKinematics, StepReference, Unreachable
from ampm.body.robot import TASK_ROWS, Robot
from ampm.control.controller import TrackingController
from ampm.control.reference import TrackingReference
from ampm.exceptions import BodilyRefusal
from ampm.parameters import ControllerParameters
from validation.measure.measure import StandingCheck, measure, standing_check
from validation.trial.bridge import to_pinocchio
from validation.trial.record import OutcomeName
from validation.trial.simulate import ClosedLoop, Physics

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import RunParameters
    from models.human import BodyModel
    from validation.trial.record import SimulationRecord

DURATION = 2.0
"""How long the body stands [s]."""

SETTLE = 1.5
"""Time in which contacts and controller come to rest before the body is weighed [s]."""

_KNEE = 0.6  # bend of the knees from which the posture is sought [rad]


def stand(run: RunParameters, body_model: BodyModel, *, duration: float = DURATION) -> SimulationRecord:
    """Let the body stand on both flat feet, the COM over their middle, and record it.

    Args:
        run: body, contact, controller, simulation and solver parameters; of the gait only the COM's height
            and the lateral distance of the feet.
        body_model: the body.
        duration: [s].

    Raises:
        BodilyRefusal: the body cannot stand with its COM at that height.
    """
    physics = Physics(body_model, run)
    robot = physics.robot
    com = np.array([0.0, 0.0, run.gait.com_height])
    feet = 0.5 * run.gait.step_width * np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    q = _posture(robot, run, com, feet)
    total = round(duration / physics.time_step)
    ticks = np.arange(0, total, physics.substeps, dtype=np.float64) * physics.time_step
    reference = _still(robot, ticks, q, com, feet)
    controller = TrackingController(robot, reference, run, velocity_lag=0.5 * physics.time_step)
    start = q.copy()
    start[2] -= run.simulation.start_depth
    physics.place(start, np.zeros(robot.nv))
    return ClosedLoop(physics, controller, run, duration, total, None).run()


def weigh(run: RunParameters, body_model: BodyModel, robot: Robot) -> StandingCheck:
    """Weigh the still body with the instrument that measures the walk.

    Args:
        run: parameters of the walk.
        body_model: its body.
        robot: the same body, for Pinocchio's side of the measurement.
    """
    own = run.controller
    gains = ControllerParameters(frequency=own.frequency, friction=own.friction)
    record = stand(run.model_copy(update={"controller": gains}), body_model)
    if record.outcome.name is OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    # A body that falls is weighed as it is: not still.
    settle = SETTLE if record.outcome.completed else 0.5 * record.outcome.time
    return standing_check(measure(record, robot.model, to_pinocchio), settle=settle)


def _posture(
    robot: Robot, run: RunParameters, com: NDArray[np.float64], feet: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Upright configuration with the COM and both soles in place, shape (nq,)."""
    ik = InverseKinematics(robot, run)
    still = np.zeros((1, TASK_ROWS))
    reference = StepReference(
        time=np.zeros(1),
        position=np.concatenate([com[None], feet])[None],
        velocity=still,
        acceleration=still.copy(),
        pitch=np.zeros((1, 2)),
        toe=np.zeros((1, 2)),
    )
    q = pin.neutral(robot.model)
    q[7:] = ik.rest
    q[robot.knee_joints + 1] = _KNEE
    q[:3] += com - robot.jacobian(q, np.zeros(robot.nv)).com
    try:
        return ik.upright(reference, 0, q)
    except Unreachable as error:
        raise BodilyRefusal(
            f"the body cannot stand with its COM at gait.com_height = {run.gait.com_height:g} m",
            reason="leg_too_short",
            value=run.gait.com_height,
            limit=robot.description.hip_height,
            unit="m",
            way_out="lower gait.com_height",
        ) from error


def _still(
    robot: Robot,
    ticks: NDArray[np.float64],
    q: NDArray[np.float64],
    com: NDArray[np.float64],
    feet: NDArray[np.float64],
) -> TrackingReference:
    """A reference that stays where it is."""
    n = len(ticks)
    robot.jacobian(q, np.zeros(robot.nv))
    trunk = robot.rotation_of(robot.trunk_frame)

    def held(value: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.repeat(value[None], n, axis=0)

    def nothing(*shape: int) -> NDArray[np.float64]:
        return np.zeros((n, *shape))

    contact = np.ones((n, 2, 3), dtype=bool)
    return TrackingReference(
        time=ticks,
        com=held(com),
        com_velocity=nothing(3),
        com_acceleration=nothing(3),
        angular_momentum=nothing(3),
        moment=nothing(3),
        foot_position=held(feet),
        foot_velocity=nothing(2, 3),
        foot_acceleration=nothing(2, 3),
        pitch=nothing(2),
        pitch_velocity=nothing(2),
        pitch_acceleration=nothing(2),
        toe=nothing(2),
        toe_velocity=nothing(2),
        toe_acceleration=nothing(2),
        contact=contact,
        due=contact.copy(),
        until_lift=np.full((n, 2, 3), np.inf),
        right_load=np.full(n, 0.5),
        q=held(q),
        v=nothing(robot.nv),
        acceleration=nothing(robot.nv),
        trunk=held(trunk.copy()),
    )

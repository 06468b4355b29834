"""A body that stands still: what diverges here does so before any walk, for reasons of body or time step."""

from itertools import repeat

import numpy as np

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.return_map import standing
from ampm.body.robot import Robot
from ampm.body.step_reference import StepReference
from ampm.control.controller import TrackingController
from ampm.exceptions import BodilyRefusal
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.feet import TIP
from ampm.walk import Reference
from validation.trial.physics import Physics
from validation.trial.plan import Body
from validation.trial.record import SimulationRecord
from validation.trial.references import Course
from validation.trial.simulate import ClosedLoop


def stand(run: RunParameters, body: Body, duration: float) -> SimulationRecord:
    """Let the body stand on both flat feet, the COM over their middle, and record it.

    Args:
        run: body, contact, controller, simulation and solver parameters; of the gait only the COM's height
            and the lateral distance of the feet.
        body: that stands.
        duration: how long it stands [s].

    Raises:
        BodilyRefusal: the body cannot stand with its COM at that height.
    """
    physics = Physics(body, run)
    robot = physics.robot
    com = np.array([0.0, 0.0, run.gait.com_height])
    feet = 0.5 * run.gait.step_width * np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    q = _posture(robot, run, np.vstack([com, feet]))
    still = np.zeros(robot.nv)
    contact = np.ones((2, 3), dtype=bool)
    contact[:, TIP] = robot.description.sole.has_toes
    reference = Reference.of(
        time=0.0,
        com=com,
        right_load=0.5,
        foot_position=feet,
        foot_rotation=np.stack([np.eye(3), np.eye(3)]),
        planned=contact,
        due=contact,
        until_lift=np.inf,
        q=q,
        v=still,
        trunk=robot.trunk_rotations(q[None])[0],
    )
    start = q.copy()
    start[2] -= run.simulation.start_depth
    physics.place(start, still)
    controller, steps = TrackingController(robot, run), round(duration / physics.time_step)
    course = Course(steps, np.array([duration]), repeat(reference))
    return ClosedLoop(physics, controller, course, run).run()


def _posture(robot: Robot, run: RunParameters, places: Array) -> Array:
    """Upright configuration with COM and both soles in their places, shape (3, 3) [m]; shape (nq,)."""
    ik, still = InverseKinematics(robot, run), np.zeros((1, robot.task_rows))
    level = np.tile(np.eye(3), (1, 2, 1, 1))
    reference = StepReference(np.zeros(1), places[None], level, np.zeros((1, 2)), still, still)
    try:
        return ik.upright(reference, 0, standing(ik, reference))
    except Unreachable as error:
        raise BodilyRefusal(
            f"the body cannot stand with its COM at gait.com_height = {run.gait.com_height:g} m",
            reason="leg_too_short",
            value=run.gait.com_height,
            limit=robot.description.hip_height,
            unit="m",
            way_out="lower gait.com_height",
        ) from error

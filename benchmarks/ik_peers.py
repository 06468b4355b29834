"""One step of differential inverse kinematics by pink and mink, on the tasks of ours."""

import time
import timeit
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.robot import Robot
from ampm.body.step_kinematics import StepTrajectory
from ampm.body.step_reference import StepReference, step_grid, step_reference
from ampm.geometry import Array
from ampm.planner.support import plan_steps
from benchmarks.peer import Peer
from validation.progress import Progress
from validation.trial.coordinates import to_mujoco, to_pinocchio
from validation.trial.plan import PlannedWalk

TASK, TRUNK, POSTURE = 1.0, 0.1, 1e-3
"""Costs of feet and COM, and of the first orientation of the trunk and the first posture."""
_DAMPING = 1e-9  # of the velocities, for QPs that are positive definite
_ROUNDS = 3  # equal passes over the step, of which the least times count


Move = Callable[[Array, Array, Array, float], None]
"""One time step [s] towards targets in world: COM (3,) [m], both soles (2, 3) [m], and their rotations."""
Follower = tuple[Move, Callable[[], Array]]
"""A library with one body: its time step, and the configuration in Pinocchio's coordinates, shape (nq,)."""


def pink_follower(planned: PlannedWalk, q: Array) -> Follower:
    """Pink on the Pinocchio model of the robot, from a first configuration (nq,)."""
    import pink  # an optional package

    robot = planned.body.robot
    frames = robot.model.frames
    feet = [pink.tasks.FrameTask(frames[frame].name, TASK, TASK) for frame in robot.sole_frames]
    com, posture = pink.tasks.ComTask(TASK), pink.tasks.PostureTask(POSTURE)
    trunk = pink.tasks.FrameTask(frames[robot.trunk_frame].name, 0.0, TRUNK)
    configuration = pink.Configuration(robot.model, robot.model.createData(), q)
    for task in (trunk, posture):
        task.set_target_from_configuration(configuration)
    tasks = [*feet, com, trunk, posture]

    def move(place: Array, sole: Array, turn: Array, time_step: float) -> None:
        for foot, task in enumerate(feet):
            task.set_target(pin.SE3(turn[foot], sole[foot]))
        com.set_target(place)
        v = pink.solve_ik(configuration, tasks, time_step, "daqp", damping=_DAMPING)
        configuration.integrate_inplace(v, time_step)

    return move, lambda: np.array(configuration.q)


def mink_follower(planned: PlannedWalk, q: Array) -> Follower:
    """Mink on the MuJoCo model of the body, from a first configuration (nq,)."""
    import mink  # an optional package

    robot, model = planned.body.robot, planned.body.model.compile()
    still, body = np.zeros(robot.nv), robot.description
    configuration = mink.Configuration(model, q=to_mujoco(q, still)[0])
    feet = [mink.FrameTask(leg.sole_frame, "site", TASK, TASK) for leg in body.legs]
    com, posture = mink.ComTask(TASK), mink.PostureTask(model, POSTURE)
    trunk = mink.FrameTask(body.trunk_segment, "body", 0.0, TRUNK)
    for task in (trunk, posture):
        task.set_target_from_configuration(configuration)
    tasks = [*feet, com, trunk, posture]

    def move(place: Array, sole: Array, turn: Array, time_step: float) -> None:
        for foot, task in enumerate(feet):
            rotation = mink.SO3.from_matrix(turn[foot])
            task.set_target(mink.SE3.from_rotation_and_translation(rotation, sole[foot]))
        com.set_target(place)
        v = mink.solve_ik(configuration, tasks, time_step, "daqp", damping=_DAMPING)
        configuration.integrate_inplace(v, time_step)

    return move, lambda: to_pinocchio(configuration.q, still)[0]


FOLLOWERS = {"pink": pink_follower, "mink": mink_follower}
"""Libraries by the name of their module."""
DISTRIBUTIONS = {"pink": "pin-pink", "mink": "mink"}


def compare_kinematics(planned: PlannedWalk, progress: Progress) -> list[Peer]:
    """Ticks of our inverse kinematics, which also keeps the angular momentum, and of the others."""
    run, robot = planned.run, planned.body.robot
    steps = plan_steps(run.gait, run.body.mass, run.foot, robot.description.sole)
    offset = planned.motion.report.angular_momentum_y_offset / robot.mass
    reference = step_reference(steps, step_grid(steps, run.solver.ik_time_step))
    reference = reference.with_angular_momentum((0.0, offset))
    with progress.stage("inverse kinematics"):
        seconds, step = time_ik(planned, reference)
    peers = [Peer.of("ours", np.array(seconds), error_text(robot, reference, step.q))]
    for name, library in FOLLOWERS.items():
        with progress.stage(f"inverse kinematics by {name}"):
            try:
                spans, q = follow(library, planned, reference)
            except ImportError as error:
                peers.append(Peer.missing(name, error))
                continue
        peers.append(Peer.of(name, spans, error_text(robot, reference, q), DISTRIBUTIONS[name]))
    return peers


def time_ik(planned: PlannedWalk, reference: StepReference) -> tuple[list[float], StepTrajectory]:
    """Mean time of a tick over one step of the inverse kinematics [s], once per pass, and the step.

    A tick is drift correction, accelerations and integration; all ticks of a step are one compiled loop.
    """
    kinematics, motion = InverseKinematics(planned.body.robot, planned.run), planned.motion

    def walk() -> StepTrajectory:
        return kinematics.integrate(reference, motion.q[0], motion.v[0])

    ticks = len(reference.time) - 1
    rounds = timeit.repeat(walk, setup=walk, number=1, repeat=_ROUNDS)  # the setup is not counted
    return [seconds / ticks for seconds in rounds], walk()


def follow(
    library: Callable[[PlannedWalk, Array], Follower], planned: PlannedWalk, reference: StepReference
) -> tuple[Array, Array]:
    """Times of the n ticks, shape (n,) [s], and configurations, shape (n + 1, nq).

    Raises :class:`ImportError` if the library is not installed.
    """
    start, steps = planned.motion.q[0], np.diff(reference.time)
    rounds = []
    for _ in range(_ROUNDS):
        move, configuration = library(planned, start)
        spans, q = [], [start]
        for k, time_step in enumerate(steps.tolist(), start=1):
            com, sole = reference.position[k, 0], reference.position[k, 1:]
            begin = time.perf_counter()
            move(com, sole, reference.rotation[k], time_step)
            spans.append(time.perf_counter() - begin)
            q.append(configuration())
        rounds.append(spans)
    return np.min(rounds, axis=0), np.stack(q)


def error_text(robot: Robot, reference: StepReference, q: Array) -> str:
    """Largest distance of COM and soles from their targets, for configurations of shape (n + 1, nq)."""
    com = sole = 0.0
    for configuration, target in zip(q, reference.position, strict=True):
        terms = robot.jacobian(configuration)
        com = max(com, float(np.linalg.norm(terms.com - target[0])))
        sole = max(sole, float(np.linalg.norm(terms.sole - target[1:], axis=1).max()))
    return f"COM {1e3 * com:.1g} mm, soles {1e3 * sole:.1g} mm"

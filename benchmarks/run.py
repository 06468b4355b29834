"""All benchmarks of one gait and their results."""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ampm.body.feasibility import check_body
from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.motion import WholeBodyMotion
from ampm.body.orbit import solve_motion
from ampm.body.robot import Robot
from ampm.body.step_kinematics import StepTrajectory
from ampm.body.step_reference import step_grid, step_reference
from ampm.parameters import RunParameters
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from ampm.planners import periodic_walk
from benchmarks.clock import Line, Samples, repeat
from benchmarks.recording import time_recording
from benchmarks.walking import time_walk
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.machine import THREAD_VARIABLES, memory_peak
from validation.trial.plan import load_request, make_body

_PLANS = 200  # how often a plan is made
_STEPS = 5  # how often a step of the inverse kinematics is integrated


@dataclass(frozen=True)
class BenchmarkResult:
    """Everything that was timed.

    Attributes:
        gait: name of the gait.
        settings: what was changed of it.
        steps: walking steps.
        sections: lines by heading: what is done once, walks by QP solver, a trial with its recording.
        memory_peak: largest resident memory of the process [MB].
        threads: limits of the numerical libraries' threads by environment variable.
        load: load of the machine at the start, mean of the last minute [1]; above 1, other processes took
            time.
        environment: versions, processor, revision.
    """

    gait: str
    settings: tuple[str, ...]
    steps: int
    sections: dict[str, list[Line]]
    memory_peak: float | None
    threads: dict[str, str | None]
    load: float
    environment: dict[str, Any]


def run_benchmarks(
    gait: str, settings: Sequence[str], *, steps: int, walks: int, solvers: Sequence[str], progress: Progress
) -> BenchmarkResult:
    """Time planning, motion and closed loop of one gait.

    Args:
        gait: preset or TOML file.
        settings: ``key=value``, as for ``--set``.
        steps: walking steps.
        walks: equal walks of which the least time of every tick counts.
        solvers: QP solvers of the controller.
        progress: where to report stages.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the gait cannot be planned.
    """
    load = os.getloadavg()[0]
    settings_of = {name: [*settings, f"gait.steps={steps}", f"solver.qp={name}"] for name in solvers}
    requests = {name: load_request(gait, item) for name, item in settings_of.items()}
    first = requests[solvers[0]]
    run = first.run
    with progress.stage("body"):
        body = make_body(run)
    mass, sole = run.body.mass, body.model.description.sole
    with progress.stage("plan"):
        pure = repeat(lambda: plan_gait(run.gait, mass), _PLANS)
        with_feet = repeat(lambda: plan_steps(run.gait, mass, run.foot, sole), _PLANS)
    plan = plan_steps(run.gait, mass, run.foot, sole)
    check_body(plan, body.model.description)
    with progress.stage("periodic motion"):
        solve_motion(plan, run, body.robot)  # loads the compiled functions
        start = time.perf_counter()
        motion = solve_motion(plan, run, body.robot)
        orbit = time.perf_counter() - start
    with progress.stage("inverse kinematics"):
        ticks, _ = time_ik(run, body.robot, plan, motion)
    sections = {
        "once per gait": [
            Line.of("plan, closed form", pure),
            Line.of("plan with feet", with_feet),
            Line.of("periodic motion", orbit),
            Line.of("tick of the inverse kinematics", ticks),
        ]
    }
    whole = periodic_walk(plan, motion, body.robot)
    for solver, item in requests.items():
        with progress.stage(f"{walks} walks with {solver.upper()}", "steps") as stage:
            ending, lines = time_walk(whole, item.run, body.model, walks, stage.advance)
        sections[f"walk with {solver.upper()}, {ending}"] = lines
    with progress.stage(f"{walks} trials with their recording"):
        sections["trial in a process of its own"] = time_recording(run, walks)
    return BenchmarkResult(
        gait=first.name,
        settings=tuple(settings),
        steps=steps,
        sections=sections,
        memory_peak=memory_peak(),
        threads={name: os.environ.get(name) for name in THREAD_VARIABLES},
        load=load,
        environment=describe_environment(),
    )


def time_ik(
    run: RunParameters, robot: Robot, plan: StepPlan, motion: WholeBodyMotion
) -> tuple[Samples, StepTrajectory]:
    """Mean time of a tick over one step of the inverse kinematics [s], once per step, and the step.

    A tick is drift correction, accelerations and integration; all ticks of a step are one compiled loop.
    """
    kinematics = InverseKinematics(robot, run)
    offset = motion.report.angular_momentum_y_offset / robot.mass
    reference = step_reference(plan, step_grid(plan, run.solver.ik_time_step))
    reference = reference.with_angular_momentum_y(offset)

    def walk() -> StepTrajectory:
        return kinematics.integrate(reference, motion.q[0], motion.v[0])

    step, ticks = walk(), len(reference.time) - 1
    return [seconds / ticks for seconds in repeat(walk, _STEPS)], step

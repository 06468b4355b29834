"""Runs all benchmarks of one gait and collects what they found."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ampm.body.feasibility import check_body
from ampm.planner.support import plan_steps
from ampm.planners import periodic_walk
from ampm.qp import BACKENDS
from ampm.run_file import dump_run
from benchmarks.clock import Statistics
from benchmarks.planning import time_ik_tick, time_motion, time_plan
from benchmarks.recording import RecordingCost, time_recording
from benchmarks.walking import WalkBenchmark, WalkTiming
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.machine import THREAD_VARIABLES, memory_peak
from validation.trial.plan import load_request, make_body

DEFAULT_STEPS = 30
DEFAULT_WALKS = 3


@dataclass(frozen=True)
class BenchmarkResult:
    """Everything that was timed; times in seconds.

    Attributes:
        gait: name of the gait.
        settings: what was changed of it.
        steps: walking steps.
        plan: one plan, the closed form alone.
        plan_with_feet: one plan with the feet's motion.
        orbit: the search for the periodic motion, without a cache.
        ik_tick: one tick of the inverse kinematics.
        walks: by QP solver.
        recording: what the recording of a trial with the first solver costs.
        memory_peak: largest resident memory of the process [MB].
        threads: limits of the numerical libraries' threads by environment variable.
        load: processes that ran at the start, mean of the last minute [1]; above 1, others took time.
        environment: versions, processor, revision.
    """

    gait: str
    settings: tuple[str, ...]
    steps: int
    plan: Statistics
    plan_with_feet: Statistics
    orbit: Statistics
    ik_tick: Statistics
    walks: dict[str, WalkTiming]
    recording: RecordingCost
    memory_peak: float | None
    threads: dict[str, str | None]
    load: float
    environment: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, times in s."""
        plain = asdict(self)
        plain["walks"] = {name: walk.as_dict() for name, walk in self.walks.items()}
        plain["recording"] = self.recording.as_dict()
        return {"unit": "s", **plain}


def run_benchmarks(
    gait: str = "normal",
    settings: Sequence[str] = (),
    *,
    steps: int = DEFAULT_STEPS,
    walks: int = DEFAULT_WALKS,
    solvers: Sequence[str] = BACKENDS,
    stages: Progress | None = None,
) -> BenchmarkResult:
    """Time planning, motion and closed loop of one gait.

    Args:
        gait: preset or TOML file.
        settings: ``key=value``, as for ``--set``.
        steps: walking steps.
        walks: equal walks of which the least time of every tick counts.
        solvers: QP solvers of the controller.
        stages: where to report progress.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the gait cannot be met.
    """
    stages = stages or Progress()
    load = os.getloadavg()[0]
    requests = {
        solver: load_request(gait, [*settings, f"gait.steps={steps}", f"solver.qp={solver}"])
        for solver in solvers
    }
    name, run = (first := next(iter(requests.values()))).name, first.run
    with stages.stage("body"):
        body = make_body(run)
    with stages.stage("plan"):
        pure, with_feet = time_plan(run, body)
    plan = plan_steps(run.gait, run.body.mass, run.foot, body.model.description.sole)
    check_body(plan, body.model.description)
    with stages.stage("periodic motion"):
        motion, orbit = time_motion(run, body.robot, plan)
    with stages.stage("inverse kinematics"):
        ik_tick = time_ik_tick(run, body.robot, plan, motion)
    whole, timed = periodic_walk(plan, motion, body.robot), {}
    for solver, item in requests.items():
        walk = WalkBenchmark(whole, item.run, body.model, steps=steps, walks=walks)
        with stages.stage(f"{2 * walks} walks with {solver.upper()}", "steps") as stage:
            timed[solver] = walk.time_all(stage.advance)
    with stages.stage(f"{walks} trials with their recording"), tempfile.TemporaryDirectory() as folder:
        run_file = Path(folder) / "gait.toml"
        run_file.write_text(dump_run(run), encoding="utf-8")
        recording = time_recording(run_file, rounds=walks)
    return BenchmarkResult(
        gait=name,
        settings=tuple(settings),
        steps=steps,
        plan=pure,
        plan_with_feet=with_feet,
        orbit=orbit,
        ik_tick=ik_tick,
        walks=timed,
        recording=recording,
        memory_peak=memory_peak(),
        threads={name: os.environ.get(name) for name in THREAD_VARIABLES},
        load=load,
        environment=describe_environment(),
    )

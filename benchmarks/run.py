"""Runs all benchmarks of one gait and collects what they found."""

from __future__ import annotations

import os
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ampm.body.feasibility import check_body
from ampm.planners import periodic_walk
from ampm.qp import BACKENDS
from ampm.run_file import dump_run
from benchmarks.clock import Statistics
from benchmarks.planning import MotionBenchmark, PlanBenchmark
from benchmarks.recording import RecordingCost, time_recording
from benchmarks.walking import WalkBenchmark, WalkTiming
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.trial.plan import Request, load_request, make_body

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
    memory_peak: float
    threads: dict[str, str | None]
    load: float
    environment: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "gait": self.gait,
            "settings": list(self.settings),
            "steps": self.steps,
            "unit": "s",
            "once": {
                "plan": self.plan.as_dict(),
                "plan_with_feet": self.plan_with_feet.as_dict(),
                "orbit": self.orbit.as_dict(),
                "ik_tick": self.ik_tick.as_dict(),
            },
            "walks": {name: walk.as_dict() for name, walk in self.walks.items()},
            "recording": self.recording.as_dict(),
            "memory_peak": {"value": self.memory_peak, "unit": "MB"},
            "threads": self.threads,
            "load": self.load,
            "environment": self.environment,
        }


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
    asked = {solver: _request(gait, settings, steps, solver) for solver in solvers}
    run = next(iter(asked.values())).run
    with stages.stage("body"):
        body = make_body(run)
    planning = PlanBenchmark(run, body)
    with stages.stage("plan"):
        plan_times = planning.time_pure(), planning.time_with_feet()
    plan = planning.with_feet()
    check_body(plan, body.model.description)
    motion = MotionBenchmark(run, body.robot, plan)
    with stages.stage("periodic motion"):
        orbit = motion.time_orbit()
    with stages.stage("inverse kinematics"):
        ik_tick = motion.time_tick()
    whole, timed = periodic_walk(plan, motion.motion, body.robot), {}
    for solver, item in asked.items():
        walk = WalkBenchmark(whole, item.run, body.model, steps=steps, walks=walks)
        with stages.stage(f"{2 * walks} walks with {solver.upper()}", "steps") as stage:
            timed[solver] = walk.time_all(stage.advance)
    with stages.stage(f"{walks} trials with their recording"), tempfile.TemporaryDirectory() as folder:
        run_file = Path(folder) / "gait.toml"
        run_file.write_text(dump_run(run), encoding="utf-8")
        recording = time_recording(run_file, rounds=walks)
    return BenchmarkResult(
        gait=next(iter(asked.values())).name,
        settings=tuple(settings),
        steps=steps,
        plan=plan_times[0],
        plan_with_feet=plan_times[1],
        orbit=orbit,
        ik_tick=ik_tick,
        walks=timed,
        recording=recording,
        memory_peak=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,  # Linux counts in KiB
        threads={name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")},
        load=load,
        environment=describe_environment(),
    )


def _request(gait: str, settings: Sequence[str], steps: int, solver: str) -> Request:
    return load_request(gait, [*settings, f"gait.steps={steps}", f"solver.qp={solver}"])

"""The walks of all levels, side by side, and what is followed through them."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from ampm.exceptions import AmpmError, InputError, RefusedGait
from validation.judge.metrics import METRICS, dump_added, evaluate, load_added
from validation.progress import Progress
from validation.store.machine import memory_peak, one_blas_thread
from validation.study.compare.metrics import SWITCH_UNITS, switch_values
from validation.study.convergence.studies import Level
from validation.trial.plan import Request

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from validation.judge.compare import Comparison
    from validation.judge.profiles import Profile

_PHASE_SIGNALS = {"zmp_x": "m", "zmp_y": "m", "force_x": "N", "force_y": "N", "force_z": "N"}
_PHASES = ("single_support", "double_support")
_SWITCH_EXTREMES = ("_peak", "_maximum", "_force_rate", "_vertical_force")


class Followed(NamedTuple):
    """What a study has to know of a quantity.

    Attributes:
        unit: SI unit.
        nature: as of a metric.
        self_check: whether it measures the error of the instrument: its dependence on the time step is what
            it measures, and no uncertainty of it.
    """

    unit: str
    nature: str = "mean"
    self_check: bool = False


def followed() -> dict[str, Followed]:
    """All that is followed: registered metrics, errors within one phase, quantities about the switches."""
    found = {
        name: Followed(metric.unit, metric.nature, metric.is_self_check) for name, metric in METRICS.items()
    }
    for signal, unit in _PHASE_SIGNALS.items():
        names = (*(f"{signal}_{phase}_rmse" for phase in _PHASES), f"{signal}_bias")
        found |= dict.fromkeys(names, Followed(unit))
    for name, unit in SWITCH_UNITS.items():
        extreme = name.endswith(_SWITCH_EXTREMES)
        found[f"switch_{name}"] = Followed(unit, "extreme" if extreme else "mean")
    return found


@dataclass(frozen=True)
class LevelResult:
    """The walk of one level.

    Attributes:
        outcome: of the walk, or ``refused``.
        cause: of an early end, empty if there is none.
        values: what is followed, in SI units; empty if nothing was walked.
        weight: of the body [N].
        seconds: wall-clock time.
        memory: largest resident memory of the process so far [MB], None where that is not known.
    """

    outcome: str
    cause: str
    values: Mapping[str, float]
    weight: float
    seconds: float
    memory: float | None

    @property
    def completed(self) -> bool:
        """Whether the walk came to its end."""
        return self.outcome == "completed"


def walk_level(run: RunParameters, name: str, profile: Profile) -> LevelResult:
    """Plan and walk one level; runs in a worker and returns numbers only."""
    from validation.run.walk import walk_planned  # here and below, not above: simulator and Pinocchio
    from validation.trial.plan import plan_walk

    start = time.perf_counter()
    try:
        result = walk_planned(plan_walk(Request(name, run)), profile)
    except AmpmError as error:
        outcome = "refused" if isinstance(error, RefusedGait | InputError) else "infeasible"
        return LevelResult(outcome, str(error), {}, 0.0, time.perf_counter() - start, memory_peak())
    comparison, end = result.evaluation.comparison, result.record.outcome
    return LevelResult(
        outcome=str(end.name),
        cause=end.cause,
        values=values_of(comparison),
        weight=comparison.scales["body_weight"],
        seconds=time.perf_counter() - start,
        memory=memory_peak(),
    )


def values_of(comparison: Comparison) -> dict[str, float]:
    """Value of everything that is followed, in SI units."""
    values = {name: metric.value for name, metric in evaluate(comparison).items()}
    for name in _PHASE_SIGNALS:
        signal = comparison.signals[name]
        values |= {f"{name}_{phase}_rmse": signal.windows[phase].rmse for phase in _PHASES}
        values[f"{name}_bias"] = signal.run.bias
    if comparison.record.outcome.completed:
        values |= {f"switch_{name}": value for name, value in switch_values(comparison).items()}
    return values


Runner = Callable[["RunParameters", str, "Profile"], LevelResult]
"""What walks one level; tests put their own in its place."""


def walk_levels(
    runs: Mapping[Level, RunParameters],
    name: str,
    profile: Profile,
    *,
    workers: int = 2,
    progress: Progress | None = None,
    runner: Runner = walk_level,
) -> dict[Level, LevelResult]:
    """Walk every level.

    Args:
        runs: level to its complete parameters.
        name: of the gait.
        profile: of the tolerances.
        workers: processes; one walks in this very process.
        progress: where to report it.
        runner: what walks one level; with more than one worker, it must be importable.
    """
    done: dict[Level, LevelResult] = {}
    with (progress or Progress()).stage(f"{name}: convergence", "walks") as stage:
        if workers == 1:
            for key, run in runs.items():
                done[key] = runner(run, name, profile)
                stage.advance(len(done), len(runs))
            return done
        one_blas_thread()
        # Workers are started afresh: a fork would share the state of compiled libraries.
        context = multiprocessing.get_context("spawn")
        others = set(multiprocessing.active_children())
        with ProcessPoolExecutor(
            min(workers, len(runs)), context, initializer=load_added, initargs=(dump_added(),)
        ) as pool:
            tasks = {pool.submit(runner, run, name, profile): key for key, run in runs.items()}
            try:
                for task in as_completed(tasks):
                    done[tasks[task]] = task.result()
                    stage.advance(len(done), len(runs))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in set(multiprocessing.active_children()) - others:
                    worker.terminate()  # a level under way is of no use to anybody
                raise
    return done

"""The walks of all levels, side by side, and the quantities studied through them."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from ampm.exceptions import AmpmError, InputError, RefusedGait
from validation.judge.compare import RUN
from validation.judge.metrics import METRICS, dump_added, evaluate, load_added
from validation.progress import Progress
from validation.store.machine import hidden_main, memory_peak, one_blas_thread
from validation.study.compare.metrics import SWITCH_UNITS, switch_values
from validation.trial.plan import Request

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from validation.judge.compare import Comparison

_PHASE_SIGNALS = {"zmp_x": "m", "zmp_y": "m", "force_x": "N", "force_y": "N", "force_z": "N"}
_PHASES = ("single_support", "double_support")
_SWITCH_EXTREMES = ("_peak", "_maximum", "_force_rate", "_vertical_force")


class StudiedQuantity(NamedTuple):
    """SI unit of a quantity, its nature and whether it is a self-check, all as of a metric."""

    unit: str
    nature: str = "mean"
    self_check: bool = False


def studied_quantities() -> dict[str, StudiedQuantity]:
    """All studied quantities: registered metrics, errors within one phase, quantities about the switches."""
    found = {
        name: StudiedQuantity(metric.unit, metric.nature, metric.is_self_check)
        for name, metric in METRICS.items()
    }
    for signal, unit in _PHASE_SIGNALS.items():
        names = (*(f"{signal}_{phase}_rmse" for phase in _PHASES), f"{signal}_bias")
        found |= dict.fromkeys(names, StudiedQuantity(unit))
    for name, unit in SWITCH_UNITS.items():
        extreme = name.endswith(_SWITCH_EXTREMES)
        found[f"switch_{name}"] = StudiedQuantity(unit, "extreme" if extreme else "mean")
    return found


@dataclass(frozen=True)
class LevelResult:
    """The walk of one level.

    Attributes:
        outcome: of the walk, or ``refused``, or ``infeasible``.
        cause: of an early end, empty if there is none.
        seconds: wall-clock time.
        memory: largest resident memory of the process so far [MB], None where that is not known.
        values: studied quantities, in SI units; empty if nothing was walked.
        weight: of the body [N].
    """

    outcome: str
    cause: str
    seconds: float
    memory: float | None
    values: Mapping[str, float]
    weight: float

    @property
    def completed(self) -> bool:
        """Whether the walk came to its end."""
        return self.outcome == "completed"


def walk_level(run: RunParameters, name: str) -> LevelResult:
    """Plan and walk one level; runs in a worker and returns numbers only."""
    from validation.run.walk import walk_planned  # here and below, not above: simulator and Pinocchio
    from validation.trial.plan import plan_walk

    start = time.perf_counter()
    values: Mapping[str, float] = {}
    weight = 0.0
    try:
        result = walk_planned(plan_walk(Request(name, run)))
        comparison, end = result.comparison, result.record.outcome
        outcome, cause = str(end.name), end.cause
        values, weight = values_of(comparison), comparison.scales["body_weight"]
    except AmpmError as error:
        outcome = "refused" if isinstance(error, RefusedGait | InputError) else "infeasible"
        cause = str(error)
    return LevelResult(outcome, cause, time.perf_counter() - start, memory_peak(), values, weight)


def values_of(comparison: Comparison) -> dict[str, float]:
    """Values of all studied quantities, in SI units."""
    values = {name: metric.value for name, metric in evaluate(comparison).items()}
    for name in _PHASE_SIGNALS:
        windows = comparison.signals[name]
        values |= {f"{name}_{phase}_rmse": windows[phase].rmse for phase in _PHASES}
        values[f"{name}_bias"] = windows[RUN].bias
    if comparison.record.outcome.completed:
        values |= {f"switch_{name}": value for name, value in switch_values(comparison).items()}
    return values


Runner = Callable[["RunParameters", str], LevelResult]
"""Function that walks one level; tests replace it."""


def walk_levels(
    runs: Iterable[RunParameters],
    name: str,
    *,
    workers: int = 2,
    progress: Progress | None = None,
    runner: Runner = walk_level,
) -> dict[RunParameters, LevelResult]:
    """Walk every level once.

    Args:
        runs: complete parameters of every level.
        name: of the gait.
        workers: processes; one walks in this very process.
        progress: where to report it.
        runner: what walks one level; with more than one worker, it must be importable.
    """
    # The finest steps last longest: begun first, they leave no worker idle at the end.
    order = sorted(
        dict.fromkeys(runs), key=lambda run: -1.0 / run.simulation.time_step - 1.0 / run.solver.ik_time_step
    )
    done: dict[RunParameters, LevelResult] = {}
    with (progress or Progress()).stage(f"{name}: convergence", "walks") as stage:
        if workers == 1:
            for run in order:
                done[run] = runner(run, name)
                stage.advance(len(done), len(order))
            return done
        one_blas_thread()
        # Workers are started afresh: a fork would share the state of compiled libraries.
        context = multiprocessing.get_context("spawn")
        others = set(multiprocessing.active_children())
        with ProcessPoolExecutor(
            min(workers, len(order)), context, initializer=load_added, initargs=(dump_added(),)
        ) as pool:
            with hidden_main():
                tasks = {pool.submit(runner, run, name): run for run in order}
            try:
                for task in as_completed(tasks):
                    done[tasks[task]] = task.result()
                    stage.advance(len(done), len(order))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in set(multiprocessing.active_children()) - others:
                    worker.terminate()  # a level under way is of no use to anybody
                raise
    return done

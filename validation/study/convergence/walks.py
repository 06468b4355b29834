"""The walks of all levels, in parallel, and the studied quantities."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ampm.exceptions import AmpmError, InputError, RefusedGait
from ampm.parameters import RunParameters
from validation.judge.compare import RUN, Comparison
from validation.judge.metrics import METRICS, evaluate
from validation.judge.signals import signals_table
from validation.progress import Progress
from validation.store.machine import memory_peak
from validation.store.signals import Signals
from validation.study.compare.metrics import SWITCH, switch_values
from validation.study.resumable import work_off
from validation.trial.plan import Request

_PHASE_SIGNALS = {"zmp_x": "m", "zmp_y": "m", "force_x": "N", "force_y": "N", "force_z": "N"}
_PHASES = ("single_support", "double_support")


class StudiedQuantity(NamedTuple):
    """SI unit of a quantity, its nature and whether it is a self-check, all as of a metric."""

    unit: str
    nature: str = "mean"
    is_self_check: bool = False


def studied_quantities() -> dict[str, StudiedQuantity]:
    """All studied quantities: registered metrics, errors within one phase, quantities about the switches."""
    found = {
        name: StudiedQuantity(metric.unit, metric.nature, metric.is_self_check)
        for name, metric in METRICS.items()
    }
    for signal, unit in _PHASE_SIGNALS.items():
        names = (*(f"{signal}_{phase}_rmse" for phase in _PHASES), f"{signal}_bias")
        found |= dict.fromkeys(names, StudiedQuantity(unit))
    for item in SWITCH:
        found[item.studied_name] = StudiedQuantity(
            item.si_unit(1.0)[1], "extreme" if item.extreme else "mean"
        )
    return found


def values_of(walk: Comparison) -> dict[str, float]:
    """Values of all studied quantities, in SI units."""
    values = {name: metric.value for name, metric in evaluate(walk).items()}
    for name in _PHASE_SIGNALS:
        windows = walk.signals[name]
        values |= {f"{name}_{phase}_rmse": windows[phase].rmse for phase in _PHASES}
        values[f"{name}_bias"] = windows[RUN].bias
    if walk.record.outcome.completed:
        table, weight = signals_table(walk), walk.record.mass * walk.record.gravity
        signals = Signals({name: table.column(name).to_numpy() for name in table.column_names})
        shown = switch_values(walk.plan, signals, walk.record)
        values |= {item.studied_name: item.si_unit(weight)[0] * shown[item.name] for item in SWITCH}
    return values


@dataclass(frozen=True)
class LevelResult:
    """The walk of one level.

    Attributes:
        outcome: of the walk, or ``refused``, or ``infeasible``.
        cause: of an early end, empty if there is none.
        seconds: wall-clock time.
        memory: largest resident memory of the process so far [MB], None where that is not known.
        values: studied quantities, in SI units; empty if nothing was walked.
        scales: reference quantities of the walk; none if it was not walked.
    """

    outcome: str
    cause: str
    seconds: float
    memory: float | None
    values: Mapping[str, float]
    scales: Mapping[str, float]

    @property
    def completed(self) -> bool:
        """Whether the walk completed."""
        return self.outcome == "completed"


def walk_level(run: RunParameters, name: str) -> LevelResult:
    """Plan and walk one level; runs in a worker and returns numbers only."""
    from validation.run.walk import walk_planned  # imported here: loads the simulator
    from validation.trial.plan import plan_walk

    start = time.perf_counter()
    values: Mapping[str, float] = {}
    scales: Mapping[str, float] = {"body_weight": 0.0, "foot_length": 0.0}
    try:
        result = walk_planned(plan_walk(Request(name, run)))
        comparison, end = result.comparison, result.record.outcome
        outcome, cause = str(end.name), end.cause
        values, scales = values_of(comparison), dict(comparison.scales)
    except AmpmError as error:
        outcome = "refused" if isinstance(error, RefusedGait | InputError) else "infeasible"
        cause = str(error)
    return LevelResult(outcome, cause, time.perf_counter() - start, memory_peak(), values, scales)


Runner = Callable[[RunParameters, str], LevelResult]
"""Function that walks one level; tests replace it."""
Walks = dict[RunParameters, LevelResult]


def walk_levels(
    runs: Iterable[RunParameters],
    name: str,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    runner: Runner = walk_level,
) -> Walks:
    """Walk every level once.

    Args:
        runs: complete parameters of every level.
        name: of the gait.
        workers: processes, None for one a core; one walks in this very process.
        progress: where to report it.
        runner: what walks one level.
    """
    # The finest steps take longest: started first, they leave no worker idle at the end.
    order = sorted(
        dict.fromkeys(runs), key=lambda run: -1.0 / run.simulation.time_step - 1.0 / run.solver.ik_time_step
    )
    done: Walks = {}
    progress = progress or Progress()
    with progress.stage(f"{name}: convergence", "walks") as stage:

        def kept(run: RunParameters, result: LevelResult) -> None:
            done[run] = result
            stage.advance(len(done), len(order))

        work_off(
            order, lambda run: runner(run, name), kept, workers=workers, scheduler=None, report=progress.say
        )
    return done

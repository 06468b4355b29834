"""Registry of metrics: name, readable name, unit, computation and tolerances of every judged number.

Comparison, profiles, verdict, columns of a sweep, reports, recordings and convergence read their metrics
here, so one :func:`register` before the walk is enough for a new :class:`Metric`. Files name it by ``name``,
tables and figures by ``label``. Worker processes of sweeps and studies get it, too.
"""

import math
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from numbers import Real
from types import MappingProxyType
from typing import Any

from ampm.exceptions import InputError, words_of
from validation.judge.built_in import COMPUTED, recovery_time
from validation.judge.built_in import rms as rms
from validation.judge.compare import RUN, SIGNALS, Comparison
from validation.judge.metric import BODY_WEIGHT, DEFAULT_BODY, limit_in_si, size_in_si, spaced
from validation.judge.metric import Metric as Metric
from validation.judge.metric import display_unit as display_unit
from validation.table import own_rows
from validation.trial.users import load_object

_ADDED: dict[str, Metric] = {}
_BUILT_IN: dict[str, Metric] = {}
METRICS: Mapping[str, Metric] = MappingProxyType(ChainMap(_ADDED, _BUILT_IN))
"""All metrics by name: first what the profiles judge, in the order of reports, then what is only reported,
last what :func:`register` added."""


def register(metric: Metric) -> Metric:
    """Add a metric; it is then computed, judged and shown like the built-in ones.

    Raises:
        InputError: its name is taken, or it has a tolerance without a reason.
    """
    if metric.name in METRICS:
        raise InputError(f"metric '{metric.name}' exists; choose another name.")
    if metric.tolerances and not metric.reason:
        raise InputError(f"metric '{metric.name}' has a tolerance without a reason; give the reason.")
    _ADDED[metric.name] = metric
    return metric


def unregister(name: str) -> None:
    """Remove a metric that :func:`register` added.

    Raises:
        InputError: there is none of this name.
    """
    if name not in _ADDED:
        raise InputError(f"no metric '{name}' was registered; registered are: {', '.join(_ADDED) or 'none'}.")
    del _ADDED[name]


def added_metrics() -> list[Metric]:
    """The metrics that :func:`register` added."""
    return list(_ADDED.values())


def add_metrics(metrics: Iterable[Metric]) -> None:
    """Register metrics of another process, unless this one has them."""
    for metric in metrics:
        if metric.name not in METRICS:
            register(metric)


def load_metric(text: str) -> Metric:
    """Register the metric ``MODULE:NAME``, unless its module does that; raises InputError if it cannot be."""
    metric = load_object("--metric", text)
    if not isinstance(metric, Metric):
        raise InputError(f"--metric {text!r} is a {type(metric).__name__}; name a val.Metric.")
    return metric if METRICS.get(metric.name) is metric else register(metric)


def evaluate(walk: Comparison) -> dict[str, float]:
    """Value of every metric that the walk has, by name, in its SI unit."""
    found = ((metric.name, _compute(metric, walk)) for metric in METRICS.values())
    return {name: value for name, value in found if value is not None}


def _compute(metric: Metric, walk: Comparison) -> float | None:
    """Value of one metric; raises InputError if a registered one fails, or returns no number."""
    own = metric.name in _ADDED
    if own and not walk.inside.any():
        return math.nan
    try:
        value = metric.compute(walk)
        if own and not isinstance(value, Real):
            raise TypeError(f"it returned {str(value)[:40]} of type {type(value).__name__}, not a number")
        return None if value is None else float(value)
    except (Exception, SystemExit) as error:
        if not own:
            raise
        raise InputError(
            f"metric '{metric.name}' cannot be computed ({type(error).__name__}: {words_of(error)}); correct "
            "its 'compute', or unregister it."
        ) from error


def metric_label(name: str) -> str:
    """Readable name of a metric, registered or not."""
    metric = METRICS.get(name)
    return metric.label if metric else spaced(name)


# ------------------------------------------------------------------------------------------- built-in metrics


def _built_in() -> Iterator[Metric]:
    """Errors of all signals, as :data:`validation.judge.compare.SIGNALS` has them, and ``metrics.csv``."""
    for name, signal in SIGNALS.items():
        for statistic, words, shown in (
            ("rmse", "root mean square", "RMS error"),
            ("maximum", "largest magnitude", "largest error"),
        ):
            yield Metric(
                name=f"{name}_{statistic}",
                label=f"{signal.quantity}, {shown} {signal.direction}",
                unit=signal.unit,
                meaning=f"{words} of: {signal.meaning}",
                kind="walk",
                compute=partial(_statistic, name=name, statistic=statistic),
                nature="mean" if statistic == "rmse" else "extreme",
            )
    computed = {**COMPUTED, "recovery_time": _recovery_time}
    for row in own_rows("judge/metrics.csv"):
        name = row["name"]
        entries: dict[str, Any] = dict(row)
        yield Metric(**entries, compute=partial(_cost, name=name) if row["section"] else computed[name])


def _with_limits(metrics: Mapping[str, Metric]) -> Iterator[Metric]:
    """The judged ones with their limits of ``limits.csv``, in its order, then the others.

    Limits are listed for the default body, in SI units and body weights.
    """
    rows = own_rows("judge/limits.csv")
    for row in rows:
        metric = metrics[row["metric"]]
        unit = row["grows_with"] or metric.unit
        size = 1.0 if unit == BODY_WEIGHT else float(size_in_si(unit, DEFAULT_BODY))  # weights are shares
        limits = {
            name: float(text) / size
            for name, text in row.items()
            if text and name not in ("metric", "grows_with", "reason")
        }
        yield replace(metric, tolerances=limits, tolerance_unit=unit, reason=row["reason"])
    judged = {row["metric"] for row in rows}
    yield from (metric for name, metric in metrics.items() if name not in judged)


def _statistic(walk: Comparison, name: str, statistic: str) -> float | None:
    if walk.plan.command is not None:
        return None
    return float(getattr(walk.signals[name][RUN], statistic))


def _recovery_time(walk: Comparison) -> float | None:
    """See :func:`recovery_time`, with the limits that the walk has if nothing pushes it."""
    if walk.plan.command is not None:
        return None
    profile = "footsteps" if walk.plan.judged_from == 0.0 else "default"
    profile = "jumps" if walk.plan.jump_times.size else profile
    profile = "odometry" if walk.relative else profile
    limits = {}
    for name, metric in METRICS.items():
        found = metric.tolerances.get(profile, metric.tolerances.get("default"))
        if found is not None and not (walk.relative and name.startswith(("zmp_x", "zmp_y"))):
            limits[name] = float(limit_in_si(found, metric.tolerance_unit, walk.scales))
    return recovery_time(walk, limits, METRICS["recovery_time"].tolerances["pushed"])


def _cost(walk: Comparison, name: str) -> float:
    found = cost_entry(walk.costs, METRICS[name])
    return float(getattr(found, "value", found))


def cost_entry(costs: Mapping[str, Any], metric: Metric) -> Any:
    """Value of a metric with a section in the cost of a walk, or in its summary: a number or an extreme."""
    section, name = costs[metric.section], metric.name.partition("_")[2]
    if metric.section == "effort":  # components of a vector
        vector, _, axis = name.rpartition("_")
        return section[vector]["xyz".index(axis)]
    return section.get(name)  # a summary of an older version may lack it


_BUILT_IN.update((item.name, item) for item in _with_limits({item.name: item for item in _built_in()}))

"""Registry of metrics: name, readable name, unit, computation and tolerances of every judged number.

Comparison, profiles, verdict, columns of a sweep, reports, recordings and convergence read their metrics
here, so one :func:`register` before the walk is enough for a new :class:`Metric`. Files name it by ``name``,
tables and figures by ``label``. Worker processes of sweeps and studies get it, too.
"""

import logging
import math
from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ampm.exceptions import InputError, words_of
from ampm.parameters import GRAVITY
from ampm.section import unknown
from validation.judge.built_in import COMPUTED
from validation.judge.compare import RUN, SIGNALS, Comparison
from validation.table import package_rows
from validation.trial.users import load_object

_KINDS, _NATURES = ("walk", "instrument", "cost"), ("mean", "extreme", "count")


@dataclass(frozen=True)
class Metric:
    """One number that a walk is judged by; smaller is better.

    Attributes:
        name: identifier, such as ``zmp_x_rmse``, for files.
        label: readable name, such as ``ZMP, RMS error along x``, for tables and figures; by default ``name``
            with spaces.
        unit: SI unit, ``1`` for a plain number.
        meaning: one phrase for the description of a table's column.
        kind: what it judges: the ``walk``, the ``instrument`` that measures it (its exact value is zero), or
            its ``cost``.
        compute: value in ``unit``; NaN if it could not be measured. Only built-in ones may return None, if
            the walk has no such metric. A registered one is not called where the window has no instant.
        tolerances: name of a profile to the largest value that passes; see
            :class:`validation.judge.profiles.Profile` for profiles that are not named.
        tolerance_unit: of ``tolerances``: ``unit`` by default, or one that grows with the body, such as
            :data:`~validation.judge.metrics.BODY_WEIGHT`.
        reason: why the tolerance is what it is, one or two sentences.
        nature: ``mean``; ``extreme``, which is never extrapolated to a vanishing time step; ``count``, which
            is exact.
        section: part of ``summary.json`` that holds the value; empty: ``metrics``.
    """

    name: str
    label: str = field(default="", kw_only=True)
    unit: str
    meaning: str
    kind: Literal["walk", "instrument", "cost"]
    compute: Callable[[Comparison], float | None]
    tolerances: Mapping[str, float] = field(default_factory=dict)
    tolerance_unit: str = ""
    reason: str = ""
    nature: Literal["mean", "extreme", "count"] = "mean"
    section: str = ""

    def __post_init__(self) -> None:
        """Complete the label; refuse a bad name, an unknown kind, nature or unit, a bad tolerance."""
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise InputError(f"metric name {self.name!r} is not an identifier; use letters, digits and '_'.")
        object.__setattr__(self, "label", self.label or self.name.replace("_", " "))
        units = "", self.unit, *(size for size, _ in SIZES.values())
        for what, known in (("kind", _KINDS), ("nature", _NATURES), ("tolerance_unit", units)):
            if (value := getattr(self, what)) not in known:
                raise unknown(value, filter(None, known), f"{what} of the metric '{self.name}'")
        if not callable(self.compute):
            raise InputError(f"metric '{self.name}' has compute = {self.compute!r}; give a function.")
        if not isinstance(self.tolerances, Mapping):
            raise InputError(
                f"metric '{self.name}' has the tolerances {self.tolerances!r}; "
                'give those of its profiles: {"default": 0.1}.'
            )
        for limit in self.tolerances.values():
            if not isinstance(limit, Real) or not math.isfinite(limit) or limit < 0.0:
                raise InputError(f"metric '{self.name}' has the tolerance {limit!r}; give a number from 0.")

    @property
    def column(self) -> str:
        """Name of its column in a sweep's table."""
        return self.name if self.section else f"metric_{self.name}"

    @property
    def is_self_check(self) -> bool:
        """Whether it measures the error of the instrument itself: its exact value is zero."""
        return self.kind == "instrument" and self.nature != "count"


def display_unit(unit: str, weight: Any) -> tuple[Any, str]:
    """Factor and unit in which an SI unit is shown, of a body with a weight [N], or of several."""
    if unit == "m":
        return 1e3, "mm"
    if unit == "N":
        return 100.0 / weight, "% of body weight"
    return 1.0, "" if unit == "1" else unit


BODY_WEIGHT, FOOT_LENGTH, FOOT_MOMENTUM = "body weight", "foot length", "foot momentum"
"""Units of limits that grow with the body: its weight [N], the length L of its foot [m], and the angular
momentum m (g L^3)^1/2 [N m s]."""
SIZES = {
    "m": (FOOT_LENGTH, "% of foot"),
    "N": (BODY_WEIGHT, "% of body weight"),
    "N m s": (FOOT_MOMENTUM, "% of m√(gL³)"),
}
"""Unit to the size of which bodies that differ are compared in shares, and its name in tables."""
DEFAULT_BODY: Mapping[str, float] = MappingProxyType({"body_weight": 60.0 * GRAVITY, "foot_length": 0.258})
"""Weight [N] and length of a foot [m] of the default body, for which limits in m and N m s are listed."""


def size_in_si(unit: str, scales: Mapping[str, Any]) -> Any:
    """Size of a body or of several in SI units, of one of the units above; 1 of any other unit."""
    weight, foot = scales["body_weight"], scales["foot_length"]
    momentum = weight * np.sqrt(foot**3 / GRAVITY)
    return {BODY_WEIGHT: weight, FOOT_LENGTH: foot, FOOT_MOMENTUM: momentum}.get(unit, 1.0)


_ADDED: dict[str, Metric] = {}
_BUILT_IN: dict[str, Metric] = {}
METRICS: Mapping[str, Metric] = MappingProxyType(ChainMap(_ADDED, _BUILT_IN))
"""All metrics by name: first what the profiles judge, in the order of reports, then what is only reported,
last what :func:`register` added."""


def register(metric: Metric) -> Metric:
    """Add a metric; it is then computed, judged and shown like the built-in ones.

    Raises:
        InputError: its name or a built-in label is taken, it has a section, or a tolerance without a reason.
    """
    if metric.name in METRICS:
        raise InputError(f"metric '{metric.name}' exists; choose another name.")
    if metric.label in (item.label for item in _BUILT_IN.values()):
        raise InputError(f"metric '{metric.label}' exists; choose another label.")
    if metric.section:
        raise InputError(f"metric '{metric.name}' has a section, as only built-in ones have; leave it out.")
    if metric.tolerances and not metric.reason:
        raise InputError(f"metric '{metric.name}' has a tolerance without a reason; give the reason.")
    _ADDED[metric.name] = metric
    return metric


def unregister(name: str) -> None:
    """Remove a metric that :func:`register` added.

    Raises:
        InputError: no metric has this name.
    """
    if name not in _ADDED:
        raise InputError(f"no metric '{name}' was registered; registered are: {', '.join(_ADDED) or 'none'}.")
    del _ADDED[name]


def added_metrics() -> list[Metric]:
    """The metrics that :func:`register` added."""
    return list(_ADDED.values())


def set_metrics(metrics: Iterable[Metric]) -> None:
    """Register the metrics of another process in place of those that were registered here."""
    _ADDED.clear()
    for metric in metrics:
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
    """Value of one metric; NaN, and a warning, if a registered one fails or returns no number."""
    own = metric.name in _ADDED
    if own and not walk.inside.any():
        return math.nan
    try:
        value = metric.compute(walk)
        if own and (not isinstance(value, Real | np.bool_) or value == -math.inf):
            raise TypeError(f"it returned {str(value)[:40]} of type {type(value).__name__}, not a number")
        return None if value is None else float(value)
    except BaseException as error:
        if not own or isinstance(error, KeyboardInterrupt):
            raise
        logging.getLogger("ampm").warning(
            f"metric '{metric.name}' is not measured ({type(error).__name__}: {words_of(error)}); correct "
            "its 'compute', and walk the gait again."
        )
        return math.nan


def _built_in() -> dict[str, Metric]:
    """Errors of all :data:`SIGNALS`, and ``metrics.csv``; the judged ones first, as ``limits.csv`` has them.

    Limits are listed for the default body, in SI units and body weights.
    """
    found: dict[str, Metric] = {}
    for signal_name, signal in SIGNALS.items():
        for statistic, words, shown in (
            ("rmse", "root mean square", "RMS error"),
            ("maximum", "largest magnitude", "largest error"),
        ):
            name = f"{signal_name}_{statistic}"
            found[name] = Metric(
                name=name,
                label=f"{signal.quantity}, {shown} {signal.direction}",
                unit=signal.unit,
                meaning=f"{words} of: {signal.meaning}",
                kind="walk",
                compute=partial(_statistic, name=signal_name, statistic=statistic),
                nature="mean" if statistic == "rmse" else "extreme",
            )
    for row in package_rows("judge/metrics.csv"):
        name = row["name"]
        entries: dict[str, Any] = dict(row)
        compute = partial(_cost, name=name) if row["section"] else COMPUTED[name]
        found[name] = Metric(**entries, compute=compute)
    judged: dict[str, Metric] = {}
    for row in package_rows("judge/limits.csv"):
        metric = found.pop(row["metric"])
        unit = row["grows_with"] or metric.unit
        size = 1.0 if unit == BODY_WEIGHT else float(size_in_si(unit, DEFAULT_BODY))  # weights are shares
        limits = {
            name: float(text) / size
            for name, text in row.items()
            if text and name not in ("metric", "grows_with", "reason")
        }
        judged[metric.name] = replace(metric, tolerances=limits, tolerance_unit=unit, reason=row["reason"])
    return judged | found


def _statistic(walk: Comparison, name: str, statistic: str) -> float | None:
    return float(getattr(walk.signals[name][RUN], statistic)) if walk.plan.command is None else None


def _cost(walk: Comparison, name: str) -> float:
    found = cost_entry(walk.costs, METRICS[name])
    return float(getattr(found, "value", found))


def cost_entry(costs: Mapping[str, Any], metric: Metric) -> Any:
    """Value of a metric with a section in the cost of a walk, or in its summary: a number or an extreme."""
    section, name = costs[metric.section], metric.name.partition("_")[2]
    if metric.section == "effort":  # components of a vector
        vector, _, axis = name.rpartition("_")
        return section[vector]["xyz".index(axis)]
    return section.get(name)  # few bodies have limits of speed


_BUILT_IN.update(_built_in())

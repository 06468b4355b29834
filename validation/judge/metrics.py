"""Registry of metrics: name, readable name, unit, computation and tolerances of every judged number.

Comparison, profiles, verdict, columns of a sweep, reports, recordings and convergence read their metrics
here, so one :func:`register` is enough for a new metric. Files name it by ``name``, tables and figures by
``label``::

    register(
        Metric(
            name="trunk_drop",
            unit="m",
            label="COM, largest distance below the plan",
            meaning="largest distance of the COM below its planned height",
            kind="walk",
            compute=lambda walk: float((walk.sample.com - walk.measured.com)[walk.inside, 2].max()),
            tolerances={"default": 0.01},
            reason="More than 1 cm is visible.",
        )
    )

Call it before the walk. Worker processes of sweeps and studies get it, too.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.body.limits import CLEARANCE
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.walk import UNSOLVED
from validation.judge.compare import FIRST_STEP, SIGNALS, Comparison
from validation.judge.metric import Metric as Metric
from validation.judge.metric import MetricValue as MetricValue
from validation.judge.metric import display_unit as display_unit
from validation.judge.metric import spaced
from validation.judge.plan_moved import PLAN_MOVED
from validation.judge.sizes import BODY_WEIGHT, FOOT_LENGTH, LIMIT_UNITS, share_of_default
from validation.trial.record import SimulationRecord
from validation.trial.users import load_object

_METRICS: dict[str, Metric] = {}
METRICS: Mapping[str, Metric] = MappingProxyType(_METRICS)
"""All metrics by name: first what the profiles judge, in the order of reports, then what is only reported."""
_ADDED: list[str] = []


def register(metric: Metric) -> Metric:
    """Add a metric; it is then computed, judged and shown like the built-in ones.

    Raises:
        InputError: its name is taken or no identifier, or it has a tolerance without a reason.
    """
    if metric.name in _METRICS:
        raise InputError(f"metric '{metric.name}' exists; choose another name.")
    if not metric.name.isidentifier():
        raise InputError(f"metric name '{metric.name}' is no identifier; use letters, digits and '_'.")
    if metric.tolerances and not metric.reason:
        raise InputError(
            f"metric '{metric.name}' has a tolerance and no reason; give the reason for its value."
        )
    _METRICS[metric.name] = metric
    _ADDED.append(metric.name)
    return metric


def unregister(name: str) -> None:
    """Remove a metric that :func:`register` added.

    Raises:
        InputError: there is none of this name.
    """
    if name not in _ADDED:
        raise InputError(f"no metric '{name}' was registered; registered are: {', '.join(_ADDED) or 'none'}.")
    _ADDED.remove(name)
    del _METRICS[name]


def added_metrics() -> list[Metric]:
    """The metrics that :func:`register` added."""
    return [_METRICS[name] for name in _ADDED]


def add_metrics(metrics: Iterable[Metric]) -> None:
    """Register metrics of another process, unless this one has them."""
    for metric in metrics:
        if metric.name not in _METRICS:
            register(metric)


def load_metric(text: str) -> Metric:
    """Register the metric ``MODULE:NAME``, unless its module does that itself.

    Raises:
        InputError: it cannot be imported, is no :class:`Metric`, or cannot be registered.
    """
    metric = load_object("--metric", text)
    if not isinstance(metric, Metric):
        raise InputError(f"--metric {text!r} is a {type(metric).__name__}; name a val.Metric.")
    return metric if METRICS.get(metric.name) is metric else register(metric)


def evaluate(walk: Comparison, metrics: Iterable[Metric] | None = None) -> dict[str, MetricValue]:
    """Value of every metric that the walk has, by name.

    Args:
        walk: beside its plan.
        metrics: all registered ones by default.
    """
    first = replace(walk, window=FIRST_STEP)
    found = {}
    for metric in METRICS.values() if metrics is None else metrics:
        value = _compute(metric, walk)
        if value is None:
            continue
        if unknown := set(metric.scales) - walk.scales.keys():
            raise InputError(
                f"metric '{metric.name}' has no scale {', '.join(unknown)}; take of {', '.join(walk.scales)}."
            )
        start = _compute(metric, first) if metric.by_window else None
        found[metric.name] = MetricValue(
            value=value,
            unit=metric.unit,
            normalised=MappingProxyType({name: value / walk.scales[name] for name in metric.scales}),
            first_step=None if start is None or math.isnan(start) else start,
        )
    return found


def _compute(metric: Metric, walk: Comparison) -> float | None:
    """Value of one metric.

    Raises:
        InputError: a registered metric fails.
    """
    own = metric.name in _ADDED
    if own and not walk.inside.any():
        return math.nan
    try:
        value = metric.compute(walk)
        return None if value is None else float(value)
    except (Exception, SystemExit) as error:
        if not own:
            raise
        raise InputError(
            f"metric '{metric.name}' cannot be computed ({type(error).__name__}: {error}); correct its "
            "'compute', or unregister it."
        ) from error


def metric_label(name: str) -> str:
    """Readable name of a metric, registered or not."""
    metric = METRICS.get(name)
    return metric.label if metric else spaced(name)


# ----------------------------------------------------------------------------------------- the metrics


def _errors() -> Iterator[Metric]:
    """Errors of all signals: first those that the profiles judge."""
    every = [(name, statistic) for name in SIGNALS for statistic in ("rmse", "maximum")]
    for key in dict.fromkeys([*_LIMITS, *_ODOMETRY_LIMITS, *every]):
        (name, statistic), limits = key, _LIMITS.get(key)
        signal, mean = SIGNALS[name], statistic == "rmse"
        yield Metric(
            name=f"{name}_{statistic}",
            label=f"{signal.quantity}, {'RMS' if mean else 'largest'} error {signal.direction}",
            unit=signal.unit,
            meaning=f"{'root mean square' if mean else 'largest magnitude'} of: {signal.meaning}",
            kind="walk",
            compute=partial(_statistic, name=name, statistic=statistic),
            tolerances=_tolerances(key),
            tolerance_unit=LIMIT_UNITS[signal.unit],
            reason=limits[2] if limits else _FROM_FOOT if key in _ODOMETRY_LIMITS else "",
            scales=signal.scales,
            nature="mean" if mean else "extreme",
            by_window=True,
        )


def _tolerances(key: tuple[str, str]) -> Mapping[str, float]:
    """Limits of a signal's statistic by profile, as shares of what grows with the body."""
    found = {} if key not in _LIMITS else dict(zip(("strict", "default"), _LIMITS[key][:2], strict=True))
    found |= {"jumps": _JUMP_LIMITS[key]} if key in _JUMP_LIMITS else {}
    found |= {"odometry": _ODOMETRY_LIMITS[key]} if key in _ODOMETRY_LIMITS else {}
    found |= {"footsteps": _FOOTSTEPS_LIMIT} if key in _LIMITS and key[0].startswith("angular") else {}
    unit = LIMIT_UNITS[SIGNALS[key[0]].unit]
    return {name: share_of_default(limit, unit) for name, limit in found.items()}


def _statistic(walk: Comparison, name: str, statistic: str) -> float:
    return float(getattr(walk.signals[name][walk.window], statistic))


_ZMP = (
    "The ZMP is the most sensitive signal: at a COM height of 0.9 m, 1 mm is an error of 1 mm in the COM, of "
    "0.11 % of body weight in the horizontal force, or of 0.6 N m in the moment about the COM. "
)
_LIMITS: Mapping[tuple[str, str], tuple[float, float, str]] = {
    ("zmp_x", "rmse"): (2.0e-3, 2.5e-3, _ZMP + "This is about one hundredth of the foot's length."),
    ("zmp_y", "rmse"): (1.0e-3, 1.5e-3, _ZMP + "Half of what is allowed along x: the sole is narrow and no "
        "foot rolls sideways."),
    ("zmp_x", "maximum"): (15e-3, 40e-3, "For a few milliseconds after every change of contact the load "
        "moves between points that still sink in or rise; the peak is bounded so that it stays well inside "
        "the sole."),
    ("zmp_y", "maximum"): (8e-3, 20e-3, "As for x; half of it, as the sole is half as wide as it is long."),
    ("force_x", "rmse"): (0.006, 0.008, "Wider than the ZMP alone would ask (0.22 %): a horizontal force at "
        "the foot turns the body as much as it pushes it, so the ZMP stays where it is, and only here the "
        "error shows."),
    ("force_y", "rmse"): (0.004, 0.006, "As for x; less, as the lateral force is the smaller one."),
    ("force_z", "rmse"): (0.007, 0.010, "The plan holds the COM at constant height; what is left is the "
        "floor's compliance at heel strike and lift-off."),
    ("angular_momentum_x", "rmse"): (0.10, 0.15, "L_x has no free constant. Small against the several N m s "
        "that c_y induces, or induced momentum could not be distinguished from none."),
    ("angular_momentum_y", "rmse"): (0.10, 0.15, "Constant of the periodic motion included, so that a "
        "drifting trunk shows. Same size as for L_x."),
}  # fmt: skip
"""Signal and statistic to the limits of ``strict`` and ``default`` for the default body (forces in body
weights), and their reason."""
_JUMP_LIMITS: Mapping[tuple[str, str], float] = {
    ("zmp_x", "rmse"): 10e-3, ("zmp_y", "rmse"): 3.3e-3,
    ("zmp_x", "maximum"): 250e-3, ("zmp_y", "maximum"): 80e-3, ("force_x", "rmse"): 0.012,
}  # fmt: skip
"""Limits of ``jumps``. The ZMP of `ipm` jumps by J = 0.24 m along x and 0.08 m along y twice in a step of
D = 0.775 s. With torques held for T = 2 ms each jump comes up to T/2 early or late, which makes an RMSE of
J (T/2D)^1/2 = 8.6 and 2.9 mm."""
_ODOMETRY_LIMITS: Mapping[tuple[str, str], float] = {
    ("zmp_foot_x", "rmse"): 4e-3, ("zmp_foot_y", "rmse"): 4e-3,
    ("zmp_foot_x", "maximum"): 40e-3, ("zmp_foot_y", "maximum"): 30e-3,
}  # fmt: skip
"""Limits of ``odometry``."""
_FROM_FOOT = (
    "An estimator without fixes of the position does not know where in the world it is, so the ZMP counts "
    "from the standing foot. Good sensors tell the COM's velocity to 1.5 mm/s, and each mm/s moves the ZMP "
    "by 1.3 mm."
)
_FOOTSTEPS_LIMIT = 0.5
"""Limit of ``footsteps`` on the angular momentum [N m s]. What keeps a trunk upright while legs and arms
swing, 0.47 N m s for `normal`, is part of a periodic motion; over footsteps it is found while walking."""


def _zmp_gaps(walk: Comparison) -> Array:
    """Distance of both measured ZMPs in the window, shape (n,) [m]; NaN where there is none."""
    gap = walk.measured.zmp - walk.measured.zmp_momentum
    return np.asarray(np.linalg.norm(gap[walk.inside], axis=1))


def _zmp_ways(walk: Comparison) -> Array:
    """Way of the measured ZMP from each instant in the window to the next, shape (n,) [m]."""
    way = np.diff(walk.measured.zmp, axis=0, append=np.full((1, 2), np.nan))
    return np.asarray(np.linalg.norm(way[walk.inside], axis=1))


def _unsupported(walk: Comparison) -> float:
    """Instants in the window that have no ZMP; NaN if it was never measured, as in a log of forces."""
    known: NDArray[np.bool_] = np.isfinite(walk.measured.zmp[:, 0])
    return float(np.count_nonzero(~known[walk.inside])) if known.any() else math.nan


def _force_gaps(walk: Comparison) -> Array:
    """Distance of contact force and m (a + g) in the window, shape (n,) [N]."""
    gap = walk.measured.force - walk.measured.momentum_force
    return np.asarray(np.linalg.norm(gap[walk.inside], axis=1))


def has_qp(record: SimulationRecord) -> bool:
    """Whether the controller reported anything of a QP; otherwise nothing of a QP applies to it."""
    return bool(record.qp_status.any() or np.isfinite([record.qp_residual, record.qp_time]).any())


def _failed_qp(walk: Comparison) -> float | None:
    """Control ticks whose QP stayed unsolved; None for a controller that reports no QP."""
    record = walk.record
    return float(np.count_nonzero(record.qp_status == UNSOLVED)) if has_qp(record) else None


def rms(values: Array) -> float:
    """Root mean square of the finite values, NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else math.nan


def _largest(values: Array) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else math.nan


def _equations(walk: Comparison, which: str) -> float | None:
    """Defect of the equations of motion, relative to the median change of velocity; None if not checked."""
    found = walk.measured.self_checks.equations
    return None if found is None else float(getattr(found, which)) / found.change


def _instrument(
    name: str, unit: str, label: str, meaning: str, compute: Callable[[Comparison], float | None],
    limit: float | None = None, reason: str = "", **more: Any,
) -> Metric:  # fmt: skip
    limits = {} if limit is None else {"default": limit}
    return Metric(name, unit, meaning, "instrument", compute, limits, label=label, reason=reason, **more)


_INSTRUMENT = (
    _instrument(
        "zmp_agreement_relative", "1", "both measured ZMPs, relative distance",
        "root mean square distance of the ZMP by contact and by momentum, over its travel in a time step",
        lambda walk: rms(_zmp_gaps(walk)) / (rms(_zmp_ways(walk)) or math.nan), 0.5,
        "The two measurements of the ZMP share no force and no acceleration. Each is a mean over the time "
        "step, so neither is finer than the way that the ZMP makes in it, and their gap is about a tenth of "
        "that at any time step, a third with the fastest swings. A heel or ball point missing from the log "
        "makes it several times the whole.",
        nature="count",
    ),
    _instrument(
        "force_agreement_rmse", "N", "F = m (a + g), RMS error",
        "root mean square of contact force minus m (a + g)",
        lambda walk: rms(_force_gaps(walk)), 0.002,
        "F = m (a + g) is exact but for the time step. Half of the smallest tolerance on a force, so "
        "that the instrument is finer than what it measures.",
        tolerance_unit=BODY_WEIGHT, scales=("body_weight",),
    ),
    _instrument(
        "impulse_residual", "1", "vertical impulse, relative error",
        "vertical impulse of the floor against weight and momentum, relative",
        lambda walk: abs(walk.measured.self_checks.impulse_residual), 1e-3,
        "Over a run the floor carries the weight, but for the momentum gained. Only the integrator's "
        "order separates the two sums; a force law with a wrong scale would show at once.",
    ),
    _instrument(
        "standing_weight_error", "1", "weight of the standing body, relative error",
        "the still body's weight, measured against its mass, relative",
        lambda walk: None if walk.standing is None else walk.standing.relative_error, 1e-6,
        "Standing still, the body presses with exactly its weight, once contacts and controller have "
        "come to rest. After a second and a half about 1e-8 of their motion is left.",
    ),
    _instrument(
        "com_agreement_maximum", "m", "COM by both libraries, largest distance",
        "largest distance of MuJoCo's and Pinocchio's COM",
        lambda walk: walk.measured.self_checks.com_agreement, 1e-9,
        "MuJoCo and Pinocchio hold the same masses and see the same q: only rounding may differ.",
        scales=("foot_length",), nature="extreme",
    ),
    _instrument(
        "angular_momentum_agreement_maximum", "N m s", "angular momentum by both libraries, largest distance",
        "largest difference of MuJoCo's and Pinocchio's angular momentum",
        lambda walk: walk.measured.self_checks.angular_momentum_agreement, 1e-8,
        "As for the COM; rounding grows with the momenta that are summed.", nature="extreme",
    ),
    _instrument(
        "equations_defect_median", "1", "equations of motion, median defect, relative",
        "median defect of the equations of motion over the median change of velocity in a step",
        lambda walk: _equations(walk, "median"), 1e-6,
        "Recorded torques and contact forces must give the recorded change of every velocity, by Pinocchio, "
        "in any simulator and with any contact law. Only rounding differs, and what MuJoCo's solver leaves "
        "of a sliding sole, 1e-8. A force that is missing from the record changes velocities by per cents.",
        nature="count",
    ),
    _instrument(
        "failed_qp", "1", "unsolved QPs", "control ticks whose QP stayed unsolved",
        _failed_qp, 0.0,
        "The controller's fallback exists to survive a bad tick, not to walk: one unsolved QP means "
        "that the metrics do not describe the controller that is documented.", nature="count",
    ),
    _instrument(
        "unsupported_instants", "1", "instants without ground contact", "instants without any contact force",
        _unsupported, 0.0,
        "A walk has no flight, and an instant without a ZMP would silently be missing from its error.",
        nature="count",
    ),
    _instrument(
        "equations_defect_maximum", "1", "equations of motion, largest defect, relative",
        "largest defect of the equations of motion over the median change of velocity in a step",
        lambda walk: _equations(walk, "largest"), nature="extreme",
    ),
    _instrument(
        "zmp_agreement_rmse", "m", "both measured ZMPs, RMS distance",
        "root mean square distance of the ZMP by contact and by momentum",
        lambda walk: rms(_zmp_gaps(walk)), scales=("foot_length",),
    ),
    _instrument(
        "zmp_agreement_maximum", "m", "both measured ZMPs, largest distance",
        "largest distance of the ZMP by contact and by momentum",
        lambda walk: _largest(_zmp_gaps(walk)), scales=("foot_length",), nature="extreme",
    ),
)  # fmt: skip
_SHORTFALL = Metric(
    "clearance_shortfall", "m",
    f"by how much arms, legs and trunk come closer to each other than {1e3 * CLEARANCE:g} mm", "walk",
    lambda walk: _shortfall(walk.costs["margins"]["clearance"].value), {"default": 0.0},
    label=f"clearance of the body, shortfall below {1e3 * CLEARANCE:g} mm",
    reason="Nothing but the soles collides in the simulation, so a body that passes through itself would "
    "walk all the same. A centimetre is left for clothes and for what the drawn shapes leave out.",
    nature="extreme",
)  # fmt: skip


def _drift(walk: Comparison) -> float | None:
    """Drift in a step [m]; None for less than three steps, or where the first or last was not measured."""
    ends = walk.plan.contacts.step_ends
    ends = ends[ends <= walk.time[-1] + 2.0 * walk.record.time_step] if walk.time.size else ends[:0]
    if len(ends) < 3:
        return None
    error = (walk.measured.com - walk.sample.com)[:, :2]
    second, last = (
        error[(walk.time >= start) & (walk.time < end)]
        for start, end in ((ends[0], ends[1]), (ends[-2], ends[-1]))
    )
    if not (len(second) and len(last)):
        return None
    return float(np.linalg.norm(last.mean(axis=0) - second.mean(axis=0))) / (len(ends) - 2)


def _longest_slip(walk: Comparison) -> float | None:
    """Largest slip in the window [m]; None where none was measured, as in a log without it."""
    slip = walk.measured.slip
    return None if np.isnan(slip).all() else _largest(slip[walk.inside])


_SLIP = Metric(
    "slip_maximum", "m",
    "longest way that the loaded points of a foot slid over the floor in one stance, weighted by their force",
    "walk", _longest_slip,
    {name: share_of_default(limit, FOOT_LENGTH) for name, limit in (("strict", 10e-3), ("default", 15e-3))},
    tolerance_unit=FOOT_LENGTH,
    label="longest slip of a stance foot",
    reason="A loaded foot creeps, because the simulator's friction is regularised: 1 to 9 mm in the presets, "
    "at most 3.1 mm without induced momentum. On a floor of friction 0.22 `flat` slides by 19 mm and keeps "
    "every other limit of the walk.",
    scales=("foot_length",), nature="extreme", by_window=True,
)  # fmt: skip
_SPEED = Metric(
    "speed_excess", "1",
    "by how much the fastest joint exceeds its speed limit, as a share of it", "walk",
    lambda walk: _excess(walk.costs["margins"]), {"default": 0.0},
    label="fastest joint, excess over its speed limit",
    reason="A motor cannot turn faster than its limit, which the simulation does not enforce.",
    nature="extreme",
)  # fmt: skip


def _excess(margins: Mapping[str, Any]) -> float | None:
    """Share by which a speed exceeds its limit [1]; None for a body without such limits."""
    return max(0.0, margins["speed"].value - 1.0) if "speed" in margins else None


def _shortfall(clearance: float) -> float | None:
    """What lacks to the least clearance [m]; None if the body's shapes are not known."""
    return None if math.isnan(clearance) else max(0.0, CLEARANCE - clearance)


def cost_entry(costs: Mapping[str, Any], metric: Metric) -> Any:
    """Value of a metric with a section in the cost of a walk, or in its summary: a number or an extreme."""
    section, name = costs[metric.section], metric.name.partition("_")[2]
    if metric.section == "effort":  # components of a vector
        vector, _, axis = name.rpartition("_")
        return section[vector]["xyz".index(axis)]
    return section[name]


def _cost(walk: Comparison, name: str) -> float:
    found = cost_entry(walk.costs, METRICS[name])
    return float(getattr(found, "value", found))


def _costs() -> Iterator[Metric]:
    """Costs of a walk, as ``costs.csv`` lists them: section of the summary, name in it, unit and words."""
    with Path(__file__).with_name("costs.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            section = row["section"]
            key = f"{section.removesuffix('s')}_{row['name']}"
            yield Metric(
                name=key,
                label=row["label"],
                unit=row["unit"],
                meaning=row["meaning"],
                kind="cost",
                compute=partial(_cost, name=key),
                nature="extreme" if section == "margins" else "mean",
                section=section,
            )


_DRIFT = Metric(
    "drift_per_step", "m",
    "how far the COM left its plan from the second step to the last one, over the steps between", "walk",
    _drift, label="drift from the plan in a step",
)  # fmt: skip
_BUILT_IN = [*_errors(), _SLIP, _SHORTFALL, _SPEED, _DRIFT, *PLAN_MOVED, *_INSTRUMENT, *_costs()]
_EVERY = sorted(_BUILT_IN, key=lambda item: not item.tolerances)
_METRICS.update((item.name, item) for item in _EVERY)

"""The registry of metrics: name, unit, words, computation and tolerances of everything that is judged.

Comparison, profiles, verdict, columns of a sweep, labels of reports, diff and convergence read their metrics
here, so that one :func:`register` is all that a new metric takes::

    register(
        Metric(
            name="trunk_drop",
            unit="m",
            label="COM, lowest below the plan",
            meaning="largest distance of the COM below its planned height",
            kind="walk",
            compute=lambda walk: float((walk.sample.com - walk.measured.com)[walk.inside, 2].max()),
            tolerances={"default": 0.01},
            reason="More than 1 cm is visible.",
        )
    )

Call it before the walk. Worker processes of sweeps and studies get it, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import cloudpickle
import numpy as np

from ampm.exceptions import InputError
from validation.judge.errors import FIRST_STEP, SIGNALS, Signal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from validation.judge.compare import Comparison

    Array = NDArray[np.float64]

BODY_WEIGHT = "body weight"
"""Unit of limits on forces: they are judged in newton, as a share of the weight that was simulated."""


@dataclass(frozen=True)
class Metric:
    """One number that a walk is judged by; smaller is better.

    Attributes:
        name: identifier, such as ``zmp_x_rmse``.
        unit: SI unit, ``1`` for a plain number.
        label: short text for tables and figures.
        meaning: one phrase for the description of a table's column.
        kind: what it judges: the ``walk``, the ``instrument`` that measures it (its exact value is zero), or
            its ``cost``.
        compute: value in ``unit``; NaN if it could not be measured, None if the walk has no such metric. Of a
            registered metric it is not called where the window has no instant.
        tolerances: name of a profile to the largest value that passes; see
            :class:`validation.judge.profiles.Profile` for profiles that are not named.
        tolerance_unit: of ``tolerances``: ``unit`` by default, or :data:`BODY_WEIGHT`.
        reason: why the tolerance is what it is, one or two sentences.
        widens: whether a profile that is wider than another widens this tolerance; by default that of a walk.
        scales: names of the reference quantities that give the normalised values.
        nature: ``mean``; ``extreme``, which is never extrapolated to a vanishing time step; ``count``, which
            is exact.
        by_window: whether ``compute`` heeds :attr:`Comparison.window`; the first step is then reported, too.
        section: part of ``summary.json`` that holds the value in any case; empty: ``metrics``.
    """

    name: str
    unit: str
    label: str
    meaning: str
    kind: Literal["walk", "instrument", "cost"]
    compute: Callable[[Comparison], float | None]
    tolerances: Mapping[str, float] = field(default_factory=dict)
    tolerance_unit: str = ""
    reason: str = ""
    widens: bool | None = None
    scales: tuple[str, ...] = ()
    nature: Literal["mean", "extreme", "count"] = "mean"
    by_window: bool = False
    section: str = ""

    @property
    def column(self) -> str:
        """Name of its column in a sweep's table."""
        return self.name if self.section else f"metric_{self.name}"

    @property
    def is_self_check(self) -> bool:
        """Whether it measures the error of the instrument itself: its exact value is zero."""
        return self.kind == "instrument" and self.nature != "count"


@dataclass(frozen=True)
class MetricValue:
    """Value of a metric over the run without the first step.

    Attributes:
        value: NaN if it could not be measured.
        unit: SI unit.
        normalised: name of a reference quantity to value over it [1].
        first_step: the same metric for the first step, None if it has none.
    """

    value: float
    unit: str
    normalised: Mapping[str, float] = field(default_factory=dict)
    first_step: float | None = None


_METRICS: dict[str, Metric] = {}
METRICS: Mapping[str, Metric] = MappingProxyType(_METRICS)
"""All metrics by name: first what the profiles judge, in the order of reports, then what is only reported."""
_ADDED: list[str] = []


def register(metric: Metric) -> Metric:
    """Add a metric; it is then computed, judged and shown wherever metrics are.

    Raises:
        InputError: its name is taken or no identifier, or it has a tolerance without a reason.
    """
    if metric.name in _METRICS:
        raise InputError(f"metric '{metric.name}' exists; choose another name.")
    if not metric.name.isidentifier():
        raise InputError(f"metric name '{metric.name}' is no identifier; use letters, digits and '_'.")
    if metric.tolerances and not metric.reason:
        raise InputError(f"metric '{metric.name}' has a tolerance and no reason; say why it is that large.")
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


def dump_added() -> bytes:
    """The metrics that :func:`register` added, for a worker process; empty if there are none."""
    return bytes(cloudpickle.dumps([_METRICS[name] for name in _ADDED])) if _ADDED else b""


def load_added(data: bytes) -> None:
    """Register what :func:`dump_added` of another process holds, unless this one has it."""
    for metric in cloudpickle.loads(data) if data else ():
        if metric.name not in _METRICS:
            register(metric)


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
    except Exception as error:
        if not own:
            raise
        raise InputError(
            f"metric '{metric.name}' cannot be computed ({type(error).__name__}: {error}); correct its "
            "'compute', or unregister it."
        ) from error


def metric_label(name: str) -> str:
    """Readable name of a metric; its name without underscores if it is not registered."""
    metric = METRICS.get(name)
    return metric.label if metric else name.replace("_", " ")


def display_unit(unit: str, weight: float) -> tuple[float, str]:
    """Factor and unit for people: millimetres, percent of body weight.

    Args:
        unit: SI unit.
        weight: of the body [N].
    """
    if unit == "m":
        return 1e3, "mm"
    if unit == "N":
        return 100.0 / weight, "% of body weight"
    return 1.0, "" if unit == "1" else unit


# ----------------------------------------------------------------------------------------- the metrics


def _error(
    name: str, statistic: Literal["rmse", "maximum"], tolerances: tuple[float, float] | None = None,
    reason: str = "",
) -> Metric:  # fmt: skip
    """Error of one signal, with its tolerances in the profiles ``strict`` and ``default``."""
    signal: Signal = next(item for item in SIGNALS if item.name == name)
    root = statistic == "rmse"

    def compute(walk: Comparison) -> float:
        return float(getattr(walk.signals[name].windows[walk.window], statistic))

    return Metric(
        name=f"{name}_{statistic}",
        unit=signal.unit,
        label=f"{signal.label}, {'RMSE' if root else 'largest error'}",
        meaning=f"{'root mean square' if root else 'largest magnitude'} of: {signal.meaning}",
        kind="walk",
        compute=compute,
        tolerances=dict(zip(("strict", "default"), tolerances or (), strict=False)),
        tolerance_unit=BODY_WEIGHT if signal.unit == "N" else "",
        reason=reason,
        scales=signal.scales,
        nature="mean" if root else "extreme",
        by_window=True,
    )


_ZMP = (
    "The ZMP is the most sensitive signal: at a COM height of 0.9 m, 1 mm is an error of 1 mm in the COM, of "
    "0.11 % of body weight in the horizontal force, or of 0.6 N m in the moment about the COM. "
)
_JUDGED_ERRORS = (
    _error("zmp_x", "rmse", (2.0e-3, 2.5e-3), _ZMP + "This is about one hundredth of the foot's length."),
    _error(
        "zmp_y",
        "rmse",
        (1.0e-3, 1.5e-3),
        _ZMP + "Half of what is allowed along x: the sole is narrow and no foot rolls sideways.",
    ),
    _error(
        "zmp_x",
        "maximum",
        (15e-3, 40e-3),
        "For a few milliseconds after every change of contact the load moves between points "
        "that still sink in or rise; the peak is bounded so that it stays well inside the sole.",
    ),
    _error(
        "zmp_y", "maximum", (8e-3, 20e-3), "As for x; half of it, as the sole is half as wide as it is long."
    ),
    _error(
        "force_x",
        "rmse",
        (0.006, 0.008),
        "Wider than the ZMP alone would ask (0.22 %): a horizontal force at the foot turns "
        "the body as much as it pushes it, so the ZMP stays where it is, and only here the error shows.",
    ),
    _error("force_y", "rmse", (0.004, 0.006), "As for x; less, as the lateral force is the smaller one."),
    _error(
        "force_z",
        "rmse",
        (0.007, 0.010),
        "The plan holds the COM at constant height; what is left is the floor's compliance "
        "at heel strike and lift-off.",
    ),
    _error(
        "angular_momentum_x",
        "rmse",
        (0.10, 0.15),
        "L_x has no free constant. Small against the several N m s that c_y "
        "induces, or induced momentum could not be told from none.",
    ),
    _error(
        "angular_momentum_y",
        "rmse",
        (0.10, 0.15),
        "Constant of the periodic motion included, so that a drifting trunk shows. Same size as for L_x.",
    ),
)


def _zmp_gap(walk: Comparison) -> Array:
    measured = walk.measured
    gap: Array = np.linalg.norm((measured.zmp - measured.zmp_momentum)[walk.inside], axis=1)
    return gap


def _force_gap(walk: Comparison) -> Array:
    measured = walk.measured
    gap: Array = np.linalg.norm((measured.force - measured.momentum_force)[walk.inside], axis=1)
    return gap


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else math.nan


def _largest(values: Array) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else math.nan


_INSTRUMENT = (
    Metric(
        name="zmp_agreement_rmse",
        unit="m",
        label="both measured ZMPs, RMS distance",
        meaning="root mean square distance of the ZMP by contact and by momentum",
        kind="instrument",
        compute=lambda walk: _rms(_zmp_gap(walk)),
        tolerances={"default": 0.5e-3},
        reason="The two measurements of the ZMP share no force and no acceleration. Their gap is the time "
        "step's: first order in dt, about 0.3 mm at 2 ms. A quarter of the ZMP tolerance, so that the "
        "instrument is finer than what it measures; one contact missing from the log makes it more than "
        "5 mm.",
        widens=True,
        scales=("foot_length",),
    ),
    Metric(
        name="force_agreement_rmse",
        unit="N",
        label="F = m (a + g), RMS error",
        meaning="root mean square of contact force minus m (a + g)",
        kind="instrument",
        compute=lambda walk: _rms(_force_gap(walk)),
        tolerances={"default": 0.002},
        tolerance_unit=BODY_WEIGHT,
        reason="F = m (a + g) is exact but for the time step. Half of the smallest tolerance on a force, so "
        "that the instrument is finer than what it measures.",
        scales=("body_weight",),
    ),
    Metric(
        name="impulse_residual",
        unit="1",
        label="impulse against weight, relative",
        meaning="vertical impulse of the floor against weight and momentum, relative",
        kind="instrument",
        compute=lambda walk: abs(walk.measured.self_checks.impulse_residual),
        tolerances={"default": 1e-3},
        reason="Over a run the floor carries the weight, but for the momentum gained. Only the integrator's "
        "order separates the two sums; a force law with a wrong scale would show at once.",
    ),
    Metric(
        name="standing_weight_error",
        unit="1",
        label="still body against weight, relative",
        meaning="the still body's weight, measured against its mass, relative",
        kind="instrument",
        compute=lambda walk: None if walk.standing is None else walk.standing.relative_error,
        tolerances={"default": 1e-6},
        reason="Standing still, the body presses with exactly its weight, once contacts and controller have "
        "come to rest. After a second and a half about 1e-8 of their motion is left.",
    ),
    Metric(
        name="com_agreement_maximum",
        unit="m",
        label="COM of both libraries, largest distance",
        meaning="largest distance of MuJoCo's and Pinocchio's COM",
        kind="instrument",
        compute=lambda walk: walk.measured.self_checks.com_agreement,
        tolerances={"default": 1e-9},
        reason="MuJoCo and Pinocchio hold the same masses and see the same q: only rounding may differ.",
        scales=("foot_length",),
        nature="extreme",
    ),
    Metric(
        name="angular_momentum_agreement_maximum",
        unit="N m s",
        label="momentum of both libraries, largest distance",
        meaning="largest difference of MuJoCo's and Pinocchio's angular momentum",
        kind="instrument",
        compute=lambda walk: walk.measured.self_checks.angular_momentum_agreement,
        tolerances={"default": 1e-8},
        reason="As for the COM; rounding grows with the momenta that are summed.",
        nature="extreme",
    ),
    Metric(
        name="failed_qp",
        unit="1",
        label="unsolved QPs",
        meaning="control ticks whose QP stayed unsolved",
        kind="instrument",
        compute=lambda walk: float(np.count_nonzero(walk.record.qp_status == 2)),
        tolerances={"default": 0.0},
        reason="The controller's fallback exists to survive a bad tick, not to walk: one unsolved QP means "
        "that the figures are not those of the controller that is documented.",
        nature="count",
    ),
    Metric(
        name="unsupported_instants",
        unit="1",
        label="instants without ground contact",
        meaning="instants without any contact force",
        kind="instrument",
        compute=lambda walk: float(
            np.count_nonzero(~np.isfinite(walk.measured.zmp[walk.inside]).all(axis=1))
        ),
        tolerances={"default": 0.0},
        reason="A walk has no flight, and an instant without a ZMP would silently be missing from its error.",
        nature="count",
    ),
)

_REPORTED_ERRORS = tuple(
    metric
    for signal in SIGNALS
    for metric in (_error(signal.name, "rmse"), _error(signal.name, "maximum"))
    if metric.name not in {item.name for item in _JUDGED_ERRORS}
)
_LARGEST_GAP = Metric(
    name="zmp_agreement_maximum",
    unit="m",
    label="both measured ZMPs, largest distance",
    meaning="largest distance of the ZMP by contact and by momentum",
    kind="instrument",
    compute=lambda walk: _largest(_zmp_gap(walk)),
    scales=("foot_length",),
    nature="extreme",
)


def _margin(name: str, unit: str, label: str, meaning: str) -> Metric:
    def compute(walk: Comparison) -> float:
        found = getattr(walk.margins, name)
        return float(getattr(found, "value", found))

    return Metric(
        f"margin_{name}", unit, label, meaning, "cost", compute, nature="extreme", section="margins"
    )


def _effort(name: str, column: int, unit: str, label: str, meaning: str) -> Metric:
    axis = "xyz"[column]
    return Metric(
        f"effort_{name}_{axis}", unit, f"feedback on the {label} {axis}, RMS",
        f"root mean square of commanded minus planned {meaning}", "cost",
        lambda walk: float(getattr(walk.effort, name)[column]), section="effort",
    )  # fmt: skip


def _energy(name: str, unit: str, label: str, meaning: str) -> Metric:
    return Metric(
        f"energy_{name}", unit, label, meaning, "cost",
        lambda walk: float(getattr(walk.energy, name)), section="energy",
    )  # fmt: skip


_POLYGON = "into the polygon of the points that carried force"
_COST = (
    _margin("torque", "1", "largest torque, of the motor's limit",
            "largest share of a motor's limit that was used"),
    _margin("saturated", "1", "time with a saturated motor",
            "share of the time in which some motor was at its limit"),
    _margin("friction", "1", "friction used by a loaded foot",
            "largest tangential over normal force of a foot that carries weight"),
    _margin("friction_net", "1", "friction used by the net force", "the same of the net ground force"),
    _margin("joint", "rad", "joint closest to its limit", "smallest distance of a joint from its range"),
    _margin("knee", "rad", "least knee flexion", "smallest knee flexion"),
    _margin("plan_polygon", "m", "planned ZMP within the planned support",
            "smallest distance of the planned ZMP into the planned support"),
    _margin("plan_in_measured_polygon", "m", "planned ZMP within the loaded sole",
            f"smallest distance of the planned ZMP {_POLYGON}"),
    _margin("measured_polygon", "m", "measured ZMP within the loaded sole",
            f"smallest distance of the measured ZMP {_POLYGON}"),
    _margin("slip", "m", "longest slip of a stance foot", "longest way that a foot slid in one stance"),
    _margin("penetration", "m", "deepest penetration of a sole", "deepest sole point under the floor"),
    *(_effort("force", column, "N", "force", "force") for column in range(3)),
    *(_effort("zmp", column, "m", "ZMP", "ZMP") for column in range(2)),
    *(_effort("angular_momentum", column, "N m s", "momentum", "angular momentum") for column in range(2)),
    _energy("positive_work", "J", "positive work", "positive work of the motors, without the first step"),
    _energy("negative_work", "J", "negative work", "negative work of the motors, without the first step"),
    _energy("distance", "m", "way of the COM", "way of the COM in that time"),
    _energy("cost_of_transport", "1", "mechanical cost of transport",
            "positive work over weight times distance (mechanical)"),
    _energy("mean_power", "W", "mean positive power", "positive work over time"),
)  # fmt: skip

_METRICS.update(
    {item.name: item for item in (*_JUDGED_ERRORS, *_INSTRUMENT, *_REPORTED_ERRORS, _LARGEST_GAP, *_COST)}
)

"""A walk beside its plan: error of each signal, causes of the ZMP error, cost.

Errors are measured minus planned at the same instant: row k of the measurement is compared with the plan at
t_k, and where the plan moved with the plan as it stood 0.1 s before (:mod:`validation.trial.followed`).
Nothing is shifted, fitted or masked; the first step, which includes the transient of the start, is reported
separately.
"""

import copyreg
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ampm.brief import Brief
from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.geometry import Array, Flags
from ampm.planner.centroidal import PlanSample
from ampm.walk import WalkPlan
from validation.judge.margins import energy, feedback_effort, margins
from validation.measure.measure import MeasuredGait
from validation.table import package_rows
from validation.trial.followed import LEADS, Followed, FrozenPlan, PlanRows
from validation.trial.record import SimulationRecord, heading_velocity, measured_supports
from validation.trial.shapes import Shapes

RUN = "run"
"""The window that is judged: the run without its first step, or all of it if it begins at rest."""

_PARTS = "com_position com_acceleration momentum_rate vertical_force instrument plan_residual"
PARTS: Mapping[str, str] = MappingProxyType(
    {name: name.replace("com_", "COM ").replace("_", " ") for name in _PARTS.split()}
)
"""Parts of the ZMP error, and their labels; see :class:`ZmpErrorSplit`."""

_CONSTANT = 1e-9


class Signal(NamedTuple):
    """One component of a measured vector, and its reference."""

    group: str  # vector that it belongs to, such as `zmp` or `left_foot`
    axis: str  # x, y or z; in ``signals.csv`` all of them
    unit: str  # SI unit
    quantity: str  # what the vector is, in words
    meaning: str  # of the error
    reference: str  # `plan`, or `motion` for quantities that the plan does not have

    @property
    def direction(self) -> str:
        """``along x``; of an angular momentum ``about x``."""
        return f"{'about' if self.group == 'angular_momentum' else 'along'} {self.axis}"

    @property
    def label(self) -> str:
        """Readable name, such as ``ZMP along x``."""
        return f"{self.quantity} {self.direction}"


SIGNALS: Mapping[str, Signal] = MappingProxyType(
    {
        f"{row['group']}_{axis}": Signal(**row | {"axis": axis})
        for row in package_rows("judge/signals.csv")
        for axis in row["axis"]
    }
)
"""All components that are compared, by name."""


def _read_only(items: Mapping[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(items)


# Python cannot pickle read-only views, and trials have them.
copyreg.pickle(MappingProxyType, lambda view: (_read_only, (dict(view),)))


@dataclass(frozen=True)
class Statistics:
    """Error of one signal in one window, measured minus reference."""

    count: int  # instants
    unmeasured: int  # instants without a measurement, which count in no other statistic
    rmse: float  # root mean square error [unit of the signal]
    maximum: float  # largest absolute error
    bias: float  # mean error
    # 1 - sum(error^2) / sum((reference - mean reference)^2); None where the reference does not vary
    r2: float | None


@dataclass(frozen=True)
class ZmpErrorSplit:
    """The ZMP error as a sum of causes, exact at every instant.

    With ``u = 1/F_z`` and ``N = z F_x + M_y`` the ZMP of plan and of momentum is ``x - N u``. A difference of
    products splits without remainder when each factor's difference is weighted with the other's mean over
    plan and measurement:

    - ``com_position``: ``dx - mean(u) mean(F_x) dz``
    - ``com_acceleration``: ``-mean(u) mean(z) dF_x``, with F_x = m x''
    - ``momentum_rate``: ``-mean(u) dM_y``
    - ``vertical_force``: ``-mean(N) du``
    - ``instrument``: contact ZMP minus momentum ZMP, which belongs to the measurement and not to the walk
    - ``plan_residual``: the ZMP ``x - N u`` of the plan's motion and force minus the ZMP that it states

    Lateral: F_y for F_x and -M_x for M_y. The split does not depend on an order of the causes.
    """

    parts: Mapping[str, Array]  # part to its values, shape (K, 2) [m]
    residual: float  # largest deviation of the sum of parts from the error [m]
    rmse: Mapping[str, tuple[float, ...]]  # part to its RMS over the run, x and y [m]
    # part to its share of the squared error, x and y [1]: they add up to 1; negative where it compensates
    share: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Comparison(Brief):
    """A walk beside its plan, from which metrics are computed."""

    plan: WalkPlan  # that was walked, the first one if it moved
    record: SimulationRecord  # of the simulation
    measured: MeasuredGait  # measurement of the record, independent of the plan
    # the plan at the K measured instants t_k, as it stood `followed.lead` before each: it is judged
    sample: PlanRows
    rows: Mapping[str, Flags]  # window to rows, shape (K,); phases and contacts divide :data:`RUN`
    scales: Mapping[str, float]  # `body_weight` [N] and `foot_length` [m]
    signals: Mapping[str, Mapping[str, Statistics]]  # by signal and window
    zmp_split: ZmpErrorSplit  # causes of the ZMP error
    costs: Mapping[str, Mapping[str, Any]]  # `effort`, `margins`, `energy`, see `validation.judge.margins`
    followed: Followed  # the plans one after another
    valid: PlanSample  # the plan valid at these instants
    # by lead of the plan, see `LEADS`: RMS error of every signal in the judged window
    ahead: Mapping[float, Mapping[str, float]]
    first: PlanSample | None = None  # the first plan at the same instants; None if the plan did not move
    # limits by metric of errors after a push, and of the time until they hold, in SI units; others have none
    recovery_limits: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def time(self) -> Array:
        """Instants compared, shape (K,) [s]."""
        return self.measured.time

    @property
    def inside(self) -> Flags:
        """Rows that are judged, shape (K,)."""
        return self.rows[RUN]


def compare(
    plan: WalkPlan,
    record: SimulationRecord,
    measured: MeasuredGait,
    *,
    description: BodyDescription | None = None,
    shapes: Shapes | None = None,
    counts: Array | None = None,
) -> Comparison:
    """Compare a walk, up to its end, with the plan that was walked.

    The description names the knees; shapes are the body's, for the clearance of its parts; counts are the
    time steps that each instant stands for, shape (K,) [1], by default 1. Of a walk without a plan, all that
    is planned is NaN but the phases, which are those of the contacts; and ``costs`` has its ``velocity``:
    ``commanded``, and the mean ``measured`` in the second half of its time. Raises :class:`InputError` if the
    walk is longer than the plan, or the measurement is of another walk.
    """
    time, each = measured.time, np.ones(measured.time.size) if counts is None else counts
    if time.size != record.steps:
        raise InputError(
            f"the measurement has {time.size} steps and the record {record.steps}; measure this record"
        )
    followed = record.followed or Followed((FrozenPlan.of(plan, time),))
    end = followed.plans[-1].plan.duration
    if time.size and time[-1] > end + 1e-9:
        raise InputError(
            f"the record lasts until {time[-1]:.6g} s, the plan only {end:.6g} s; "
            "compare the run with the plan that was walked"
        )
    planned = valid = followed.at(time)
    first = None
    if followed.moved:
        planned, first = followed.at(time, followed.lead), followed.plans[0].rows.at(time)
    if plan.command is not None:
        planned = valid = planned.without_plan(measured_supports(record)[0])
    rows = _windows(followed, planned, record, measured)
    run = rows[RUN]
    costs: dict[str, Mapping[str, Any]] = {
        "effort": feedback_effort(record, valid, run),
        "margins": margins(followed, record, measured, description, shapes),
        "energy": energy(record, run),
    }
    if plan.command is not None:
        late = time >= 0.5 * (plan.command.settling + plan.command.duration)
        mean = heading_velocity(record)[late].mean(axis=0) if late.any() else np.full(3, np.nan)
        costs["velocity"] = {"commanded": plan.command.at(math.inf), "measured": tuple(mean.tolist())}
    signals, ahead = _errors(signal_pairs(planned, measured, record), rows, each), {}
    for lead in LEADS:
        judged = signals
        if followed.moved:
            judged = _errors(signal_pairs(followed.at(time, lead), measured, record), {RUN: run}, each)
        ahead[lead] = MappingProxyType({name: windows[RUN].rmse for name, windows in judged.items()})
    scales = {"body_weight": measured.weight, "foot_length": (description or plan.feet).sole.length}
    return Comparison(
        plan=plan,
        record=record,
        measured=measured,
        sample=planned,
        rows=MappingProxyType(rows),
        scales=MappingProxyType(scales),
        signals=MappingProxyType(signals),
        zmp_split=_split_zmp_error(planned, measured, run),
        costs=MappingProxyType({name: MappingProxyType(cost) for name, cost in costs.items()}),
        followed=followed,
        valid=valid,
        ahead=MappingProxyType(ahead),
        first=first,
    )


def _windows(
    followed: Followed, planned: PlanRows, record: SimulationRecord, measured: MeasuredGait
) -> dict[str, Flags]:
    """Rows of every window, shape (K,), read-only."""
    time, feet = measured.time, measured.foot_contact.sum(axis=1)
    begin = np.array([item.plan.judged_from for item in followed.plans])[followed.of_planner(time)]
    if pushed := push_rows(record):  # a slow first step does not hide a push
        begin = np.minimum(begin, time[pushed[0][0]])
    run = np.logical_or.accumulate(time >= begin - 1e-9)
    rows = {
        RUN: run,
        "first_step": ~run,
        "single_support": run & (planned.phase == 0),
        "double_support": run & (planned.phase == 1),
        "measured_single_support": run & (feet == 1),
        "measured_double_support": run & (feet == 2),
        "measured_flight": run & (measured.force[:, 2] <= 0.0),
    }
    for array in rows.values():
        array.setflags(write=False)
    return rows


def _errors(
    pairs: Mapping[str, tuple[Array, Array]], windows: Mapping[str, Flags], counts: Array
) -> dict[str, Mapping[str, Statistics]]:
    """Errors of all :func:`signal_pairs` in some windows."""
    found: dict[str, Mapping[str, Statistics]] = {}
    for name, (value, reference) in pairs.items():
        error = value - reference
        parts = {window: statistics(error[w], reference[w], counts[w]) for window, w in windows.items()}
        found[name] = MappingProxyType(parts)
    return found


def signal_pairs(
    planned: PlanRows, measured: MeasuredGait, record: SimulationRecord
) -> dict[str, tuple[Array, Array]]:
    """Measured and planned values of all :data:`SIGNALS`, both of shape (K,)."""
    feet, momentum = planned.feet, np.column_stack([planned.angular_momentum, planned.momentum_z])
    vectors = {
        "zmp": (measured.zmp, planned.zmp),
        "zmp_foot": _from_standing_foot(planned, measured, record.foot_forward[: len(planned)]),
        "force": (measured.force, planned.force),
        "angular_momentum": (measured.angular_momentum, momentum),
        "com": (measured.com, planned.com),
        "left_foot": (measured.foot_position[:, 0], feet[:, :3]),
        "right_foot": (measured.foot_position[:, 1], feet[:, 3:]),
    }
    columns = {name: (*vectors[signal.group], "xyz".index(signal.axis)) for name, signal in SIGNALS.items()}
    return {name: (value[:, k], reference[:, k]) for name, (value, reference, k) in columns.items()}


def _from_standing_foot(planned: PlanRows, measured: MeasuredGait, forward: Array) -> tuple[Array, Array]:
    """ZMP from the standing foot, along and across its heading, measured and planned, shapes (K, 2) [m].

    With two loaded feet it is the mean, weighted by the measured loads. The place of the walk in the world
    does not count: an estimator without fixes of the position cannot know it.
    """
    load = np.maximum(measured.foot_force[:, :, 2], 0.0)
    load = load / np.where(load.any(axis=1), load.sum(axis=1), np.nan)[:, None]
    along = forward[..., :2] / np.hypot(forward[..., :1], forward[..., 1:2])
    heading = np.stack([np.cos(planned.headings), np.sin(planned.headings)], axis=-1)
    found = _along(measured.zmp[:, None] - measured.foot_position[..., :2], along)
    wanted = _along(planned.zmp[:, None] - planned.feet.reshape(-1, 2, 3)[..., :2], heading)
    return (load[..., None] * found).sum(axis=1), (load[..., None] * wanted).sum(axis=1)


def _along(vectors: Array, heading: Array) -> Array:
    """Components along and across unit vectors in the floor, all of shape (..., 2)."""
    across = heading[..., 0] * vectors[..., 1] - heading[..., 1] * vectors[..., 0]
    return np.stack([(vectors * heading).sum(axis=-1), across], axis=-1)


def push_rows(record: SimulationRecord) -> list[tuple[int, int]]:
    """First row of every push, and the row after its end; a force that acts all the time is no push."""
    if not record.external_force.size:
        return []
    force = np.concatenate([record.external_force, record.external_moment], axis=-1)
    lasts = np.asarray(force.any(axis=2).all(axis=0))[:, None]
    acts: Flags = (force - np.median(force, axis=0) * lasts).any(axis=(1, 2))
    changes = np.flatnonzero(np.diff(acts, prepend=False, append=False)).tolist()
    return list(zip(changes[::2], changes[1::2], strict=True))


def statistics(error: Array, reference: Array, counts: Array) -> Statistics:
    """Statistics of an error from a reference, NaN where not measured, with counts as weights; all (n,)."""
    known = np.isfinite(error)
    unmeasured = int(error.size - np.count_nonzero(known))
    if not known.any():
        return Statistics(error.size, unmeasured, math.nan, math.nan, math.nan, None)
    error, reference, counts = error[known], reference[known], counts[known]
    squares, size = float(np.sum(counts * error * error)), float(np.sum(counts))
    mean = float(np.sum(counts * reference)) / size
    varies = float(np.ptp(reference)) > _CONSTANT * max(1.0, float(np.abs(reference).max()))
    return Statistics(
        count=int(known.size),
        unmeasured=unmeasured,
        rmse=float(np.sqrt(squares / size)),
        maximum=float(np.abs(error).max()),
        bias=float(np.sum(counts * error)) / size,
        r2=1.0 - squares / float(np.sum(counts * (reference - mean) ** 2)) if varies else None,
    )


def _split_zmp_error(sample: PlanSample, measured: MeasuredGait, rows: Flags) -> ZmpErrorSplit:
    """Split the ZMP error into its causes; RMS and shares over ``rows``, shape (K,)."""
    com, z = measured.com_pin, (measured.com_pin[:, 2] - measured.floor)[:, None]  # as of zmp_momentum
    z_plan = (sample.com[:, 2] - sample.floor)[:, None]
    supported = np.isfinite(measured.zmp_momentum[:, :1])
    u_plan, u = 1.0 / sample.force[:, 2:], 1.0 / np.where(supported, measured.momentum_force[:, 2:], np.nan)
    force_plan, force = sample.force[:, :2], measured.momentum_force[:, :2]
    moments = sample.moment, measured.angular_momentum_rate
    moment_plan, moment = (values[:, 1::-1] * [1.0, -1.0] for values in moments)
    mean_u, mean_z, mean_force = 0.5 * (u_plan + u), 0.5 * (z_plan + z), 0.5 * (force_plan + force)
    total = z_plan * force_plan + moment_plan + (z * force + moment)
    parts = {
        "com_position": com[:, :2] - sample.com[:, :2] - mean_u * mean_force * (z - z_plan),
        "com_acceleration": -mean_u * mean_z * (force - force_plan),
        "momentum_rate": -mean_u * (moment - moment_plan),
        "vertical_force": -0.5 * total * (u - u_plan),
        "instrument": measured.zmp - measured.zmp_momentum,
        "plan_residual": sample.com[:, :2] - (z_plan * force_plan + moment_plan) * u_plan - sample.zmp,
    }
    error = measured.zmp - sample.zmp
    for array in parts.values():
        array.setflags(write=False)
    gap = np.abs(sum(parts.values()) - error)
    used = rows & np.isfinite(error).all(axis=1)
    squares, rmse, share = np.sum(error[used] ** 2, axis=0), {}, {}
    with np.errstate(invalid="ignore", divide="ignore"):
        for name, part in parts.items():
            rmse[name] = tuple(np.sqrt(np.sum(part[used] ** 2, axis=0) / used.sum()).tolist())
            share[name] = tuple((np.sum(part[used] * error[used], axis=0) / squares).tolist())
    residual = float(np.nanmax(gap)) if np.isfinite(gap).any() else math.nan
    return ZmpErrorSplit(MappingProxyType(parts), residual, MappingProxyType(rmse), MappingProxyType(share))

"""A log on clock and floor of a plan: start by cross-correlation, place by the mean ZMP, mean stride."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import correlate, detrend, find_peaks

from ampm.exceptions import InputError
from ampm.geometry import Array, Flags
from ampm.walk import WalkPlan
from validation.judge.compare import SIGNALS
from validation.judge.metrics import display_unit
from validation.measure.log import HOLE, LOADED, PLACES, Log

_PHASES = 200  # instants of the mean stride
_GRID = 0.005  # of the cross-correlation [s]
_NEAR = 20  # intervals of it on both sides of its maximum in which the start is searched
_CONSTANT = 1e-3  # standard deviation below which a planned signal is constant and tells no time
_LEAST = 0.5  # correlation up to which a start is a guess [1]
_ALIKE = 0.995  # share of the largest correlation from which strides fit alike [1]
_WHOLE = 0.8  # share of the weight from which a foot counts as the one that stands [1]
_RESTS = 0.5  # force along the floor that a walk exceeds in every step, over the plan's RMS [1]
_STANDS = 1.5  # time without such a force over the plan's longest step, or of a stride over the median [1]
_CLIMBS = 0.08  # most rise of a COM over that of the plan's on a way as long, over its height [1]
_FAR = 1.0  # least such way [m]
_REPEATED = 1e-6  # difference of the forces of equal strides, over the weight [1]
_LEAST_JUDGED = 0.5  # that a log must share with the judged steps of a plan, about that of a step [s]
_KNOWN = 0.5  # least share of one kind of phase that a log has, over that of the other kind [1]
_UNEVEN = 0.01  # share of time between rows farther apart than most from which it is told [1]
_LEFT_OUT = 0.01  # share of time or rows whose gaps a full pass may have [1]


@dataclass(frozen=True)
class MeanStride:
    """The strides of a log whose mean is compared with that of a plan."""

    # RMS over the stride of the standard deviation along x, y, z, by signal: of force [N], ZMP without steady
    # motion [m] and angular momentum about the COM [N m s]
    spreads: Mapping[str, Array]
    spread: Array  # that of the force over the weight, shape (3,) [1]
    count: int  # strides
    duration: float  # mean [s]
    speed: float  # mean along x [m/s], NaN without a place
    correlation: float  # of their mean with the plan [1]


@dataclass(frozen=True)
class LogFacts:
    """A log and how it is laid on clock and floor of a plan; in a summary ``log``, without what is None."""

    rows: int  # of the log
    rate: float  # its usual one [Hz]
    strides: MeanStride | None  # that the log is the mean of
    correlation: float | None  # of log and plan where a start was found [1]
    beside: int | None  # steps of the log before and after the plan whose start was found
    start: float | None  # of the plan on the log's clock [s]
    left_out: float  # share of the judged time without force or ZMP [1]
    empty: float  # share of the judged rows without angular momentum [1]
    place: tuple[float, float]  # what is added to x and y of the log, for places in the plan's frame [m]
    from_: float  # first instant that is compared, on the plan's clock [s]
    until: float  # the last one [s]
    notes: list[str]  # sentences
    steps: int | None  # of the plan that are whole in the log; None of strides, as the following
    planned_steps: int | None  # all of the plan

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> Self:
        """Those of a summary, its strides as a mapping."""
        known = {"left_out": 0.0, "empty": 0.0, **entry}  # which folders of earlier versions lack
        values: dict[str, Any] = {item.name: known.get(item.name.rstrip("_")) for item in fields(cls)}
        return cls(**values)

    def as_dict(self) -> dict[str, Any]:
        """Entry of a summary."""
        return {name.rstrip("_"): value for name, value in vars(self).items() if value is not None}

    @property
    def lacks(self) -> list[str]:
        """What keeps it from a full pass, beside signals, for a sentence."""
        is_part = (self.steps or 0) < (self.planned_steps or 0)
        known = {
            f"{100 * self.left_out:.1f} % of the time is left out": self.left_out > _LEFT_OUT,
            f"the angular momentum is empty in {100 * self.empty:.1f} % of the rows": self.empty > _LEFT_OUT,
            f"the part that is like the plan lacks {self.beside} of the log's steps": self.beside and is_part,
            "no step of the plan is whole": self.steps == 0,
        }
        return [text for text, holds in known.items() if holds]


def align(
    log: Log, plan: WalkPlan, start: float | None, place: tuple[float, float] | None, *, strides: bool
) -> tuple[Log, LogFacts]:
    """Lay a log, or the mean of its strides, on clock and floor of a plan.

    Start [s] and place, what to add to x and y [m], are found if None. Raises :class:`InputError` if the log
    is too short, or unlike the plan.
    """
    if log.duration < _LEAST_JUDGED:
        raise InputError(
            f"{log.name} lasts {log.duration:.3g} s, and needs {_LEAST_JUDGED:g} s; give a longer log."
        )
    raw, notes, mean, correlation, beside = log, _notes_on_rows(log), None, None, None
    if strides:
        _check_climb(log, plan, np.linspace(plan.judged_from, plan.duration, _PHASES))
        log, mean = _mean_stride(log, plan)
        notes.append(_note_on_strides(mean, plan, log.weight))
    else:
        if start is None:
            start, correlation = _find_start(log, plan)
            notes.append(f"The plan begins at {start:z.4f} s of the log, by correlation ({correlation:.3f}).")
            beside = _steps_beside(log, start - log.time_step, start + plan.duration)
            if beside:
                notes.append(f"Steps of the log before and after the plan, which are not judged: {beside}.")
        time = log.time - start
        log = replace(log, time=time).rows((time >= 0.0) & (time <= plan.duration + 1e-9))
    judged = _judged(log, plan, start or 0.0)
    late = judged.time[0] - max(plan.judged_from, log.time[0])  # of a gap over the begin
    left_out, empty = _missing(raw if strides else judged, late, strides=strides)
    _check_phases(judged, plan)
    if not strides:
        _check_climb(judged, plan, judged.time)
    by, mean_of, turn = _find_place(judged, plan)
    if place is not None:
        by = np.array(place)
    elif mean_of:
        notes.append(
            f"The log is moved by {by[0]:.4g} m along x and {by[1]:.4g} m along y, to the mean of the plan's "
            f"{mean_of}: its bias is not judged."
        )
    if mean_of and not strides:
        side = "left" if turn > 0.0 else "right"
        notes.append(
            f"Its way is turned by {abs(math.degrees(turn)):.2f} degrees to the {side} of the plan's."
        )
    notes.append(
        f"{log.time.size} instants of the plan are compared, {log.time[0]:.3f} to {log.time[-1]:.3f} s, and "
        f"judged from {judged.time[0]:.3f} s."
    )
    facts = LogFacts(
        rows=raw.time.size,
        rate=1.0 / raw.time_step,
        strides=mean,
        correlation=correlation,
        beside=beside,
        start=start,
        left_out=left_out,
        empty=empty,
        place=(float(by[0]), float(by[1])),
        from_=float(log.time[0]),
        until=float(log.time[-1]),
        notes=notes,
        steps=None if strides else whole_steps(log, plan),
        planned_steps=None if strides else plan.contacts.steps,
    )
    return log.moved(by), facts


def _judged(log: Log, plan: WalkPlan, start: float) -> Log:
    """The judged rows of a log on the clock of a plan, which began at ``start`` [s]; refused if too few."""
    judged = log.rows(log.time >= plan.judged_from - 1e-9)
    span = judged.duration if judged.time.size else 0.0
    if span < _LEAST_JUDGED:
        raise InputError(
            f"{log.name} has {judged.time.size} rows over {span:.3g} s, and needs {_LEAST_JUDGED:g} s, "
            f"between {plan.judged_from:.4g} and {plan.duration:.4g} s of the plan, which begins at "
            f"{start:.6g} s; give a longer log, or another start (--start)."
        )
    return judged


def _missing(log: Log, late: float, *, strides: bool) -> tuple[float, float]:
    """Shares of a log's time that are left out, and of its rows without angular momentum [1].

    It begins ``late`` [s]. Of strides the time is left out, too, while nothing carries the body.
    """
    lost = log.lost[1:].sum() + min(log.lost[0], max(late, 0.0))
    light = log.counts @ (log.signals["force"][:, 2] < LOADED * log.weight) if strides else 0.0
    empty = np.isnan(log.signals.get("angular_momentum", np.zeros((1, 3)))).any(axis=1)
    left_out = (lost + log.time_step * light) / (log.duration + lost)
    return float(left_out), float(empty.mean())


def _check_phases(log: Log, plan: WalkPlan) -> None:
    """Refuse a log that lacks most of one kind of phase, between its first and last row."""
    time = np.arange(log.time[0], log.time[-1] + 0.5 * log.time_step, log.time_step)
    late = np.searchsorted(log.time, time).clip(1, log.time.size - 1)
    apart = np.minimum(np.abs(time - log.time[late - 1]), np.abs(time - log.time[late]))
    phases = plan.sample(np.minimum(time, plan.duration)).phase_name
    known = {str(kind): float((apart < log.time_step)[phases == kind].mean()) for kind in np.unique(phases)}
    if min(known.values()) < _KNOWN * max(known.values()):
        kinds = " and ".join(f"{100 * share:.0f} % of the {kind}s" for kind, share in known.items())
        way_out = "give a log without such gaps"
        if log.signals.keys() & {"left_force", "right_force"}:
            way_out = "fill its empty cells, with 0 for force and torque of a foot in the air"
        raise InputError(f"{log.name} has force and ZMP in {kinds.replace('_', ' ')} of the plan; {way_out}.")


def _notes_on_rows(log: Log) -> list[str]:
    """Sentences on rate, force and gaps of a log."""
    share = float(log.signals["force"][:, 2].mean()) / log.weight
    notes = [
        f"{log.name}: {log.time.size} rows at {1.0 / log.time_step:.4g} Hz; the mean vertical force is "
        f"{100 * share:.1f} % of the plan's weight."
    ]
    if (gaps := log.lost[1:][log.lost[1:] > 0.0]).size:
        of = f"{gaps.size} of {gaps.sum():.3g} s in all, the longest {gaps.max():.3g} s"
        notes.append(f"Gaps that are left out: {of}.")
    if (counts := log.counts)[counts > 1.0].sum() > _UNEVEN * counts.sum():
        notes.append("A row counts for the time until the next: give a log of one rate if it has several.")
    return [*notes, log.unsupported] if log.unsupported else notes


def _note_on_strides(mean: MeanStride, plan: WalkPlan, weight: float) -> str:
    """A sentence on the strides of a log, for a body with a weight [N]."""
    spreads = []
    for name, values in mean.spreads.items() if mean.count > 1 else ():
        factor, unit = display_unit(SIGNALS[f"{name}_x"].unit, weight)
        numbers = "/".join(f"{factor * value:.3g}" for value in values)
        spreads.append(f"{SIGNALS[f'{name}_x'].quantity} {numbers} {unit}")
    return (
        f"Mean of {mean.count} stride{'s' * (mean.count > 1)} of {mean.duration:.4g} s at "
        f"{mean.speed:.3g} m/s, over the share of the stride; the plan's have "
        f"{2.0 * plan.constants.step_duration:.4g} s and {plan.constants.mean_velocity:.3g} m/s."
        + f" Standard deviation between strides, x/y/z: {', '.join(spreads)}."
        * bool(spreads)
    )


def whole_steps(log: Log, plan: WalkPlan) -> int:
    """Steps of the plan within a log; at its ends it may lack as little time as is no gap."""
    ends, near = np.array([0.0, *plan.contacts.step_ends]), max(2.0 * log.time_step, HOLE)
    return int(np.count_nonzero((ends[:-1] >= log.time[0] - near) & (ends[1:] <= log.time[-1] + near)))


def _find_start(log: Log, plan: WalkPlan) -> tuple[float, float]:
    """Where a plan begins in a log [s], by correlation of force and lateral ZMP, and the correlation [1].

    Each signal is divided by its standard deviation in the plan. If several strides fit alike, the middle one
    is taken. The start is then refined to where the difference of the ZMPs (without a ZMP, of the forces) has
    the least variance. Raises :class:`InputError` if the log matches the plan nowhere, or stands between two
    walks.
    """
    measured = log.signals["force"] / log.weight
    if "zmp" in log.signals:
        measured = np.column_stack([measured, log.signals["zmp"][:, 1]])

    def planned(times: Array) -> Array:
        sample = plan.sample(times)
        return np.column_stack([sample.force / plan.weight, sample.zmp[:, 1]])[:, : measured.shape[1]]

    wanted = planned(np.arange(0.0, plan.duration, _GRID))
    spread = wanted.std(axis=0)
    spread = np.where(spread > _CONSTANT, spread, np.inf)

    def within(start: float) -> Flags:
        return (log.time >= start) & (log.time <= start + plan.duration)

    def difference(start: float) -> float:
        rows = within(start)
        sample = plan.sample(log.time[rows] - start)
        name, values = ("zmp", sample.zmp) if "zmp" in log.signals else ("force", sample.force)
        return float(np.nanvar(log.signals[name][rows] - values, axis=0).sum())

    clock = np.arange(log.time[0], log.time[-1], _GRID)
    even = interp(clock, log.time, _centred(measured))
    pairs = zip((even / spread).T, (_centred(wanted) / spread).T, strict=True)
    total = sum(correlate(one, other, method="fft") for one, other in pairs)
    peaks = find_peaks(np.concatenate([[-np.inf], total, [-np.inf]]))[0] - 1
    alike = peaks[total[peaks] >= _ALIKE * total[peaks].max()]
    coarse = log.time[0] + _GRID * (int(alike[len(alike) // 2]) - (len(wanted) - 1))
    near = coarse + _GRID * np.arange(-_NEAR, _NEAR + 1)  # less than a stride has a mean of its own
    best = near[np.argmin([difference(start) for start in near])]
    finest = minimize_scalar(  # from there, as its tolerance is relative to a clock's large numbers
        lambda off: difference(best + off), bounds=(-_GRID, _GRID), method="bounded", options={"xatol": 1e-6}
    )
    start = float(best + finest.x)
    rows, why = np.flatnonzero(within(start)), ""
    one, other = (_centred(values / spread) for values in (measured[rows], planned(log.time[rows] - start)))
    product = float(np.sum(one**2) * np.sum(other**2))
    correlation = float(np.sum(one * other)) / math.sqrt(product or math.inf)
    if not correlation > _LEAST:
        why = f"matches the plan nowhere: the correlation of force and ZMP is {correlation:.2f} and must be "
        why += f"more than {_LEAST:g}; give x forward and y left, another plan"
    least = _RESTS * math.sqrt(2.0 * np.mean(wanted[:, :2] ** 2))
    walks = np.concatenate([rows[:1], rows[np.hypot(*measured[rows, :2].T) > least], rows[-1:]])
    lasts = np.diff((log.time - log.lost.cumsum())[walks])
    if (lasts > _STANDS * np.diff(plan.contacts.step_ends, prepend=0.0, append=plan.duration).max()).any():
        begin, end = log.time[walks[lasts.argmax() :][:2]]
        why = f"stands, or walks slower than the plan, from {begin:.2f} to {end:.2f} s: the force along the "
        why += f"floor is less than {100 * least:.1f} % of the weight; give one walk, fewer gait.steps"
    if why:
        raise InputError(f"{log.name} {why}, or its start (--start)." + f" {log.unsupported}".rstrip())
    return start, correlation


def interp(times: Array, time: Array, values: Array, period: float | None = None) -> Array:
    """Values (K, n) or (K,), maybe periodic [s], at other times (...), shape (..., n) or (...)."""
    return np.apply_along_axis(lambda column: np.interp(times, time, column, period=period), 0, values)


def _centred(values: Array) -> Array:
    """Columns less their means; zero where not measured."""
    return np.nan_to_num(values - np.nanmean(values, axis=0))


def _find_place(log: Log, plan: WalkPlan) -> tuple[Array, str, float]:
    """Shift that gives a log's places the plan's mean (2,) [m], of ``ZMP`` or ``COM``, and turn of its path.

    The turn is to the left of the plan's path [rad]. Of a log without places the name is empty.
    """
    sample = plan.sample(log.time)
    for name, wanted in (("zmp", sample.zmp), ("com", sample.com[:, :2])):
        if np.isfinite(log.signals.get(name, np.nan)).any():
            given = log.signals[name][:, :2]
            (x, y), (u, v) = (_centred(way).T for way in (wanted, given))
            return np.nanmean(wanted - given, axis=0), name.upper(), math.atan2(x @ v - y @ u, x @ u + y @ v)
    return np.zeros(2), "", 0.0


def _check_climb(log: Log, plan: WalkPlan, times: Array) -> None:
    """Refuse a COM that climbs or sinks, in the mean, unlike the plan's at some times [s]."""
    com = log.signals.get("com", np.empty((0, 3)))
    com = com[np.isfinite(com).all(axis=1)]
    slopes, far = [], 0.0
    for way in (plan.sample(times).com, com):
        away = np.hypot(*(way - way[:1])[:, :2].T)
        far = away.max(initial=0.0)
        if far < _FAR:
            return
        slopes.append(float(np.polyfit(away, way[:, 2], 1)[0]))
    planned, found = slopes
    if abs(found - planned) * far > _CLIMBS * com[:, 2].mean():
        raise InputError(
            f"{log.name}: the COM climbs by {found:z.3f} m a metre, the plan's by {planned:z.3f}; plan the "
            "floor (gait.slope, or footsteps with z), or leave out the columns of com."
        )


def _mean_stride(log: Log, plan: WalkPlan) -> tuple[Log, MeanStride]:
    """Average the strides of a log; each begins when the left foot takes half of the weight.

    The mean is taken at equal shares of the strides, and gets the plan's duration and mean speed. NaN is left
    out.

    Returns:
        The mean stride on the clock of the plan, and of which strides it is.

    Raises:
        InputError: the steps of the plan differ, or the log has no whole stride without a gap.
    """
    stride, phases = 2.0 * plan.constants.step_duration, np.arange(_PHASES) / _PHASES
    times = plan.judged_from + stride * phases
    two = plan.sample(np.minimum([times, times + stride], plan.duration).ravel()).force.reshape(2, -1, 3)
    if times[-1] + stride > plan.duration or np.ptp(two, axis=0).max() > _REPEATED * plan.weight:
        raise InputError("the plan has no two equal strides; give a periodic gait of 5 steps or more.")
    taken = take_overs(log.time, left_share(log))
    bounds = whole_strides(log, taken)
    if not bounds:
        raise InputError(
            f"{log.name} has no whole stride without a gap: the left foot takes half of the weight at "
            f"{len(taken)} instants; give a longer log."
        )
    begin, end = np.array(bounds).T
    duration = float(np.mean(end - begin))
    at = begin[:, None] + (end - begin)[:, None] * phases
    sampled = {name: interp(at, log.time, values) for name, values in log.signals.items()}
    curves: dict[str, Any] = {name: np.ma.masked_invalid(values) for name, values in sampled.items()}
    speed = math.nan
    for name in ("belt_way", "zmp", "com"):
        if name in curves:
            way = log.signals[name].reshape(log.time.size, -1)[:, 0]
            known = np.isfinite(way)
            ends = np.interp([begin, end], log.time[known], way[known])
            speed = float(np.mean((ends[1] - ends[0]) / (end - begin)))
    varied = {name: curves[name] for name in curves if name in {"force", "zmp", "angular_momentum"}}
    for name in PLACES & curves.keys():
        curves[name][..., 0] -= speed * (at - begin[0])
        middle = curves[name][..., :2].mean(axis=1, keepdims=True)
        curves[name][..., :2] -= middle
        if name == "zmp":
            varied[name] = curves[name] + detrend(middle, axis=0)
    mean = {name: values.mean(axis=0).filled(np.nan) for name, values in curves.items()}
    velocity = [plan.constants.mean_velocity, 0.0]  # of places that are compared with the plan's
    clock = stride * np.arange(3 * _PHASES) / _PHASES
    tiled = {name: np.concatenate(3 * [values]) for name, values in mean.items()}
    thrice = replace(log, time=clock, signals=tiled, lost=np.zeros(clock.size))
    start, correlation = _find_start(thrice.moved(np.outer(clock, velocity)), plan)
    phases *= stride
    signals = {name: interp(times + start, phases, values, period=stride) for name, values in mean.items()}
    once = replace(log, time=times, signals=signals, lost=np.zeros(_PHASES), time_step=stride / _PHASES)
    variances = {name: values.var(axis=0, ddof=min(len(bounds) - 1, 1)) for name, values in varied.items()}
    spreads = {name: np.sqrt(values.mean(axis=0)).filled(np.nan) for name, values in variances.items()}
    share = spreads["force"] / log.weight
    strides = MeanStride(spreads, share, len(bounds), duration, speed, correlation)
    return once.moved(np.outer(times, velocity)), strides


def whole_strides(log: Log, taken: Array, margin: float = 0.0) -> list[tuple[float, float]]:
    """Begins and ends of the strides between instants [s], if they, and a margin [1] around, have no gap.

    A stride that lasts much longer than the median is a stand, and is left out.
    """
    gaps, found = np.flatnonzero(np.diff(log.time) > max(1.5 * log.time_step, HOLE)), []
    leaves, returns = log.time[gaps], log.time[gaps + 1]
    for begin, end in pairwise(taken.tolist()):
        first, last = begin - margin * (end - begin), end + margin * (end - begin)
        whole = (
            log.time[0] <= first and last <= log.time[-1] and not ((returns > first) & (leaves < last)).any()
        )
        if whole and end - begin <= _STANDS * np.median(np.diff(taken)):
            found.append((begin, end))
    return found


def left_share(log: Log) -> Array:
    """Share of the vertical force on the left foot, shape (K,) [1]; NaN where not known.

    Without forces of either foot it is how far the ZMP has moved from the right foot to the left one.
    """
    vertical = log.signals["force"][:, 2]
    share = np.full(vertical.size, np.nan)
    if "left_force" in log.signals:
        share = log.signals["left_force"][:, 2] / np.where(vertical > 0.0, vertical, np.nan)
    elif "zmp" in log.signals:
        right, left = np.nanquantile(log.signals["zmp"][:, 1], (0.1, 0.9))
        share = (log.signals["zmp"][:, 1] - right) / (left - right or math.nan)
    return np.where(vertical >= LOADED * log.weight, share, np.nan)


def _steps_beside(log: Log, begin: float, end: float) -> int:
    """How often the load goes from foot to foot before one time [s] and after another."""
    share = left_share(log)
    taken = np.concatenate([take_overs(log.time, one) for one in (share, 1.0 - share)])
    return int(np.count_nonzero((taken < begin) | (taken > end)))


def take_overs(time: Array, share: Array) -> Array:
    """Instants at which the left foot takes half of the weight [s], shape (n,).

    The share of the weight on it has shape (K,) [1], NaN where no foot is loaded.
    """
    known = np.isfinite(share)
    if not known.any():
        return np.zeros(0)
    share = np.interp(time, time[known], share[known])
    decided = np.flatnonzero((share >= _WHOLE) | (share <= 1.0 - _WHOLE))
    left = share[decided] >= _WHOLE
    found = []
    for k in np.flatnonzero(left[1:] & ~left[:-1]):
        rows = np.arange(decided[k], decided[k + 1])
        row = rows[(share[rows] < 0.5) & (share[rows + 1] >= 0.5)][-1]
        found.append(np.interp(0.5, share[[row, row + 1]], time[[row, row + 1]]))
    return np.array(found)

"""Constants of the AMPM from a measured walk: regressions for each axis and support, tested on other strides.

A stride is cut where the lateral ZMP leaves one foot and reaches the next. In each of its four phases ZMP and
ground force are linear in the COM (``docs/theory.md``): the slope of the ZMP is 1/a, that of the force, times
H over the weight, is c - 1/a. The COM is the double integral of the force; its constants are fitted to the
measured COM, or make the stride periodic if there is none.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from scipy.stats import sem
from scipy.stats import t as student

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY
from validation.judge.log import interp, left_share, take_overs, whole_strides
from validation.measure.log import Log

SUPPORTS: Mapping[str, list[int]] = {"single": [0, 2], "double": [1, 3]}
"""Phases of a stride by support; it begins with the single support on the left foot."""
MODELS = ("pendulum", "rolling", "ampm")
"""c = 1 and a ZMP that rests under a foot, and is below the COM in double support; c = 1; a, b and c free."""
EXPLAINED = ("zmp_x", "zmp_y", "force_x", "force_y", "force_z", "angular_momentum_x", "angular_momentum_y")
"""Signals that the models explain [m, N, N m s]; the angular momentum as :func:`_closed` makes it."""
CONFIDENCE = 0.95
_LEAST_STRIDES = 3
_POINTS = 50  # of a phase
_MARGIN = 0.25  # share of a stride before and after it that a log must have, too [1]
_BRIEFEST = 0.2  # stride [s]
_DEGREE = 9  # of the polynomial from integrated to measured COM, over 1.5 strides
_ALIKE = 0.1, 0.15  # most difference of a stride's duration and length from the median, over it [1]
_SHORTEST = 0.05  # stride [m]: below it nothing walks
_ASIDE, _FAR = 4.0, 3.0  # most angle of a walk from x, if it is longer [degrees, m]: ZMPs then go 7 % wider
_DRIFT = 0.01  # most change of the COM's mean height from stride to stride, over H [1]
_AGREE = 0.25  # least share of the acceleration of a measured COM that the force explains [1]
_STILL = 1e-3  # RMS below which a signal rests, over H, weight or m H sqrt(g H) [1]
_TURN = np.array([[1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [1.0, 1.0]])[:, None]  # y to the next stance foot
Scores = dict[str, dict[str, dict[str, dict[str, float]]]]
"""By signal, model, and ``single``, ``double`` or ``stride``: ``share`` of the variance that is accounted for
[1], and ``rmse`` [unit of the signal]."""


class Constant(NamedTuple):
    """A fitted constant: mean over strides, half of its confidence interval, unit, and what it is."""

    value: float
    interval: float
    unit: str
    meaning: str


@dataclass(frozen=True)
class Strides(Brief):
    """N strides at P equal shares of their four phases."""

    switches: Array  # starts of the phases, and end of the last, (N, 5) [s]
    com: Array  # over the floor, (N, 4, P, 3) [m]
    signals: Array  # `EXPLAINED`, forces without the sensors' offset, (N, 4, P, 7)
    ends: Array  # place [m] and speed [m/s] of the COM along x at the switches, (N, 5, 2)
    timing: Array  # error of a switch, by sampling and misfit of the ZMP, (N,) [s]
    width: Array  # way of the lateral ZMP from foot to foot, (N,) [m]
    com_error: Array  # RMS of integrated and measured COM, (N,) [m]; NaN without a measured one
    agreement: Array  # share of the COM's acceleration by the force, x, y, (N, 2) [1]
    upward: Array  # mean vertical force as measured, (N,) [N]
    weight: float  # of the body [N]

    def __len__(self) -> int:
        return len(self.switches)

    @property
    def durations(self) -> Array:
        """Of the phases, (N, 4) [s]."""
        return np.diff(self.switches, axis=1)


def cut_strides(log: Log, com_height: float | None, *, weighed: bool) -> tuple[Strides, int]:
    """Strides of a log that are alike in length and duration, and how many others it has.

    Args:
        log: with a ZMP.
        com_height: mean height of the COM over the floor [m], of a log without COM.
        weighed: whether the log's weight is the body's, and not to be that of its mean vertical force.

    Raises:
        InputError: no ZMP, neither COM nor height or both, too few strides that are alike, or a COM that
            climbs from its floor or contradicts the force.
    """
    if "zmp" not in log.signals:
        raise InputError(f"{log.name} has no centres of pressure; give zmp_x, _y, or those of both feet.")
    if ("com" in log.signals) == (com_height is not None):
        what = "a COM; leave its height out" if com_height else "no COM; give its mean height (--com-height)"
        raise InputError(f"{log.name} has {what}, or the columns com_x, _y, _z.")
    for name in {"zmp", "com"} & log.signals.keys():
        log = log.rows(np.asarray(np.isfinite(log.signals[name]).all(axis=1)))
    share = left_share(log)
    left, right = take_overs(log.time, share), take_overs(log.time, 1.0 - share)
    ends = left[[0, -1]] if len(left) > 1 else log.time[[0, -1]]
    x, y = np.diff(interp(ends, log.time, log.signals["zmp"]), axis=0)[0]
    angle = math.degrees(math.atan2(y, x))
    if abs(angle) > _ASIDE and math.hypot(x, y) > _FAR:
        side = "left" if angle > 0.0 else "right"
        raise InputError(
            f"{log.name} walks {abs(angle):.3g} degrees to the {side} of x, more than {_ASIDE:g}; turn all x "
            "and y into the direction of the walk."
        )
    if not weighed and len(left) > 1:
        strides_only = (log.time >= left[0]) & (log.time < left[-1])
        log = replace(log, weight=float(log.signals["force"][strides_only, 2].mean()))
    bounds = [ends for ends in whole_strides(log, left, _MARGIN) if ends[1] - ends[0] >= _BRIEFEST]
    found = [one for ends in bounds if (one := _stride(log, ends, right, com_height))]
    sizes = np.array([(one["switches"][[0, -1]], one["ends"][[0, -1], 0]) for one in found]).reshape(-1, 2, 2)
    sizes = sizes[..., 1] - sizes[..., 0]
    middles = np.median(sizes, axis=0) if found else np.full(2, math.nan)
    alike = (np.abs(sizes / middles - 1.0) <= _ALIKE).all(axis=1) & (sizes[:, 1] >= _SHORTEST)
    chosen = [stride for stride, kept in zip(found, alike, strict=True) if kept]
    if len(chosen) < _LEAST_STRIDES:
        of = f", of {middles[0]:.3g} s and {middles[1]:.3g} m (medians)" if found else ""
        if lost := len(bounds) - len(found):
            of += f", in {lost} of which COM and ZMP do not cross along y at every step (check their signs)"
        raise InputError(
            f"{log.name} has too few strides of equal duration and length: {len(chosen)}, and a fit needs "
            f"{_LEAST_STRIDES}; landings of the left foot in {np.ptp(log.time):.3g} s: "
            f"{len(left)}; whole strides between them: {len(bounds)}{of}; give longer, steady "
            "walking without gaps, x forward, and belt_speed of a treadmill." + f" {log.unsupported}".rstrip()
        )
    arrays = {name: np.array([stride[name] for stride in chosen]) for name in chosen[0]}
    strides = Strides(**arrays, weight=log.weight)
    strides.signals[..., 5:] = _closed(strides.signals[..., 5:], strides.durations)
    _check_com(strides, log.name)
    return strides, len(found) - len(chosen)


def _check_com(strides: Strides, name: str) -> None:
    """Refuse a COM that climbs from its floor or contradicts the force, of a log of this name."""
    heights = strides.com[..., 2].mean(axis=(1, 2))
    if (drift := float(np.median(np.abs(np.diff(heights))))) > _DRIFT * heights.mean():
        raise InputError(
            f"{name}: the COM's height over the floor changes by {drift:.3g} m a stride, more than "
            f"{100.0 * _DRIFT:g} % of it; give the column floor, its height there, or walk an old run anew."
        )
    for axis, agrees in zip("xy", np.median(strides.agreement, axis=0), strict=True):
        if agrees < _AGREE:
            raise InputError(
                f"{name}: along {axis} the force explains {100.0 * agrees:.0f} % of the acceleration of "
                f"the COM, less than {100.0 * _AGREE:g} %; correct sign, unit (--columns "
                f"force_{axis}=-COLUMN[UNIT]), axis or clock of one of them, or leave the columns of com out."
            )


def _stride(log: Log, ends: tuple[float, float], right: Array, height: float | None) -> dict[str, Any] | None:
    """One stride, by the arrays of :class:`Strides`; None if its phases are not found.

    The left foot takes half of the weight at both ends, the right one at some instants [s]; the height of the
    COM over the floor [m] is given if it was not measured.
    """
    middle, margin = right[(right > ends[0]) & (right < ends[1])], _MARGIN * (ends[1] - ends[0])
    log = log.rows((log.time >= ends[0] - margin) & (log.time <= ends[1] + margin))
    time, zmp = log.time, log.signals["zmp"]
    floor = np.broadcast_to(log.signals.get("floor", 0.0), time.shape)
    com, velocity, offset, agreement = _integrated(log, floor, ends, height)
    supports = []
    for at in (ends[0], *middle, ends[1]):
        rows = np.abs(time - at) <= margin
        supports.append(_double_support(time[rows], com[rows, 1], zmp[rows, 1]))
    begins, stops, widths, errors = np.array(supports).T
    switches = np.column_stack([begins, stops]).ravel()[1:]
    if len(switches) != 5 or not (np.diff(switches) > 0.0).all():  # also of NaN
        return None
    inside = (time >= ends[0]) & (time < ends[1])
    gap = log.signals.get("com", np.full((1, 3), np.nan)) - com
    force, com[:, 2] = log.signals["force"] + log.weight / GRAVITY * offset, com[:, 2] - floor
    momentum = log.signals.get("angular_momentum", np.full((1, 3), np.nan))[:, :2]
    if not np.isfinite(momentum).all():
        lever = force[:, 2:] * (zmp - com[:, :2]) + com[:, 2:] * force[:, :2]
        momentum = cumulative_trapezoid(lever[:, ::-1] * [1.0, -1.0], time, axis=0, initial=0.0)
    instants = switches[:-1, None] + np.diff(switches)[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS
    return {
        "switches": switches,
        "com": interp(instants, time, com),
        "signals": interp(instants, time, np.hstack([zmp, force, momentum])),
        "ends": interp(switches, time, np.column_stack([com[:, 0], velocity[:, 0]])),
        "timing": math.hypot(math.sqrt(np.mean(errors**2)), log.time_step / math.sqrt(12.0)),
        "width": widths.mean(),
        "com_error": math.sqrt(np.mean(gap[:, :2] ** 2)),
        "agreement": agreement,
        "upward": log.signals["force"][inside, 2].mean(),
    }


def _integrated(
    log: Log, floor: Array, ends: tuple[float, float], height: float | None
) -> tuple[Array, Array, Array, Array]:
    """COM and velocity (K, 3), what the force's acceleration lacks (3,), and the `agreement` of `Strides`.

    The COM is the double integral of the force and a polynomial: it is nearest to the measured COM, or makes
    velocity, place over the ZMP and angular momentum the same at both ends of the stride [s].
    """
    time, zmp, duration = log.time - ends[0], log.signals["zmp"], ends[1] - ends[0]
    both_ends, inside = np.array([0.0, duration]), (time >= 0.0) & (time <= duration)
    pushed = log.signals["force"] / (log.weight / GRAVITY) - [0.0, 0.0, GRAVITY]
    speed = cumulative_trapezoid(pushed, time, axis=0, initial=0.0)
    place = cumulative_trapezoid(speed, time, axis=0, initial=0.0)
    if height is None:
        gap, domain = log.signals["com"] - place, [time[0], time[-1]]
        added: list[Any] = [Legendre.fit(time, values, _DEGREE, domain) for values in gap.T]
    else:
        around = duration * np.linspace(-_MARGIN, _MARGIN, _POINTS)
        way = np.append((interp(around + duration, time, zmp) - interp(around, time, zmp)).mean(axis=0), 0.0)
        faster, further = (np.diff(interp(both_ends, time, part), axis=0)[0] for part in (speed, place))
        rate = (way - further) / duration + 0.5 * faster
        added = [Polynomial([0.0, *both]) for both in zip(rate, -0.5 * faster / duration, strict=True)]
    com, velocity, change = (
        part + np.column_stack([one.deriv(n)(time) for one in added])
        for n, part in enumerate((place, speed, pushed))
    )
    lacking = np.diff(interp(both_ends, time, velocity - speed), axis=0)[0] / duration
    if height is not None:
        com[:, 2] += height - (com[:, 2] - floor)[inside].mean()
        up, force = (com[:, 2] - floor)[inside, None], (pushed + lacking + [0.0, 0.0, GRAVITY])[inside]
        moment = force[:, 2:] * (zmp - com[:, :2])[inside] + up * force[:, :2]
        com[:, :2] += moment.sum(axis=0) / force[:, 2].sum()
    accelerated, missed = change[inside, :2], (change - pushed)[inside, :2]
    return com, velocity, lacking, 1.0 - missed.var(axis=0) / accelerated.var(axis=0)


def _double_support(time: Array, com: Array, zmp: Array) -> tuple[float, float, float, float]:
    """Begin and end of a double support [s], way of the lateral ZMP [m], error of an instant [s]; or NaN.

    Before and after it the ZMP rests; in it the ZMP is linear in the lateral COM.
    """
    tail = max(len(time) // 5, 1)
    before, after = zmp[:tail].mean(), zmp[-tail:].mean()
    along = math.copysign(1.0, after - before) * com

    def misfit(of: Array) -> Array:
        return of[0] + (of[1] - of[0]) * np.clip((along - of[2]) / max(of[3] - of[2], 1e-9), 0.0, 1.0) - zmp

    found = least_squares(misfit, [before, after, *np.quantile(along, (0.35, 0.65))], x_scale=0.01)
    passed = np.maximum.accumulate(along)  # a COM that sways back passes a place once
    if not passed[0] <= found.x[2] < found.x[3] <= passed[-1]:
        return (math.nan,) * 4
    begin, end = np.interp(found.x[2:], passed, time)
    around = np.abs(2.0 * time - begin - end) <= 2.0 * (end - begin + time[1] - time[0])
    way = abs(found.x[1] - found.x[0])
    return begin, end, way, math.sqrt(np.mean(found.fun[around] ** 2)) * (end - begin) / way


def _closed(values: Array, durations: Array) -> Array:
    """Values over strides, (N, 4, P, n), without drift and mean, as periodic ones have them."""
    part = durations / durations.sum(axis=1, keepdims=True) / _POINTS
    weights = np.repeat(part, _POINTS, axis=1)[..., None]
    flat = values.reshape(len(values), -1, values.shape[-1])
    flat = flat - (flat[:, -1:] - flat[:, :1]) * weights.cumsum(axis=1)
    return (flat - (flat * weights).sum(axis=1, keepdims=True)).reshape(values.shape)


def _laws(strides: Strides) -> tuple[Array, Array, Array, Array]:
    """ZMP, and force times H over the weight, as linear functions of the COM; y is to the next stance foot.

    The COM from its mean in a phase has shape (N, 4, P, 2), both from there (2, N, 4, P, 2) [m]; their
    slopes, one for both phases of a support [1], and their means [m] have shape (2, N, 4, 2).
    """
    middle = strides.com[..., :2].mean(axis=2, keepdims=True)
    scale = strides.com[..., 2].mean(axis=(1, 2))[:, None, None, None] / strides.weight
    com = _TURN * (strides.com[..., :2] - middle)
    both = _TURN * np.stack([strides.signals[..., :2] - middle, scale * strides.signals[..., 2:4]])
    over, under = (com * both).sum(axis=3), (com * com).sum(axis=2)
    slopes = (over[:, :, :2] + over[:, :, 2:]) / (under[:, :2] + under[:, 2:])
    return com, both, np.tile(slopes, (1, 1, 2, 1)), both.mean(axis=3)


def constants(strides: Strides) -> dict[str, Constant]:
    """Constants by name; ``inverse_a_single_x`` is 1/a along x in single support.

    An interval holds the spread over strides and, as noise is in that, the misfit of the mean stride: as if
    it were one error of each phase. That of H holds how the height varies, those of times and widths hold the
    error of the switches, those of a and c the difference of mean vertical force and weight, and its drift.
    """
    found: dict[str, Constant] = {}

    def add(name: str, values: Array, error: float, unit: str, meaning: str) -> None:
        spread = student.ppf(0.5 + 0.5 * CONFIDENCE, len(values) - 1) * sem(values)
        found[name] = Constant(float(values.mean()), math.hypot(spread, error), unit, meaning)

    late = student.ppf(0.5 + 0.5 * CONFIDENCE, np.inf) * math.sqrt(np.mean(strides.timing**2))
    travel, speed = np.diff(strides.ends[..., 0], axis=1), strides.ends[..., 1].mean(axis=1)
    length = 0.5 * travel.sum(axis=1)
    braking = GRAVITY * np.abs(strides.signals[:, :, [0, -1], 2]).mean() / strides.weight
    single, double = (strides.durations[:, rows].mean(axis=1) for rows in SUPPORTS.values())
    share = 0.5 * travel[:, SUPPORTS["single"]].sum(axis=1) / length
    late_zmp, late_way = late * strides.width.mean() / double.mean(), late * speed.mean() / length.mean()
    height = strides.com[..., 2]
    add("com_height", height.mean(axis=(1, 2)), height.std(axis=(1, 2)).mean(), "m", "height of the COM, H")
    add("single_support", single, late, "s", "duration of a single support, T_SS")
    add("double_support", double, late, "s", "duration of a double support, T_DS")
    add("step_length", length, 0.0, "m", "step length, S")
    add("step_width", strides.width, late_zmp, "m", "lateral way of the ZMP, 2 (s + beta)")
    add("switching_velocity", speed, late * braking, "m/s", "speed of the COM at a switch, v0")
    add("single_support_ratio", share, late_way, "1", "share of single support in S")
    com, both, slopes, means = _laws(strides)
    gap = both - means[:, :, :, None] - slopes[:, :, :, None] * com
    noise = gap.var(axis=1, ddof=1) / len(strides)
    misfit = (gap.mean(axis=1) ** 2 - noise).mean(axis=2)  # of the mean stride, without its noise
    squares = np.stack([(com**2).mean(axis=(0, 2)), *misfit])
    weighed = strides.upward / strides.weight
    weight_error = abs(weighed.mean() - 1.0) + np.ptp(weighed)
    for support, rows in SUPPORTS.items():
        for k, axis in enumerate("xy"):
            wide, off_zmp, off_force = np.sqrt(np.maximum(squares[:, rows, k].mean(axis=1), 0.0))
            s, bracket = slopes[:, :, rows[0], k]
            mean_zmp, mean_force = means[:, :, rows, k].mean(axis=2)
            u = mean_force / bracket  # mean COM from where it does not accelerate
            b, far = mean_zmp + (1.0 - s) * u, float(u.mean()) / wide
            off_u = off_force / bracket.mean() * math.hypot(1.0, far)
            off_b = math.hypot(off_zmp, far * off_zmp, (1.0 - s.mean()) * off_u)
            off_s = math.hypot(off_zmp / wide, weight_error * s.mean())
            off_c = math.hypot(off_s, off_force / wide, weight_error * bracket.mean())
            of = f"{support} support along {axis}"
            add(f"inverse_a_{support}_{axis}", s, off_s, "1", f"ZMP over COM, 1/a, {of}")
            add(f"b_{support}_{axis}", b, off_b, "m", f"offset of the ZMP, b, {of}")
            add(f"c_{support}_{axis}", s + bracket, off_c, "1", f"slope of the force line, c, {of}")
    return found


def explained(strides: Strides) -> dict[str, Array]:
    """Signals of each stride by model, from its COM and the constants of the other strides.

    Shapes are that of :attr:`Strides.signals`.
    """
    com, _, *laws = _laws(strides)
    slopes, means = ((law.sum(axis=1, keepdims=True) - law) / (len(strides) - 1) for law in laws)
    slopes, means = slopes[:, :, :, None], means[:, :, :, None]
    # With c = 1 and b = 0 ZMP and force add to the COM: the nearest such law.
    slope, mean = 0.5 * (slopes[0] + 1.0 - slopes[1]), 0.5 * (means[0] - means[1])
    double = np.array([0.0, 1.0, 0.0, 1.0])[:, None, None]
    zmps = {
        "pendulum": double * com + (1.0 - double) * mean,
        "rolling": slope * com + mean,
        "ampm": slopes[0] * com + means[0],
    }
    middle = strides.com[..., :2].mean(axis=2, keepdims=True)
    scale = strides.weight / strides.com[..., 2].mean(axis=(1, 2))[:, None, None, None]
    steps = strides.durations[:, :, None, None] / _POINTS
    found = {}
    for model, zmp in zmps.items():
        force = slopes[1] * com + means[1] if model == "ampm" else com - zmp
        moment = steps * strides.weight * (_TURN * (zmp + force - com))[..., ::-1] * [1.0, -1.0]
        momentum = moment.reshape(len(strides), -1, 2).cumsum(axis=1).reshape(moment.shape) - 0.5 * moment
        upward = np.full_like(force[..., :1], strides.weight)
        parts = middle + _TURN * zmp, _TURN * force * scale, upward, _closed(momentum, strides.durations)
        found[model] = np.concatenate(parts, axis=-1)
    return found


def scores(strides: Strides) -> Scores:
    """How well the models explain every signal.

    The variance of a ZMP is about its mean in the phase, that of horizontal forces and momenta about 0, of
    the vertical force about the weight. The share is NaN where a signal rests.
    """
    told = explained(strides)
    about = np.where(np.arange(7) < 2, strides.signals.mean(axis=2, keepdims=True), 0.0)
    about[..., EXPLAINED.index("force_z")] = strides.weight
    height = float(strides.com[..., 2].mean())
    pace = strides.weight * math.sqrt(height**3 / GRAVITY)  # m H sqrt(g H)
    sizes = np.repeat([height, strides.weight, pace], (2, 3, 2))
    found: Scores = {name: {model: {} for model in told} for name in EXPLAINED}
    for support, rows in {**SUPPORTS, "stride": [0, 1, 2, 3]}.items():
        weights = strides.durations[:, rows].ravel()

        def root(gap: Array) -> Array:
            squares = (gap[:, rows] ** 2).mean(axis=2).reshape(-1, len(EXPLAINED))  # noqa: B023
            return np.sqrt(np.average(squares, axis=0, weights=weights))  # noqa: B023

        size = root(strides.signals - about)
        known = np.where(size > _STILL * sizes, size, np.nan)
        for model, values in told.items():
            error = root(strides.signals - values)
            for name, share, rmse in zip(EXPLAINED, 1.0 - (error / known) ** 2, error, strict=True):
                found[name][model][support] = {"share": float(share), "rmse": float(rmse)}
    return found

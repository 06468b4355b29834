"""Constants of the AMPM from a measured walk: regressions for each axis and support, tested on other strides.

A stride is cut where the lateral ZMP leaves one foot and reaches the next. In each of its four phases ZMP and
ground force are linear in the COM (``docs/theory.md``): the slope of the ZMP is 1/a, that of the force, times
H over the weight, is c - 1/a. The COM is the double integral of the force; its constants are fitted to the
measured COM, or make the stride periodic if there is none.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Legendre
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from scipy.stats import sem
from scipy.stats import t as student

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY
from validation.judge.log import left_share, take_overs
from validation.measure.log import Log

SUPPORTS: Mapping[str, list[int]] = {"single": [0, 2], "double": [1, 3]}
"""Phases of a stride by support; it begins with the single support on the left foot."""
MODELS = ("pendulum", "rolling", "ampm")
"""c = 1 and a ZMP that rests under a foot, and is below the COM in double support; c = 1; a, b and c free."""
LEAST_STRIDES = 3
CONFIDENCE = 0.95
_POINTS = 50  # of a phase
_DEGREE = 9  # of the polynomial between integrated and measured COM: in 1.5 strides
_ALIKE = 0.1, 0.15  # strides' durations and lengths from their medians, over these [1]
_SHORTEST = 0.05  # stride [m]: below it nothing walks
_UNSEEN = 0.1  # longest gap in a measured COM, over the stride [1]
_STILL = 1e-3  # of a signal that rests: over H, weight or m H sqrt(g H) [1]
Scores = dict[str, dict[str, dict[str, dict[str, float]]]]
"""By signal, model, and ``single``, ``double`` or ``stride``: ``share`` of the variance that is accounted for
[1], and ``rmse`` [unit of the signal]."""
_TURN = np.array([[1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [1.0, 1.0]])[:, None]  # y to the next stance foot


class Constant(NamedTuple):
    """A fitted constant: mean over strides, half of its confidence interval, unit, and what it is."""

    value: float
    interval: float
    unit: str
    meaning: str


@dataclass(frozen=True)
class Strides(Brief):
    """N strides at P equal shares of their four phases; arrays of shape (N, 4, P, axes) where not said.

    Attributes:
        switches: starts of the phases, and end of the last, shape (N, 5) [s].
        com: over the floor, x, y, z [m].
        zmp: x, y [m].
        force: without the sensors' offset, x, y, z [N].
        momentum: about the COM, as :func:`_closed` has it, x, y [N m s].
        way, speed: of the COM along x at the switches, (N, 5) [m], [m/s].
        width: way of the ZMP from foot to foot, (N,) [m].
        timing: error of a switch, by sampling and misfit of the ZMP, (N,) [s].
        com_error: RMS of integrated and measured COM, (N,) [m]; NaN without a measured one.
        upward: mean vertical force as measured, (N,) [N].
        weight: of the body [N].
    """

    switches: Array
    com: Array
    zmp: Array
    force: Array
    momentum: Array
    way: Array
    speed: Array
    width: Array
    timing: Array
    com_error: Array
    upward: Array
    weight: float

    def __len__(self) -> int:
        return len(self.switches)

    @property
    def durations(self) -> Array:
        """Of the phases, (N, 4) [s]."""
        return np.diff(self.switches, axis=1)

    @property
    def measured(self) -> dict[str, Array]:
        """The signals that are explained, by name."""
        return {"zmp": self.zmp, "force": self.force, "momentum": self.momentum}


def cut_strides(log: Log, com_height: float | None = None, mass: float | None = None) -> tuple[Strides, int]:
    """Strides of a log that are alike in length and duration, and how many others it has.

    Args:
        log: with a ZMP.
        com_height: mean height of the COM over the floor [m], of a log without COM.
        mass: of the body [kg]; that of the mean vertical force if None.

    Raises:
        InputError: no ZMP, neither COM nor height or both, or too few strides that are alike.
    """
    if "zmp" not in log.signals:
        raise InputError(f"{log.name} has no centres of pressure; give zmp_x, _y, or those of both feet.")
    if "com" not in log.signals and com_height is None:
        raise InputError(f"{log.name} has no COM; give com_x, _y, _z, or its mean height (--com-height).")
    if "com" in log.signals and com_height is not None:
        raise InputError(f"{log.name} has a COM; leave its height out, or its columns.")
    share = left_share(log)
    left, right = take_overs(log.time, share), take_overs(log.time, 1.0 - share)
    if mass is not None:
        log = replace(log, weight=mass * GRAVITY)
    elif len(left) > 1:
        strides_only = (log.time >= left[0]) & (log.time < left[-1])
        log = replace(log, weight=float(log.signals["force"][strides_only, 2].mean()))
    holes = log.time[:-1][np.diff(log.time) > 1.5 * log.time_step]
    found = []
    for begin, end in pairwise(left):
        middle, quarter = right[(right > begin) & (right < end)], 0.25 * (end - begin)
        first, last = begin - quarter, end + quarter
        whole = log.time[0] <= first and last <= log.time[-1] and not ((holes > first) & (holes < last)).any()
        if whole and len(middle) == 1:
            part = log.rows((log.time >= first) & (log.time <= last))
            found += _stride(part, np.array([begin, middle[0], end]), com_height)
    sizes = np.array([[np.ptp(stride["switches"]), np.ptp(stride["way"])] for stride in found]).reshape(-1, 2)
    middles = np.median(sizes, axis=0) if found else np.ones(2)
    alike = (np.abs(sizes / middles - 1.0) <= _ALIKE).all(axis=1) & (sizes[:, 1] >= _SHORTEST)
    chosen = [stride for stride, kept in zip(found, alike, strict=True) if kept]
    if len(chosen) < LEAST_STRIDES:
        raise InputError(
            f"{log.name} has {len(chosen)} whole strides alike in length and duration, and a fit needs "
            f"{LEAST_STRIDES}; the left foot takes half of the weight at {len(left)} instants in "
            f"{np.ptp(log.time):.3g} s. Give a longer log of steady walking along x, without gaps."
        )
    arrays = {name: np.array([stride[name] for stride in chosen]) for name in chosen[0]}
    return Strides(**arrays, weight=log.weight), len(found) - len(chosen)


def _stride(log: Log, taken: Array, height: float | None) -> list[dict[str, Array | float]]:
    """One stride, by the arrays of :class:`Strides`; empty if its phases are not found.

    Args:
        log: of the stride, and a quarter of it before and after.
        taken: when left, right and left foot take half of the weight, shape (3,) [s].
        height: of the COM over the floor [m], if it was not measured.
    """
    time, mass = log.time, log.weight / GRAVITY
    if height is None:
        seen = time[np.isfinite(log.signals["com"]).all(axis=1)]
        if np.diff([time[0], *seen, time[-1]]).max() > _UNSEEN * (taken[2] - taken[0]):
            return []
    floor = np.broadcast_to(log.signals.get("floor", 0.0), time.shape)
    known = np.isfinite(log.signals["zmp"]).all(axis=1)
    zmp = _at(time, time[known], log.signals["zmp"][known])
    com, velocity, offset, com_error = _integrated(log, zmp, floor, taken, height)
    force = log.signals["force"] + mass * offset
    supports = []
    for at in taken:
        rows = np.abs(time - at) <= 0.25 * (taken[2] - taken[0])
        supports.append(_double_support(time[rows], com[rows, 1], zmp[rows, 1]))
    begins, ends, widths, errors = np.array(supports).T
    switches = np.array([ends[0], begins[1], ends[1], begins[2], ends[2]])
    if not (np.diff(switches) > 0.0).all():  # also of NaN
        return []
    com[:, 2] -= floor
    momentum = log.signals.get("angular_momentum", np.full((1, 3), np.nan))[:, :2]
    if not np.isfinite(momentum).all():
        arm = zmp - com[:, :2]
        lever = (force[:, 2:] * arm + com[:, 2:] * force[:, :2])[:, ::-1] * [1.0, -1.0]
        momentum = cumulative_trapezoid(lever, time, axis=0, initial=0.0)
    instants = switches[:-1, None] + np.diff(switches)[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS
    inside = (time >= taken[0]) & (time < taken[2])
    return [
        {
            "switches": switches,
            "com": _at(instants, time, com),
            "zmp": _at(instants, time, zmp),
            "force": _at(instants, time, force),
            "momentum": _closed(_at(instants, time, momentum), np.diff(switches)),
            "way": np.interp(switches, time, com[:, 0]),
            "speed": np.interp(switches, time, velocity[:, 0]),
            "width": widths.mean(),
            "timing": math.hypot(math.sqrt(np.mean(errors**2)), log.time_step / math.sqrt(12.0)),
            "com_error": com_error,
            "upward": log.signals["force"][inside, 2].mean(),
        }
    ]


def _at(times: Array, time: Array, values: Array) -> Array:
    """Values (K, n) at other times (...), shape (..., n)."""
    return np.stack([np.interp(times, time, column) for column in values.T], axis=-1)


def _integrated(
    log: Log, zmp: Array, floor: Array, taken: Array, height: float | None
) -> tuple[Array, Array, Array, float]:
    """COM and velocity (K, 3), what the acceleration lacks (3,), and the RMS distance to a measured COM [m].

    It is the double integral of the force and a polynomial: the nearest to the measured COM, or a parabola
    with which velocity, place over the ZMP and angular momentum are the same at both ends of the stride.
    """
    time, mass, duration = log.time - taken[0], log.weight / GRAVITY, taken[2] - taken[0]
    speed = cumulative_trapezoid(log.signals["force"] / mass - [0.0, 0.0, GRAVITY], time, axis=0, initial=0.0)
    place = cumulative_trapezoid(speed, time, axis=0, initial=0.0)
    ends = np.array([0.0, duration])
    if height is None:
        known = np.isfinite(log.signals["com"]).all(axis=1)
        domain, gap = [time[0], time[-1]], log.signals["com"] - place
        fits = [Legendre.fit(time[known], values, _DEGREE, domain) for values in gap[known].T]
        added, drift = (np.column_stack([fit.deriv(n)(time) for fit in fits]) for n in (0, 1))
        lacking = np.diff(_at(ends, time, drift), axis=0)[0] / duration
        return place + added, speed + drift, lacking, math.sqrt(np.nanmean((gap - added)[:, :2] ** 2))
    around = duration * np.linspace(-0.25, 0.25, _POINTS)
    way = np.append((_at(around + duration, time, zmp) - _at(around, time, zmp)).mean(axis=0), 0.0)
    lacking = -np.diff(_at(ends, time, speed), axis=0)[0] / duration
    rate = (way - np.diff(_at(ends, time, place), axis=0)[0]) / duration - 0.5 * duration * lacking
    com = place + np.outer(time, rate) + np.outer(0.5 * time**2, lacking)
    inside = (time >= 0.0) & (time <= duration)
    force = (log.signals["force"] + mass * lacking)[inside]
    com[:, 2] += height - (com[inside, 2] - floor[inside]).mean()
    up = (com[:, 2] - floor)[inside, None]
    moment = force[:, 2:] * (zmp - com[:, :2])[inside] + up * force[:, :2]
    com[:, :2] += moment.sum(axis=0) / force[:, 2].sum()
    return com, speed + rate + np.outer(time, lacking), lacking, math.nan


def _double_support(time: Array, com: Array, zmp: Array) -> tuple[float, float, float, float]:
    """Begin and end of a double support [s], way of the lateral ZMP [m], error of an instant [s]; or NaN.

    Before and after it the ZMP rests; in it the ZMP is linear in the lateral COM.
    """
    tail = max(len(time) // 5, 1)
    before, after = zmp[:tail].mean(), zmp[-tail:].mean()
    along = math.copysign(1.0, after - before) * com

    def misfit(of: Array) -> Array:
        return of[0] + (of[1] - of[0]) * np.clip((along - of[2]) / max(of[3] - of[2], 1e-9), 0.0, 1.0) - zmp

    start = [before, after, *np.quantile(along, (0.35, 0.65))]
    found = least_squares(misfit, start, x_scale=0.01)
    passed = np.maximum.accumulate(along)  # a COM that sways back passes a place once
    if not passed[0] <= found.x[2] < found.x[3] <= passed[-1]:
        return (math.nan,) * 4
    begin, end = np.interp(found.x[2:], passed, time)
    way, half = abs(found.x[1] - found.x[0]), 0.5 * (end - begin)
    around = np.abs(time - begin - half) <= 2.0 * half + time[1] - time[0]
    return begin, end, way, math.sqrt(np.mean(found.fun[around] ** 2)) * 2.0 * half / way


def _closed(values: Array, durations: Array) -> Array:
    """Values over a stride, (..., 4, P, n), without drift and mean, as a periodic one has them."""
    flat = values.reshape(*values.shape[:-3], -1, values.shape[-1])
    shares = durations / durations.sum(axis=-1, keepdims=True)
    weights = np.repeat(shares / _POINTS, _POINTS, axis=-1)[..., None]
    flat = flat - (flat[..., -1:, :] - flat[..., :1, :]) * weights.cumsum(axis=-2)
    return (flat - (flat * weights).sum(axis=-2, keepdims=True)).reshape(values.shape)


class _Laws(NamedTuple):
    """ZMP and force over the COM: slopes [1], and values [m] at its mean in a phase, (N, 4, 2) each."""

    zmp_slope: Array
    force_slope: Array
    zmp: Array
    force: Array


def _lengths(strides: Strides) -> tuple[Array, Array, Array]:
    """COM, ZMP, and force times H over the weight, from the mean COM of a phase, (N, 4, P, 2) [m].

    y counts towards the next stance foot.
    """
    middle = strides.com[..., :2].mean(axis=2, keepdims=True)
    scale = strides.com[..., 2].mean(axis=(1, 2))[:, None, None, None] / strides.weight
    return (
        _TURN * (strides.com[..., :2] - middle),
        _TURN * (strides.zmp - middle),
        _TURN * scale * strides.force[..., :2],
    )


def _laws(com: Array, zmp: Array, force: Array) -> _Laws:
    """Laws of every stride, with one slope for both phases of a support."""

    def slope(values: Array) -> Array:
        over, under = ((com * other).sum(axis=2) for other in (values, com))
        return np.tile((over[:, :2] + over[:, 2:]) / (under[:, :2] + under[:, 2:]), (1, 2, 1))

    return _Laws(slope(zmp), slope(force), zmp.mean(axis=2), force.mean(axis=2))


def _nearest(laws: _Laws, model: str) -> _Laws:
    """The laws of a model that are nearest; with c = 1 and b = 0 ZMP and force add to the COM."""
    if model == "ampm":
        return laws
    slope, zmp = 0.5 * (laws.zmp_slope + 1.0 - laws.force_slope), 0.5 * (laws.zmp - laws.force)
    if model == "pendulum":
        double = np.array([0.0, 1.0, 0.0, 1.0])[:, None]
        slope, zmp = double + 0.0 * slope, (1.0 - double) * zmp
    return _Laws(slope, 1.0 - slope, zmp, -zmp)


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
    travel = np.diff(strides.way, axis=1)
    length, speed = 0.5 * travel.sum(axis=1), strides.speed.mean(axis=1)
    braking = GRAVITY * np.abs(strides.force[:, :, [0, -1], 0]).mean() / strides.weight
    single, double = (strides.durations[:, rows].mean(axis=1) for rows in SUPPORTS.values())
    share = 0.5 * travel[:, SUPPORTS["single"]].sum(axis=1) / length
    height = strides.com[..., 2]
    add("com_height", height.mean(axis=(1, 2)), height.std(axis=(1, 2)).mean(), "m", "height of the COM, H")
    add("single_support", single, late, "s", "duration of a single support, T_SS")
    add("double_support", double, late, "s", "duration of a double support, T_DS")
    add("step_length", length, 0.0, "m", "step length, S")
    late_zmp = late * strides.width.mean() / double.mean()
    add("step_width", strides.width, late_zmp, "m", "lateral way of the ZMP, 2 (s + beta)")
    add("switching_velocity", speed, late * braking, "m/s", "speed of the COM at a switch, v0")
    late_way = late * speed.mean() / length.mean()
    add("single_support_ratio", share, late_way, "1", "share of single support in S")
    com, zmp, force = _lengths(strides)
    laws = _laws(com, zmp, force)
    gaps = (
        zmp - laws.zmp[:, :, None] - laws.zmp_slope[:, :, None] * com,
        force - laws.force[:, :, None] - laws.force_slope[:, :, None] * com,
    )
    weighed = strides.upward / strides.weight
    weight_error = abs(weighed.mean() - 1.0) + np.ptp(weighed)
    squares = [(com**2).mean(axis=(0, 2))]
    for gap in gaps:  # that of the mean stride, without its noise
        squares.append((gap.mean(axis=0) ** 2 - gap.var(axis=0, ddof=1) / len(gap)).mean(axis=1))
    for support, rows in SUPPORTS.items():
        for k, axis in enumerate("xy"):
            wide, off_zmp, off_force = (math.sqrt(max(of[rows, k].mean(), 0.0)) for of in squares)
            s, bracket = laws.zmp_slope[:, rows[0], k], laws.force_slope[:, rows[0], k]
            u = laws.force[:, rows, k].mean(axis=1) / bracket  # mean COM from where it does not accelerate
            b, far = laws.zmp[:, rows, k].mean(axis=1) + (1.0 - s) * u, float(u.mean()) / wide
            off_u = off_force / bracket.mean() * math.hypot(1.0, far)
            off_b = math.hypot(off_zmp, far * off_zmp, (1.0 - s.mean()) * off_u)
            off_s = math.hypot(off_zmp / wide, weight_error * s.mean())
            off_c = math.hypot(off_s, off_force / wide, weight_error * bracket.mean())
            of = f"{support} support along {axis}"
            add(f"inverse_a_{support}_{axis}", s, off_s, "1", f"ZMP over COM, 1/a, {of}")
            add(f"b_{support}_{axis}", b, off_b, "m", f"offset of the ZMP, b, {of}")
            add(f"c_{support}_{axis}", s + bracket, off_c, "1", f"slope of the force line, c, {of}")
    return found


def explained(strides: Strides) -> dict[str, dict[str, Array]]:
    """What each model says of each stride, given its COM, by the constants of the other strides.

    Returns:
        By model: ``zmp``, ``force`` and ``momentum`` as :class:`Strides` has them.
    """
    com, zmp, force = _lengths(strides)
    laws, count = _laws(com, zmp, force), len(strides)
    others = _Laws(*((values.sum(axis=0) - values) / (count - 1) for values in laws))
    height = strides.com[..., 2].mean(axis=(1, 2))[:, None, None, None]
    middle = strides.com[..., :2].mean(axis=2, keepdims=True)
    steps = strides.durations[:, :, None, None] / _POINTS
    found = {}
    for model in MODELS:
        law = _Laws(*(values[:, :, None] for values in _nearest(others, model)))
        zmp, force = law.zmp + law.zmp_slope * com, law.force + law.force_slope * com
        lever = _TURN * (zmp + force - com)
        moment = steps * strides.weight * lever[..., ::-1] * [1.0, -1.0]
        total = moment.reshape(count, -1, 2).cumsum(axis=1).reshape(moment.shape) - 0.5 * moment
        upward = np.full_like(force[..., :1], strides.weight)
        found[model] = {
            "zmp": middle + _TURN * zmp,
            "force": np.concatenate([_TURN * force * strides.weight / height, upward], axis=-1),
            "momentum": _closed(total, strides.durations),
        }
    return found


def scores(strides: Strides, told: Mapping[str, Mapping[str, Array]]) -> Scores:
    """How well models tell every signal, ``zmp_x`` and others.

    The variance of a ZMP is about its mean in the phase, that of horizontal forces and momenta about 0, of
    the vertical force about the weight. The share is NaN where a signal rests.
    """
    middle = strides.zmp.mean(axis=2, keepdims=True)
    about = {"zmp": middle, "force": [0.0, 0.0, strides.weight], "momentum": 0.0}
    height = float(strides.com[..., 2].mean())
    pace = strides.weight * math.sqrt(height**3 / GRAVITY)  # m H sqrt(g H)
    sizes = {"zmp": height, "force": strides.weight, "momentum": pace}
    found: Scores = {}
    for group, values in strides.measured.items():
        for support, rows in {**SUPPORTS, "stride": [0, 1, 2, 3]}.items():
            weights = strides.durations[:, rows, None, None] / strides.durations[:, rows].sum()

            def root(gap: Array) -> Array:
                return np.sqrt((weights * gap[:, rows] ** 2).mean(axis=2).sum(axis=(0, 1)))  # noqa: B023

            size = root(values - about[group])
            known = np.where(size > _STILL * sizes[group], size, np.nan)
            for model in told:
                error = root(values - told[model][group])
                share = 1.0 - (error / known) ** 2
                for k, axis in enumerate("xyz"[: len(error)]):
                    of = found.setdefault(f"{group}_{axis}", {}).setdefault(model, {})
                    of[support] = {"share": float(share[k]), "rmse": float(error[k])}
    return found

"""The planner's refusals on arrays: what ``plan_gait`` would say of many gaits at once.

The formulas are those of :mod:`ampm.planner.periodic` and :mod:`ampm.planner.pendulum`, in the same order of
operations. What
rounding could decide either way is not decided here but marked: a plan that it may make jump at a switch, a
single support at the very edge of what can be computed, numbers so small that products vanish.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ampm.parameters import GRAVITY
from ampm.planner.pendulum import AffineLaw, double_support_root
from ampm.planner.periodic import LEAST_MID_STANCE_SHARE, RESIDUAL_LIMIT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

ACCEPTED = "accepted"
BAD_PARAMETER = "bad_parameter"
REASONS: Mapping[str, str] = {
    ACCEPTED: "the formula has a plan",
    BAD_PARAMETER: "a parameter beyond its bounds",
    "not_the_plain_pendulum": "a slope that the plain inverted pendulum does not have",
    "single_support_not_driven": "c_s - 1/a_s is not greater than 0",
    "c_y_not_positive": "c_y is not greater than 0",
    "switching_velocity_too_low": "too slow to pass over the foot",
    "mid_stance_too_slow": f"over the foot at less than {LEAST_MID_STANCE_SHARE:.0%} of switching_velocity",
    "single_support_too_long": "single support too long for the lateral pendulum",
    "ill_conditioned": "numbers too far apart to be computed",
}
"""Reasons in the order in which they are looked for, and their meaning; the code of one is its place."""
CODES: Mapping[str, int] = {reason: code for code, reason in enumerate(REASONS)}

LARGEST_ANGLE = 300.0
"""k T_SS / 2 of the lateral pendulum at most, as in :mod:`ampm.planner.periodic` (held by a test) [1]."""
PLAIN = {"a_s": math.inf, "c_s": 1.0, "c_y": 1.0}
"""What the plain inverted pendulum leaves no choice of."""

_SURE_RESIDUAL = 0.5 * RESIDUAL_LIMIT  # where rounding may reach this jump, the planner judges
_SURE_ANGLE = 1e-9  # the same, relative distance from the largest angle
_LEAST_NUMBER = 1e-60  # the same, of parameters whose products might vanish
_ROUNDING = 32.0 * np.finfo(np.float64).eps


class Gaits(NamedTuple):
    """Parameters of n gaits by their names in ``gait.``, and the body's mass; shape (n,), SI units."""

    com_height: Array
    step_length: Array
    switching_velocity: Array
    single_support_ratio: Array
    a_s: Array
    c_s: Array
    c_y: Array
    step_width: Array
    mass: Array

    def of(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Gaits:
        """Some of them."""
        return Gaits(*(array[which] for array in self))


class Answers(NamedTuple):
    """What is known of n gaits.

    Attributes:
        code: of the reason, shape (n,).
        step_duration: T_SS + T_DS where there is a plan, else NaN, shape (n,) [s].
        angle: k T_SS / 2 of the lateral pendulum, NaN where nothing was solved, shape (n,) [1].
        doubtful: whether only ``plan_gait`` can tell, shape (n,).
    """

    code: NDArray[np.int8]
    step_duration: Array
    angle: Array
    doubtful: NDArray[np.bool_]


class _Planes(NamedTuple):
    """Both planes' laws, and half the step's ends."""

    single_x: AffineLaw
    double_x: AffineLaw
    single_y: AffineLaw
    double_y: AffineLaw


def bracket(gaits: Gaits) -> Array:
    """``c_s - 1/a_s`` [1]."""
    return gaits.c_s - 1.0 / gaits.a_s


def least_velocity(gaits: Gaits) -> Array:
    """``l_s / T_s``, above which the COM passes over the foot [m/s]."""
    l_s = 0.5 * gaits.step_length * gaits.single_support_ratio
    return l_s / np.sqrt(gaits.com_height / (bracket(gaits) * GRAVITY))


def sufficient_velocity(gaits: Gaits) -> Array:
    """Switching velocity from which the COM passes over the foot fast enough [m/s]."""
    return least_velocity(gaits) / math.sqrt(1.0 - LEAST_MID_STANCE_SHARE**2)


def judge(gaits: Gaits, *, plain: bool, steps: int) -> Answers:
    """What ``plan_gait`` would say.

    Args:
        gaits: within the bounds of their parameters.
        plain: ``gait.model`` is ``ipm``.
        steps: of the plans.
    """
    with np.errstate(all="ignore"):
        code = _first_reason(gaits, plain)
        duration, angles = np.full((2, len(code)), math.nan)
        doubtful = _vanishing(gaits)
        left = np.flatnonzero((code == CODES[ACCEPTED]) & ~doubtful)
        rest = gaits.of(left)
        planes = _plain_planes(rest) if plain else _planes(rest)
        angle = 0.5 * np.sqrt(rest.c_y * GRAVITY / rest.com_height) * planes.single_x.duration
        angles[left] = angle
        too_long = ~(angle <= LARGEST_ANGLE)
        code[left[too_long]] = CODES["single_support_too_long"]
        sure = _rounding(rest, planes, plain, steps) <= _SURE_RESIDUAL
        unsure = (~too_long & ~sure) | (np.abs(angle - LARGEST_ANGLE) <= _SURE_ANGLE * LARGEST_ANGLE)
        doubtful[left[unsure]] = True
        both = planes.single_x.duration + planes.double_x.duration
        duration[left] = np.where(too_long | unsure, math.nan, both)
    return Answers(code, duration, angles, doubtful)


def _vanishing(gaits: Gaits) -> NDArray[np.bool_]:
    lengths = np.minimum.reduce(
        [
            gaits.com_height,
            gaits.step_length,
            gaits.switching_velocity,
            gaits.single_support_ratio,
            gaits.step_width,
            gaits.mass,
        ]
    )
    slopes = (bracket(gaits), gaits.c_y)
    return np.logical_or.reduce([lengths < _LEAST_NUMBER, *((s > 0.0) & (s < _LEAST_NUMBER) for s in slopes)])


def _first_reason(gaits: Gaits, plain: bool) -> NDArray[np.int8]:
    """Code of what is refused before anything is solved."""
    v0, least = gaits.switching_velocity, least_velocity(gaits)
    mid_stance = np.sqrt((v0 - least) * (v0 + least))
    found = {
        "single_support_not_driven": ~(bracket(gaits) > 0.0),
        "c_y_not_positive": ~(gaits.c_y > 0.0),
        "switching_velocity_too_low": ~(v0 > least),
        "mid_stance_too_slow": mid_stance < LEAST_MID_STANCE_SHARE * v0,
    }
    if plain:
        other = np.logical_or.reduce([getattr(gaits, name) != fixed for name, fixed in PLAIN.items()])
        found = {"not_the_plain_pendulum": other, **found}
    codes = [np.int8(CODES[reason]) for reason in found]
    return np.select(list(found.values()), codes, default=np.int8(CODES[ACCEPTED])).astype(np.int8)


def _planes(gaits: Gaits) -> _Planes:
    """The laws of :func:`ampm.planner.pendulum.sagittal_plane` and ``frontal_plane``."""
    v0, inverse_a_s = gaits.switching_velocity, 1.0 / gaits.a_s
    half = 0.5 * gaits.step_length
    l_s, l_d = half * gaits.single_support_ratio, half * (1.0 - gaits.single_support_ratio)
    ratio = l_s / l_d
    rate_s = GRAVITY / gaits.com_height * (gaits.c_s - inverse_a_s)
    rate_d = -rate_s * ratio
    k_s, k_d = np.sqrt(rate_s), np.sqrt(-rate_d)
    reach_s, reach_d = v0 / k_s, v0 / k_d
    odd_s = np.sqrt((reach_s - l_s) * (reach_s + l_s))
    t_ss = 2.0 / k_s * np.arcsinh(l_s / odd_s)
    t_ds = 2.0 / k_d * np.arctan2(l_d, reach_d)

    k = np.sqrt(gaits.c_y * GRAVITY / gaits.com_height)
    h = 0.5 * k * t_ss
    tau = np.tanh(h)
    rho = double_support_root(tau, 0.5 * k * t_ds)
    s = 0.5 * gaits.step_width / (1.0 + rho * rho)
    slope = 1.0 / (rho * rho)
    return _Planes(
        AffineLaw(rate_s, inverse_a_s, gaits.c_s, t_ss, 0.0, odd_s),
        AffineLaw(
            rate_d,
            1.0 + (1.0 - inverse_a_s) * ratio,
            1.0 - (gaits.c_s - 1.0) * ratio,
            t_ds,
            0.0,
            np.hypot(l_d, reach_d),
        ),
        AffineLaw(k * k, 0.0, gaits.c_y, t_ss, -s / np.cosh(h), 0.0),
        AffineLaw(
            -k * k * slope,
            1.0 + slope,
            1.0 + (1.0 - gaits.c_y) * slope,
            t_ds,
            0.0,
            -s * rho * np.hypot(rho, tau),
        ),
    )


def _plain_planes(gaits: Gaits) -> _Planes:
    """The laws of :func:`ampm.planner.pendulum.plain_sagittal_plane` and ``plain_frontal_plane``."""
    v0 = gaits.switching_velocity
    l_s = 0.5 * gaits.step_length * gaits.single_support_ratio
    l_d = 0.5 * gaits.step_length * (1.0 - gaits.single_support_ratio)
    rate = GRAVITY / gaits.com_height
    k = np.sqrt(rate)
    reach = v0 / k
    odd = np.sqrt((reach - l_s) * (reach + l_s))
    t_ss, t_ds = 2.0 / k * np.arcsinh(l_s / odd), 2.0 * l_d / v0
    h = 0.5 * k * t_ss
    s = 0.5 * gaits.step_width / (1.0 + 0.5 * k * t_ds * np.tanh(h))
    none = np.zeros_like(rate)  # a rate of zero chooses the uniform law
    return _Planes(
        AffineLaw(rate, 0.0, 1.0, t_ss, 0.0, odd),
        AffineLaw(none, 1.0, 1.0, t_ds, 0.0, v0),
        AffineLaw(rate, 0.0, 1.0, t_ss, -s / np.cosh(h), 0.0),
        AffineLaw(none, 1.0, 1.0, t_ds, 0.0, -s * k * np.tanh(h)),
    )


def _rounding(gaits: Gaits, planes: _Planes, plain: bool, steps: int) -> Array:
    """How far rounding may make a plan jump at its switches, as ``StepPlan.residuals`` counts it, (n,) [1].

    The closed form joins exactly: whatever jumps is rounding. Every law is purely even or purely odd, so its
    amplitude bounds what is rounded.
    """
    height, v0 = gaits.com_height, gaits.switching_velocity
    w, far = 0.5 * gaits.step_width, (steps + 1) * gaits.step_length
    worst = np.zeros_like(height)
    for law, origin in zip(planes, (far, far, w, w), strict=True):
        k = np.sqrt(np.abs(law.rate))
        h = 0.5 * k * law.duration
        growth = np.where(law.rate > 0.0, np.cosh(np.where(law.rate > 0.0, h, 0.0)), 1.0)
        sway = (np.abs(law.even) + np.abs(law.odd)) * growth
        speed = k * sway
        if plain:  # a uniform law: ``odd`` is its velocity
            uniform = law.rate == 0.0
            sway = np.where(uniform, sway * law.duration, sway)
            speed = np.where(uniform, np.abs(law.odd), speed)
        arm = (np.abs(law.force_slope) + 1.0) * sway
        terms = [
            (origin + sway) / height,
            speed / v0,
            arm / height,
            arm * law.duration * GRAVITY / (height * v0),
        ]
        if not plain:
            terms += [np.abs(law.rate) * sway / GRAVITY, (origin + np.abs(law.zmp_slope) * sway) / height]
        for term in terms:
            worst = np.maximum(worst, term * (1.0 + h))  # a NaN stays one
    return _ROUNDING * worst

"""The closed form of the AMPM: one axis, one phase, one linear law.

The AMPM (Kudoh & Komura, IROS 2003, section 2) lets the ZMP and the direction of the ground reaction force
depend linearly on the COM. With ``u`` the distance of the COM from the point where the force is vertical,

    zmp = a u + b,    the force line meets the COM's height at c u + b,    u'' = (g/H) (c - a) u.

``c - a`` is called the *bracket*. With ``k = sqrt((g/H) |c - a|)`` every phase is
``u = A cosh(k t) + B sinh(k t)`` where it is positive and ``u = A cos(k t) + B sin(k t)`` where it is
negative, t counted from the *middle* of the phase: there a periodic gait is purely odd (B) or even (A), and
no digits cancel near the least speed. Where it is zero the COM keeps its velocity, ``u = A + B t``.

The plain inverted pendulum (IPM; paper, section 1.2) is written in the same law: ``a = 0, c = 1`` in single
support, and ``a = c = 1`` in a double support at constant velocity. Its phases do not join in the second
derivative.

Everything here is a pure function of numbers or arrays; nothing is sampled or integrated numerically.
See ``docs/theory.md`` for the derivation, ``docs/errata.md`` for the errata of the printed paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _elementwise(function: Callable[..., float], arguments: int) -> Callable[..., Array]:
    """A function of :mod:`math` on numbers and arrays.

    NumPy's own differ in the last bit between processors, and between one number and many; a gait is to have
    one plan, alone or among a million.
    """
    ufunc = np.frompyfunc(function, arguments, 1)
    return lambda *values: np.asarray(ufunc(*values), dtype=np.float64)


_ASINH, _ATAN2 = _elementwise(math.asinh, 1), _elementwise(math.atan2, 2)
_COSH, _TANH = _elementwise(math.cosh, 1), _elementwise(math.tanh, 1)
_HYPOT = _elementwise(math.hypot, 2)
_LARGEST_COSH = 700.0  # argument at which cosh still fits a double


class LawState(NamedTuple):
    """State of a law at some times; every field has the broadcast shape of law and times.

    Attributes:
        position: COM from the law's origin [m].
        velocity: of the COM [m/s].
        acceleration: of the COM [m/s^2].
        zmp: ZMP from the law's origin [m].
        moment_arm: distance by which the force line misses the COM [m]; times the weight it is the moment
            about the COM: ``M_x = +m g arm`` in the frontal plane, ``M_y = -m g arm`` in the sagittal plane.
        moment_arm_integral: integral of ``moment_arm`` since the start of the phase [m s].
    """

    position: Array
    velocity: Array
    acceleration: Array
    zmp: Array
    moment_arm: Array
    moment_arm_integral: Array


@dataclass(frozen=True)
class AffineLaw:
    """One axis of one phase, or arrays of such laws with a common shape.

    Equation: ``u'' = (g/H) (force_slope - zmp_slope) u`` and ``zmp = zmp_slope u + zmp_offset``.

    Attributes:
        rate: ``(g/H) (force_slope - zmp_slope)`` [1/s^2]; positive: hyperbolic,
            negative: trigonometric, zero: constant velocity.
        zmp_slope: ``1/a_s`` or ``1/a_d`` in the sagittal plane [1].
        force_slope: ``c_s`` or ``c_d`` in the sagittal plane [1]; 1 passes through the COM.
        duration: of the phase [s].
        even: amplitude of the part that is even about the middle of the phase [m].
        odd: amplitude of the part that is odd about it [m]; with a rate of zero, the velocity [m/s].
        zmp_offset: ``b`` of the general law [m].
    """

    rate: Any
    zmp_slope: Any
    force_slope: Any
    duration: Any
    even: Any
    odd: Any
    zmp_offset: Any = 0.0

    def evaluate(self, time: Any) -> LawState:
        """Evaluate at times since the start of the phase [s], broadcast against the law."""
        since_middle = time - 0.5 * self.duration
        position, velocity = solution(self.rate, self.even, self.odd, since_middle)
        travel = position_integral(self.rate, self.even, self.odd, -0.5 * self.duration, since_middle)
        return LawState(
            position=position,
            velocity=velocity,
            acceleration=self.rate * position,
            zmp=self.zmp_slope * position + self.zmp_offset,
            moment_arm=(self.force_slope - 1.0) * position + self.zmp_offset,
            moment_arm_integral=(self.force_slope - 1.0) * travel + self.zmp_offset * time,
        )


def solution(rate: Any, even: Any, odd: Any, time: Any) -> tuple[Array, Array]:
    """Position and velocity of ``u'' = rate u``.

    Args:
        rate: [1/s^2]; positive hyperbolic, negative trigonometric, zero uniform.
        even: amplitude of cosh or cos, or the position at the middle [m].
        odd: amplitude of sinh or sin [m], or the velocity [m/s].
        time: since the instant at which the even part is even [s].

    Returns:
        Position [m] and velocity [m/s].
    """
    rate = np.asarray(rate, dtype=np.float64)
    k = np.sqrt(np.abs(rate))
    angle = k * time
    hyperbolic, uniform = rate > 0.0, rate == 0.0
    safe = np.where(hyperbolic, angle, 0.0)
    c = np.where(hyperbolic, np.cosh(safe), np.cos(angle))
    s = np.where(hyperbolic, np.sinh(safe), np.where(uniform, time, np.sin(angle)))
    return even * c + odd * s, np.where(uniform, 1.0, k) * (np.sign(rate) * even * s + odd * c)


def position_integral(rate: Any, even: Any, odd: Any, start: Any, end: Any) -> Array:
    """Integral of the position of ``u'' = rate u`` from ``start`` to ``end`` [m s].

    The obvious ``(u'(end) - u'(start)) / rate`` cancels for short times; as a product it does not:
    ``(2/k) sinh(k (end - start)/2) u((start + end)/2)``, with sin for a negative rate and
    ``(end - start) u((start + end)/2)`` for none.
    """
    rate = np.asarray(rate, dtype=np.float64)
    k = np.sqrt(np.abs(rate))
    half = 0.5 * k * (end - start)
    hyperbolic, uniform = rate > 0.0, rate == 0.0
    width = np.where(hyperbolic, np.sinh(np.where(hyperbolic, half, 0.0)), np.sin(half))
    middle, _ = solution(rate, even, odd, 0.5 * (start + end))
    return np.where(uniform, end - start, 2.0 * width / np.where(uniform, 1.0, k)) * middle


def odd_double_integral(rate: float, odd: float, duration: float) -> float:
    """Integral over a phase of the integral, since its start, of an odd solution [m s^2].

    ``(2 B / rate) (sinh h - h cosh h)`` with ``h = k duration / 2``; sin and cos for a negative rate, and
    ``-B duration^3 / 12`` for none. Times weight and slope it is the phase's share in the mean of the angular
    momentum.
    """
    if rate == 0.0:
        return -odd * duration**3 / 12.0
    k = math.sqrt(abs(rate))
    h = 0.5 * k * duration
    sign = math.copysign(1.0, rate)
    if h < 0.5:  # the difference cancels like h^3: its series does not
        total, term = 0.0, h  # term = h^(2n+1) / (2n)!
        for n in range(1, 9):
            term *= sign * h * h / (2 * n * (2 * n - 1))
            total += term * (1.0 / (2 * n + 1) - 1.0)
        difference = total
    elif rate > 0.0:
        difference = math.sinh(h) - h * math.cosh(h)
    else:
        difference = math.sin(h) - h * math.cos(h)
    return 2.0 * odd / rate * difference


@dataclass(frozen=True)
class SagittalPlane:
    """Sagittal constants of a periodic gait (paper, section 2.1) and its two laws.

    Attributes:
        l_s: half the COM's travel in single support [m].
        l_d: half the COM's travel in double support [m].
        inverse_a_s: ZMP slope in single support, ``1/a_s`` [1].
        a_d: COM travel over ZMP travel in double support [1].
        c_d: force slope in double support [1].
        single: law of single support, from the stance foot's reference point.
        double: law of double support, from the midpoint of both feet's reference points.
    """

    l_s: Any
    l_d: Any
    inverse_a_s: Any
    a_d: Any
    c_d: Any
    single: AffineLaw
    double: AffineLaw


@dataclass(frozen=True)
class FrontalPlane:
    """Frontal constants of a periodic gait (paper, section 2.2) and its two laws, for left stance.

    Attributes:
        s: lateral distance of COM and stance foot at a switch [m].
        beta: lateral distance of COM and midline at a switch [m].
        velocity: lateral speed of the COM at a switch, ``v`` [m/s].
        single: law of single support, from the stance foot.
        double: law of the double support after it, from the midline.
    """

    s: Any
    beta: Any
    velocity: Any
    single: AffineLaw
    double: AffineLaw


def sagittal_time_constant(com_height: Any, bracket: Any, gravity: float) -> Array:
    """``T_s = sqrt(H / ((c_s - 1/a_s) g))`` [s]; the bracket must be positive."""
    return np.sqrt(com_height / (bracket * gravity))


def sagittal_plane(
    *,
    com_height: Any,
    step_length: Any,
    single_support_ratio: Any,
    switching_velocity: Any,
    inverse_a_s: Any,
    c_s: Any,
    gravity: float,
    plain: Any = False,
) -> SagittalPlane:
    """Close the sagittal plane of one gait, or of arrays of gaits.

    Continuity of ZMP and force at the switches fixes the double support:
    ``c_s l_s + c_d l_d = l_s + l_d`` (paper Eq. 4, corrected) and ``l_s/a_s + l_d/a_d = l_s + l_d``.

    The plain inverted pendulum (paper, section 1.2; Kajita et al., IROS 2001) has a double support at the
    velocity of the switch: the ground force is vertical and the ZMP under the COM, so both jump at a switch.

    Args:
        com_height: H [m].
        step_length: S [m].
        single_support_ratio: l_s / (l_s + l_d) [1].
        switching_velocity: v0 [m/s], greater than ``l_s / T_s``.
        inverse_a_s: 1/a_s [1], less than ``c_s``; 0 for the plain pendulum.
        c_s: force slope in single support [1]; 1 for the plain pendulum.
        gravity: g [m/s^2].
        plain: whether it is the plain inverted pendulum.
    """
    half = 0.5 * step_length
    l_s = half * single_support_ratio
    l_d = half * (1.0 - single_support_ratio)
    ratio = l_s / l_d
    # Written from 1, so that c_s = 1 leaves c_d exactly 1 and the moment exactly zero.
    c_d = 1.0 - (c_s - 1.0) * ratio
    inverse_a_d = np.where(plain, 1.0, 1.0 + (1.0 - inverse_a_s) * ratio)
    # From both continuity conditions: the bracket of double support is negative where the other is positive.
    rate_s = gravity / com_height * (c_s - inverse_a_s)
    rate_d = -rate_s * ratio
    k_s, k_d = np.sqrt(rate_s), np.sqrt(-rate_d)
    reach_s, reach_d = switching_velocity / k_s, switching_velocity / k_d  # v0 T_s, v0 T_d
    odd_s = np.sqrt((reach_s - l_s) * (reach_s + l_s))
    duration_s = 2.0 / k_s * _ASINH(l_s / odd_s)
    duration_d = np.where(plain, 2.0 * l_d / switching_velocity, 2.0 / k_d * _ATAN2(l_d, reach_d))
    odd_d = np.where(plain, switching_velocity, _HYPOT(l_d, reach_d))
    return SagittalPlane(
        l_s=l_s,
        l_d=l_d,
        inverse_a_s=inverse_a_s,
        a_d=1.0 / inverse_a_d,
        c_d=c_d,
        single=AffineLaw(rate_s, inverse_a_s, c_s, duration_s, 0.0, odd_s),
        double=AffineLaw(np.where(plain, 0.0, rate_d), inverse_a_d, c_d, duration_d, 0.0, odd_d),
    )


def frontal_plane(
    *,
    com_height: Any,
    half_width: Any,
    c_y: Any,
    single_support_duration: Any,
    double_support_duration: Any,
    gravity: float,
    plain: Any = False,
) -> FrontalPlane:
    """Close the frontal plane of one gait, or of arrays of gaits: both durations are given, beta is unknown.

    Of the plain inverted pendulum beta is what the COM drifts in half a double support: ``beta = v T_DS / 2``
    with ``v = s k tanh(k T_SS / 2)``.

    Args:
        com_height: H [m].
        half_width: half the lateral distance of the feet, ``w = s + beta`` [m].
        c_y: force slope of single support [1], positive; 1 for the plain pendulum.
        single_support_duration: T_SS [s].
        double_support_duration: T_DS [s].
        gravity: g [m/s^2].
        plain: whether it is the plain inverted pendulum.
    """
    k = np.sqrt(c_y * gravity / com_height)  # 1 / T_l
    h = 0.5 * k * single_support_duration
    tau = _TANH(h)
    rho = double_support_root(tau, 0.5 * k * double_support_duration)
    drift = 0.5 * k * double_support_duration * tau  # beta / s of the plain pendulum
    s = half_width / (1.0 + np.where(plain, drift, rho * rho))
    velocity = s * k * tau
    slope = 1.0 / (rho * rho)  # s / beta
    return FrontalPlane(
        s=s,
        beta=np.where(plain, s * drift, s * rho * rho),
        velocity=velocity,
        single=AffineLaw(
            rate=np.where(plain, gravity / com_height, k * k),
            zmp_slope=0.0,
            force_slope=c_y,
            duration=single_support_duration,
            even=-s / _COSH(np.minimum(h, _LARGEST_COSH)),
            odd=0.0,
        ),
        double=AffineLaw(
            rate=np.where(plain, 0.0, -k * k * slope),
            zmp_slope=np.where(plain, 1.0, 1.0 + slope),
            force_slope=np.where(plain, 1.0, 1.0 + (1.0 - c_y) * slope),
            duration=double_support_duration,
            even=0.0,
            odd=np.where(plain, -velocity, -s * rho * _HYPOT(rho, tau)),
        ),
    )


def double_support_root(tau: Any, half_angle: Any) -> Array:
    """The root ``rho = sqrt(beta/s)`` of ``rho atan(rho / tau) = half_angle``.

    The left side rises from 0 to infinity and is convex, so there is exactly one root and Newton from above
    falls onto it without a safeguard; ``atan z >= z / (1 + 2 z / pi)`` supplies the start above. The root
    belongs to the double support without extra oscillations; the tangent form has others.

    Args:
        tau: ``tanh(k T_SS / 2)``, positive, any shape [1].
        half_angle: ``k T_DS / 2``, positive, same shape [1].

    Returns:
        rho, same shape [1], to machine precision.
    """
    tau, q = np.broadcast_arrays(np.asarray(tau, dtype=np.float64), np.asarray(half_angle, dtype=np.float64))
    rho = q / np.pi + np.sqrt((q / np.pi) ** 2 + q * tau)
    # What has converged rests: a root does not depend on its neighbours.
    moving = np.ones(rho.shape, dtype=bool)
    for _ in range(30):
        angle = np.arctan2(rho, tau)
        step = (rho * angle - q) / (angle + rho * tau / (tau * tau + rho * rho))
        rho = np.where(moving, rho - step, rho)
        moving &= ~(np.abs(step) <= 4.0 * np.finfo(np.float64).eps * rho)
        if not moving.any():
            break
    return rho

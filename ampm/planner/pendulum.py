"""The closed form of the AMPM: one axis, one phase, one linear law.

The AMPM (Kudoh & Komura, IROS 2003, section 2) lets the ZMP and the direction of the ground reaction force
depend linearly on the COM. With ``u`` the distance of the COM from the point where the force is vertical,

    zmp = u/a + b,    the force line meets the COM's height at c u + b,    u'' = (g/H) (c - 1/a) u.

``c - 1/a`` is called the *bracket*. With ``k = sqrt((g/H) |c - 1/a|)`` every phase is
``u = A cosh(k t) + B sinh(k t)`` where it is positive and ``u = A cos(k t) + B sin(k t)`` where it is
negative, t counted from the *middle* of the phase: there a periodic gait is purely odd (B) or even (A), and
no digits cancel near the least speed. Where it is zero the COM keeps its velocity, ``u = A + B t``.

The plain inverted pendulum (IPM; paper, section 1.2) is written in the same law: ``1/a = 0, c = 1`` in single
support, and ``a = c = 1`` in a double support at constant velocity. Its phases do not join in the second
derivative.

Everything here is a pure function of numbers or arrays; nothing is sampled or integrated numerically.
See ``docs/theory.md`` for the derivation, ``docs/errata.md`` for the errata of the printed paper.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ampm.geometry import Array

EPSILON = float(np.finfo(np.float64).eps)
"""Relative distance of 1 to the next double [1]."""


class LawState(NamedTuple):
    """State of a law at some times; every field has the shape of the times. Upward arms mean nothing."""

    position: Array  # COM from the law's origin [m]
    velocity: Array  # of the COM [m/s]
    acceleration: Array  # of the COM [m/s^2]
    zmp: Array  # ZMP from the law's origin [m]
    # distance by which the force line misses the COM [m]; times the weight it is the moment about the COM:
    # `M_x = +m g arm` in the frontal plane, `M_y = -m g arm` in the sagittal plane
    moment_arm: Array
    moment_arm_integral: Array  # integral of `moment_arm` since the start of the phase [m s]


@dataclass(frozen=True)
class AffineLaw:
    """One axis of one phase.

    Equation: ``u'' = (g/H) (force_slope - zmp_slope) u`` and ``zmp = zmp_slope u + zmp_offset``.
    """

    # `(g/H) (force_slope - zmp_slope)` [1/s^2]; positive: hyperbolic, negative: trigonometric, zero: constant
    # velocity
    rate: float
    zmp_slope: float  # `1/a`; `1/a_s` or `1/a_d` in the sagittal plane [1]
    force_slope: float  # `c`; `c_s` or `c_d` in the sagittal plane [1]; 1 passes through the COM
    duration: float  # of the phase [s]
    even: float  # amplitude of the part that is even about the middle of the phase [m]
    odd: float  # amplitude of the part that is odd about it [m]; with a rate of zero, the velocity [m/s]
    zmp_offset: float = 0.0  # `b` of the general law [m]

    def evaluate(self, time: Any) -> LawState:
        """State at times since the start of the phase [s]."""
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
    k = np.sqrt(abs(rate))
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
    k = np.sqrt(abs(rate))
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


def double_support_root(tau: Any, half_angle: Any) -> Array:
    """The root ``rho = sqrt(beta/s)`` of ``rho atan(rho / tau) = half_angle``.

    The left side rises from 0 to infinity and is convex, so there is exactly one root and Newton from above
    converges without a safeguard; ``atan z >= z / (1 + 2 z / pi)`` supplies the start above. The root belongs
    to the double support without extra oscillations; the tangent form has others.

    Args:
        tau: ``tanh(k T_SS / 2)``, positive, any shape [1].
        half_angle: ``k T_DS / 2``, positive, same shape [1].

    Returns:
        rho, same shape [1], to machine precision.
    """
    q = half_angle
    rho = q / math.pi + np.sqrt((q / math.pi) * (q / math.pi) + q * tau)
    # Converged elements stay unchanged, so that a root is independent of the rest of its array.
    moving: Any = True
    for _ in range(30):
        angle = np.arctan2(rho, tau)
        step = (rho * angle - q) / (angle + rho * tau / (tau * tau + rho * rho))
        rho = np.where(moving, rho - step, rho)
        moving = moving & (abs(step) > 4.0 * EPSILON * rho)
        if not np.any(moving):
            break
    return rho

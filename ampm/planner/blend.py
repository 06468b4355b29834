"""One axis of the COM while the ground force passes from one support to the next.

ZMP ``p``, the point ``r`` where the force line meets the COM's height, and the moment arm ``q = p - r`` blend
from their values at the begin to those at the end by one fixed function of time,

    sigma(t) = sin(k (t - T/2)) / (2 sin(k T/2)),  from -1/2 to 1/2;  (t - T/2) / T for k = 0.

In the paper's double support all three are proportional to this sine about the midpoint of the feet, with the
rate ``k`` of that support; a fixed ``k`` leaves the motion linear in what is blended, for any footsteps.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ampm.planner.pendulum import LawState


class Shape(NamedTuple):
    """The function sigma at some times, with its derivative and its integrals since the begin."""

    value: Any  # [1]
    rate: Any  # [1/s]
    integral: Any  # [s]
    double_integral: Any  # [s^2]


def shape(rate: Any, duration: Any, time: Any) -> Shape:
    """The function sigma; all arguments broadcast.

    Args:
        rate: k [1/s], less than pi / T; zero blends linearly.
        duration: T [s].
        time: since the begin [s].
    """
    half, middle = 0.5 * rate * duration, time - 0.5 * duration
    linear = rate == 0.0
    k, sine = np.where(linear, 1.0, rate), np.where(linear, 1.0, np.sin(half))
    value = np.where(linear, middle / duration, 0.5 * np.sin(rate * middle) / sine)
    slope = np.where(linear, 1.0 / duration, 0.5 * k * np.cos(rate * middle) / sine)
    integral = np.where(
        linear,
        -0.5 * time * (duration - time) / duration,
        -np.sin(0.5 * rate * time) * np.sin(0.5 * rate * (duration - time)) / (k * sine),
    )
    double = np.where(
        linear,
        time * time * (2.0 * time - 3.0 * duration) / (12.0 * duration),
        0.5 * time * np.cos(half) / (k * sine) - (value + 0.5) / (k * k),
    )
    return Shape(value, slope, integral, double)


@dataclass(frozen=True)
class BlendLaw:
    """A law that blends force point, ZMP and moment arm from one support to the next."""

    omega: float  # sqrt(g / H) [1/s]
    rate: float  # k of the blend [1/s]
    duration: float  # [s]
    position: float  # of the COM at the begin [m]
    velocity: float  # likewise [m/s]
    force_point: tuple[float, float]  # r at begin and end [m]
    moment_arm: tuple[float, float]  # q at begin and end [m]

    def evaluate(self, time: Any) -> LawState:
        """State at times since the start of the phase [s]."""
        time = np.asarray(time, dtype=np.float64)
        at, begin = shape(self.rate, self.duration, time), shape(self.rate, self.duration, 0.0)
        (r0, r1), (q0, q1), omega = self.force_point, self.moment_arm, self.omega
        point, arm = 0.5 * (r0 + r1) + (r1 - r0) * at.value, 0.5 * (q0 + q1) + (q1 - q0) * at.value
        # The particular solution follows the force point with its part of an oscillation of rate k.
        gain = omega**2 / (omega**2 + self.rate**2) * (r1 - r0)
        offset = self.position - 0.5 * (r0 + r1) - gain * begin.value
        speed = self.velocity - gain * begin.rate
        c, s = np.cosh(omega * time), np.sinh(omega * time)
        position = 0.5 * (r0 + r1) + gain * at.value + offset * c + speed / omega * s
        return LawState(
            position=position,
            velocity=gain * at.rate + omega * offset * s + speed * c,
            acceleration=omega**2 * (position - point),
            zmp=point + arm,
            moment_arm=arm,
            moment_arm_integral=0.5 * (q0 + q1) * time + (q1 - q0) * at.integral,
        )

"""Parameters of a gait, and the closed form that follows from them.

All numbers of a plan and of the rules of refusal are computed here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ampm.parameters import GRAVITY, GaitParameters
from ampm.planner.pendulum import EPSILON, AffineLaw, double_support_root

LEAST_MID_STANCE_SHARE = 0.2
"""Least speed over the foot, as a share of v0: below it the pendulum nearly stops and every error grows."""

LIPM = "lipm"
"""Value of ``gait.planner`` for the closed form of the plain inverted pendulum."""
_PLAIN_SLOPES = {"a_s": math.inf, "c_s": 1.0, "c_y": 1.0}  # ZMP at rest, force through the COM

_ROUNDING = 8.0 * EPSILON

_LARGEST_COSH = 700.0  # argument at which cosh still fits a double


@dataclass(frozen=True)
class SagittalPlane:
    """Sagittal constants of a periodic gait (paper, section 2.1) and its two laws.

    Attributes:
        l_s: half the COM's travel in single support [m].
        l_d: half the COM's travel in double support [m].
        a_d: COM travel over ZMP travel in double support [1].
        c_d: force slope in double support [1].
        single: law of single support, from the stance foot's reference point.
        double: law of double support, from the midpoint of both feet's reference points.
    """

    l_s: float
    l_d: float
    a_d: float
    c_d: float
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

    s: float
    beta: float
    velocity: float
    single: AffineLaw
    double: AffineLaw


@dataclass(frozen=True)
class ClosedForm:
    """Parameters of a gait, and what follows from them.

    Attributes:
        plain: whether it is the plain inverted pendulum.

    All others: see :class:`ampm.parameters.GaitParameters`. They are NumPy's numbers: those of too different
    size give infinities or NaN, which the last rule refuses.
    """

    plain: bool
    com_height: float
    step_length: float
    switching_velocity: float
    single_support_ratio: float
    a_s: float
    c_s: float
    c_y: float
    step_width: float
    steps: float

    @classmethod
    def of(cls, gait: GaitParameters) -> ClosedForm:
        """The closed form of a gait."""
        plain = gait.planner == LIPM
        values = gait.model_dump() | (_PLAIN_SLOPES if plain else {})
        return cls(plain, *(np.float64(values[field.name]) for field in fields(cls)[1:]))

    @cached_property
    def inverse_a_s(self) -> float:
        """``1/a_s`` [1]."""
        return 1.0 / self.a_s

    @cached_property
    def bracket(self) -> float:
        """``c_s - 1/a_s`` [1]."""
        return self.c_s - self.inverse_a_s

    @cached_property
    def least_velocity(self) -> float:
        """``l_s / T_s``, above which the COM passes over the foot [m/s]."""
        l_s = 0.5 * self.step_length * self.single_support_ratio
        return l_s / np.sqrt(self.com_height / (self.bracket * GRAVITY))

    @cached_property
    def mid_stance_velocity(self) -> float:
        """Speed of the COM over the foot [m/s]."""
        v0, least = self.switching_velocity, self.least_velocity
        return np.sqrt((v0 - least) * (v0 + least))

    @property
    def least_mid_stance_velocity(self) -> float:
        """Speed over the foot below which the pendulum nearly stops [m/s]."""
        return LEAST_MID_STANCE_SHARE * self.switching_velocity

    @property
    def sufficient_velocity(self) -> str:
        """Switching velocity from which the COM passes over the foot fast enough [m/s]."""
        return _rounded_up(float(self.least_velocity) / math.sqrt(1.0 - LEAST_MID_STANCE_SHARE**2))

    @property
    def sufficient_a_s(self) -> str:
        """The a_s above which the COM is driven off the stance foot, if there is one, as a way out."""
        return f" or gait.a_s above {1.0 / self.c_s:.6g}" if self.c_s > 0.0 else ""

    @cached_property
    def sagittal(self) -> SagittalPlane:
        """Closed form of the sagittal plane.

        Continuity of ZMP and force at the switches fixes the double support:
        ``c_s l_s + c_d l_d = l_s + l_d`` (paper Eq. 4, corrected) and ``l_s/a_s + l_d/a_d = l_s + l_d``.

        The plain inverted pendulum (paper, section 1.2; Kajita et al., IROS 2001) has a double support at the
        velocity of the switch: the ground force is vertical and the ZMP under the COM, so both jump at a
        switch.
        """
        v0, plain = self.switching_velocity, self.plain
        half = 0.5 * self.step_length
        l_s = half * self.single_support_ratio
        l_d = half * (1.0 - self.single_support_ratio)
        ratio = l_s / l_d
        # Written from 1, so that c_s = 1 leaves c_d exactly 1 and the moment exactly zero.
        c_d = 1.0 - (self.c_s - 1.0) * ratio
        inverse_a_d = 1.0 if plain else 1.0 + (1.0 - self.inverse_a_s) * ratio
        # By both continuity conditions the brackets of single and double support have opposite signs.
        rate_s = GRAVITY / self.com_height * self.bracket
        rate_d = -rate_s * ratio
        k_s, k_d = np.sqrt(rate_s), np.sqrt(-rate_d)
        reach_s, reach_d = v0 / k_s, v0 / k_d  # v0 T_s, v0 T_d
        odd_s = np.sqrt((reach_s - l_s) * (reach_s + l_s))
        duration_s = 2.0 / k_s * np.arcsinh(l_s / odd_s)
        duration_d = 2.0 * l_d / v0 if plain else 2.0 / k_d * np.arctan2(l_d, reach_d)
        odd_d = v0 if plain else np.hypot(l_d, reach_d)
        return SagittalPlane(
            l_s=l_s,
            l_d=l_d,
            a_d=1.0 / inverse_a_d,
            c_d=c_d,
            single=AffineLaw(rate_s, self.inverse_a_s, self.c_s, duration_s, 0.0, odd_s),
            double=AffineLaw(0.0 if plain else rate_d, inverse_a_d, c_d, duration_d, 0.0, odd_d),
        )

    @cached_property
    def time_constants(self) -> float:
        """Duration of single support over the time constant of the lateral pendulum [1]."""
        return np.sqrt(self.c_y * GRAVITY / self.com_height) * self.sagittal.single.duration

    @cached_property
    def frontal(self) -> FrontalPlane:
        """Closed form of the frontal plane: both durations are known, beta is not.

        Of the plain inverted pendulum beta is what the COM drifts in half a double support:
        ``beta = v T_DS / 2`` with ``v = s k tanh(k T_SS / 2)``.
        """
        plain, c_y = self.plain, self.c_y
        t_ss, t_ds = self.sagittal.single.duration, self.sagittal.double.duration
        k = np.sqrt(c_y * GRAVITY / self.com_height)  # 1 / T_l
        h = 0.5 * k * t_ss
        tau = np.tanh(h)
        rho = np.float64(double_support_root(tau, 0.5 * k * t_ds))
        drift = 0.5 * k * t_ds * tau  # beta / s of the plain pendulum
        s = 0.5 * self.step_width / (1.0 + (drift if plain else rho * rho))
        velocity = s * k * tau
        slope = 1.0 / (rho * rho)  # s / beta
        return FrontalPlane(
            s=s,
            beta=s * (drift if plain else rho * rho),
            velocity=velocity,
            single=AffineLaw(
                rate=GRAVITY / self.com_height if plain else k * k,
                zmp_slope=0.0,
                force_slope=c_y,
                duration=t_ss,
                even=-s / np.cosh(np.minimum(h, _LARGEST_COSH)),
                odd=0.0,
            ),
            double=AffineLaw(
                rate=0.0 if plain else -k * k * slope,
                zmp_slope=1.0 if plain else 1.0 + slope,
                force_slope=1.0 if plain else 1.0 + (1.0 - c_y) * slope,
                duration=t_ds,
                even=0.0,
                odd=-velocity if plain else -s * rho * np.hypot(rho, tau),
            ),
        )

    @cached_property
    def rounding(self) -> float:
        """Bound on the jumps at a switch that rounding can cause, in the scales of ``PlanResiduals`` [1].

        The closed form is continuous, so that every jump is rounding. Every law is purely even or purely odd:
        its amplitude at the ends of the phase bounds what is rounded.
        """
        height, v0 = self.com_height, self.switching_velocity
        sagittal, frontal = self.sagittal, self.frontal
        far, near = (self.steps + 1) * self.step_length, 0.5 * self.step_width
        worst: float = 0.0
        for law, origin, sway in (
            (sagittal.single, far, v0 / np.sqrt(sagittal.single.rate)),
            (sagittal.double, far, abs(sagittal.double.odd)),
            (frontal.single, near, frontal.s),
            (frontal.double, near, abs(frontal.double.odd)),
        ):
            k = np.sqrt(abs(law.rate))
            uniform = law.rate == 0.0  # then ``odd`` is a velocity
            speed = sway if uniform else k * sway
            sway = sway * law.duration if uniform else sway
            arm = (abs(law.force_slope) + 1.0) * sway
            jumps = abs(law.rate) * sway / GRAVITY, (origin + abs(law.zmp_slope) * sway) / height
            for term in (
                (origin + sway) / height,
                speed / v0,
                arm / height,
                arm * law.duration * GRAVITY / (height * v0),
                0.0 if self.plain else np.maximum(*jumps),
            ):
                worst = np.maximum(worst, term * (1.0 + 0.5 * k * law.duration))  # a NaN stays one
        return _ROUNDING * worst if worst >= 0.0 else math.inf  # infinite for NaN


def _rounded_up(value: float) -> str:
    """``value`` with four digits, rounded up."""
    if value < 1e-300 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.ceil(value / unit * (1.0 + 1e-12)) * unit:.4g}"

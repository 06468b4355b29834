"""Rules that refuse a gait: one table, which reads one gait or arrays of gaits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import MathematicalRefusal
from ampm.parameters import GRAVITY, GaitParameters
from ampm.planner import pendulum
from ampm.planner.pendulum import FrontalPlane, SagittalPlane

Array = NDArray[np.float64]

LEAST_MID_STANCE_SHARE = 0.2
"""Least speed over the foot, as a share of v0: below it the pendulum nearly stops and every error grows."""
RESIDUAL_LIMIT = 1e-9
"""Largest relative jump at a switch that rounding may cause."""

_ROUNDING = 8.0 * np.finfo(np.float64).eps
_CHUNK = 16_384  # gaits at a time: their arrays stay in the processor's cache


@dataclass(frozen=True)
class Gaits:
    """Parameters of one gait as numbers, or of n gaits as arrays (n,), and what follows from them.

    Attributes:
        model: ``ampm`` or ``ipm``.

    All others: see :class:`ampm.parameters.GaitParameters`. Numbers too far apart give infinities or NaN,
    which the last rule refuses.
    """

    model: Any
    com_height: Any
    step_length: Any
    switching_velocity: Any
    single_support_ratio: Any
    a_s: Any
    c_s: Any
    c_y: Any
    step_width: Any
    steps: Any

    @classmethod
    def of(cls, gait: GaitParameters) -> Gaits:
        """One gait."""
        return cls(**{field.name: np.asarray(getattr(gait, field.name)) for field in fields(cls)})

    def part(self, which: slice) -> Gaits:
        """Some of n gaits."""
        return Gaits(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    @cached_property
    def plain(self) -> NDArray[np.bool_]:
        """Whether it is the plain inverted pendulum."""
        return np.asarray(self.model == "ipm")

    @cached_property
    def inverse_a_s(self) -> Array:
        """``1/a_s`` [1]."""
        return 1.0 / self.a_s

    @cached_property
    def bracket(self) -> Array:
        """``c_s - 1/a_s`` [1]."""
        return self.c_s - self.inverse_a_s

    @cached_property
    def least_velocity(self) -> Array:
        """``l_s / T_s``, above which the COM passes over the foot [m/s]."""
        l_s = 0.5 * self.step_length * self.single_support_ratio
        return l_s / pendulum.sagittal_time_constant(self.com_height, self.bracket, GRAVITY)

    @cached_property
    def mid_stance_velocity(self) -> Array:
        """Speed of the COM over the foot [m/s]."""
        v0, least = self.switching_velocity, self.least_velocity
        return np.sqrt((v0 - least) * (v0 + least))

    @property
    def least_mid_stance_velocity(self) -> Array:
        """Speed over the foot below which the pendulum nearly stops [m/s]."""
        return LEAST_MID_STANCE_SHARE * self.switching_velocity

    @property
    def sufficient_velocity(self) -> str:
        """Switching velocity of one gait from which the COM passes over the foot fast enough [m/s]."""
        return _rounded_up(float(self.least_velocity) / math.sqrt(1.0 - LEAST_MID_STANCE_SHARE**2))

    @property
    def sufficient_a_s(self) -> str:
        """The a_s above which one gait is driven off the stance foot, if there is one, as a way out."""
        return f" or gait.a_s above {1.0 / self.c_s:.6g}" if self.c_s > 0.0 else ""

    @cached_property
    def sagittal(self) -> SagittalPlane:
        """Closed form of the sagittal plane."""
        return pendulum.sagittal_plane(
            com_height=self.com_height,
            step_length=self.step_length,
            single_support_ratio=self.single_support_ratio,
            switching_velocity=self.switching_velocity,
            inverse_a_s=self.inverse_a_s,
            c_s=self.c_s,
            gravity=GRAVITY,
            plain=self.plain,
        )

    @cached_property
    def time_constants(self) -> Array:
        """Duration of single support over the time constant of the lateral pendulum [1]."""
        return np.sqrt(self.c_y * GRAVITY / self.com_height) * self.sagittal.single.duration

    @cached_property
    def frontal(self) -> FrontalPlane:
        """Closed form of the frontal plane."""
        return pendulum.frontal_plane(
            com_height=self.com_height,
            half_width=0.5 * self.step_width,
            c_y=self.c_y,
            single_support_duration=self.sagittal.single.duration,
            double_support_duration=self.sagittal.double.duration,
            gravity=GRAVITY,
            plain=self.plain,
        )

    @cached_property
    def rounding(self) -> Array:
        """Bound on what rounding may make a plan jump at a switch, in the scales of ``PlanResiduals`` [1].

        The closed form joins exactly, so whatever jumps is rounding. Every law is purely even or purely odd:
        its amplitude at the ends of the phase bounds what is rounded.
        """
        height, v0 = self.com_height, self.switching_velocity
        sagittal, frontal = self.sagittal, self.frontal
        far, near = (self.steps + 1) * self.step_length, 0.5 * self.step_width
        worst = np.zeros_like(height)
        for law, origin, sway in (
            (sagittal.single, far, v0 / np.sqrt(sagittal.single.rate)),
            (sagittal.double, far, np.abs(sagittal.double.odd)),
            (frontal.single, near, frontal.s),
            (frontal.double, near, np.abs(frontal.double.odd)),
        ):
            k = np.sqrt(np.abs(law.rate))
            uniform = law.rate == 0.0  # then ``odd`` is a velocity
            speed = np.where(uniform, sway, k * sway)
            sway = np.where(uniform, sway * law.duration, sway)
            arm = (np.abs(law.force_slope) + 1.0) * sway
            jumps = np.abs(law.rate) * sway / GRAVITY, (origin + np.abs(law.zmp_slope) * sway) / height
            for term in (
                (origin + sway) / height,
                speed / v0,
                arm / height,
                arm * law.duration * GRAVITY / (height * v0),
                np.where(self.plain, 0.0, np.maximum(*jumps)),
            ):
                worst = np.maximum(worst, term * (1.0 + 0.5 * k * law.duration))  # a NaN stays one
        return np.where(np.isnan(worst), math.inf, _ROUNDING * worst)


@dataclass(frozen=True)
class Rule:
    """One way in which a gait has no plan.

    Attributes:
        reason: short name; several rules may share it.
        value: what is limited, an attribute of :class:`Gaits`.
        passes: comparison of value and limit; it holds for what is not refused, and not for NaN.
        limit: a number or an attribute of :class:`Gaits`.
        unit: SI unit of value and limit.
        message, way_out: sentence about gait ``g``, ``value`` and ``limit``, as templates.
        applies: attribute of :class:`Gaits` that says to which gaits the rule applies; None for all.
    """

    reason: str
    value: str
    passes: Callable[[Any, Any], Any]
    limit: str | float
    unit: str
    message: str
    way_out: str
    applies: str | None = None

    def _limit(self, gaits: Gaits) -> Any:
        return getattr(gaits, self.limit) if isinstance(self.limit, str) else self.limit

    def refused(self, gaits: Gaits) -> NDArray[np.bool_]:
        """Which gaits break the rule."""
        broken = ~np.asarray(self.passes(getattr(gaits, self.value), self._limit(gaits)))
        return broken if self.applies is None else broken & getattr(gaits, self.applies)

    def refusal(self, gait: Gaits) -> MathematicalRefusal:
        """Message for one gait that breaks the rule."""
        value, limit = float(getattr(gait, self.value)), float(self._limit(gait))
        texts = [text.format(g=gait, value=value, limit=limit) for text in (self.message, self.way_out)]
        return MathematicalRefusal(
            texts[0], reason=self.reason, value=value, limit=limit, unit=self.unit, way_out=texts[1]
        )


_FASTER = "raise gait.switching_velocity to {g.sufficient_velocity} m/s or shorten gait.step_length"
RULES: tuple[Rule, ...] = (
    *(
        Rule(  # refused, rather than ignored
            "not_the_plain_pendulum", key, np.equal, fixed, "1",
            f"gait.{key} = {{value:.6g}} is no choice of the plain inverted pendulum (gait.model = ipm): its "
            f"ZMP rests under the foot and its force passes through the COM, so that gait.{key} = {fixed:g}",
            f"set gait.{key} to {fixed:g}, take the preset ipm, or gait.model = ampm",
            applies="plain",
        )
        for key, fixed in {"a_s": math.inf, "c_s": 1.0, "c_y": 1.0}.items()
    ),
    Rule(
        "single_support_not_driven", "bracket", np.greater, 0.0, "1",
        "gait.c_s - 1/gait.a_s = {value:.6g} must be greater than 0: the COM would not be driven off the "
        "stance foot",
        "raise gait.c_s above {g.inverse_a_s:.6g}{g.sufficient_a_s}",
    ),
    Rule(
        "c_y_not_positive", "c_y", np.greater, 0.0, "1",
        "gait.c_y = {value:.6g} must be greater than 0: the COM would not be driven back from the stance "
        "foot to the midline",
        "choose gait.c_y greater than 0, for example 0.4",
    ),
    Rule(
        "switching_velocity_too_low", "switching_velocity", np.greater, "least_velocity", "m/s",
        "gait.switching_velocity = {value:.6g} m/s is too slow to pass over the foot: the least is l_s/T_s = "
        "{limit:.6g} m/s",
        _FASTER,
    ),
    Rule(
        "mid_stance_too_slow", "mid_stance_velocity", np.greater_equal, "least_mid_stance_velocity", "m/s",
        "the COM would pass over the foot at {value:.6g} m/s, less than {limit:.6g} m/s, "
        f"{LEAST_MID_STANCE_SHARE:.0%} of gait.switching_velocity = {{g.switching_velocity:.6g}} m/s (it "
        "passes at all from {g.least_velocity:.6g} m/s)",
        _FASTER,
    ),
    Rule(  # cosh of half of the limit still fits a double
        "single_support_too_long", "time_constants", np.less_equal, 600.0, "1",
        "single support lasts {value:.4g} time constants of the lateral pendulum, more than {limit:g}: no "
        "side to side motion of that period can be computed",
        "raise gait.switching_velocity, shorten gait.step_length or lower gait.c_y",
    ),
    Rule(
        "ill_conditioned", "rounding", np.less_equal, RESIDUAL_LIMIT, "1",
        "the gait's numbers are too far apart to be computed: rounding could make the plan jump by "
        "{value:.1e} of its own scale at a switch, more than {limit:g}",
        "bring gait.com_height, gait.step_length, gait.step_width and gait.c_y nearer to each other, and "
        "gait.single_support_ratio away from 0 and 1",
    ),
)  # fmt: skip
"""All rules, in the order in which they are applied: a gait is refused by the first that it breaks."""

REASONS = ("accepted", *dict.fromkeys(rule.reason for rule in RULES))
"""Results of :func:`screen`; a code is an index into this."""


def screen(gaits: Gaits) -> NDArray[np.int8]:
    """Apply the rules of :func:`plan_gait` to n gaits, a million in seconds.

    Args:
        gaits: arrays of shape (n,), each value within its parameter's bounds.

    Returns:
        Of every gait the place of its refusal in :data:`REASONS`, 0 if it has a plan, shape (n,).
    """
    code = np.zeros(len(gaits.model), dtype=np.int8)
    with np.errstate(all="ignore"):  # what overflows is refused by the last rule
        for start in range(0, len(code), _CHUNK):
            which = slice(start, start + _CHUNK)
            part, found = gaits.part(which), code[which]
            for rule in RULES:
                found[(found == 0) & rule.refused(part)] = REASONS.index(rule.reason)
    return code


def _rounded_up(value: float) -> str:
    """``value`` with four digits, never below it."""
    if value < 1e-300 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.ceil(value / unit * (1.0 + 1e-12)) * unit:.4g}"

"""Rules that refuse a gait: one table."""

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import MathematicalRefusal
from ampm.planner.closed_form import LEAST_MID_STANCE_SHARE, ClosedForm

Array = NDArray[np.float64]

RESIDUAL_LIMIT = 1e-9
"""Largest relative jump at a switch that rounding may cause."""


@dataclass(frozen=True)
class Rule:
    """One way in which a gait has no plan.

    Attributes:
        reason: short name; several rules may share it.
        value: what is limited, an attribute of :class:`ClosedForm`.
        passes: comparison of value and limit that a valid gait meets; false for NaN.
        limit: a number or an attribute of :class:`ClosedForm`.
        unit: SI unit of value and limit.
        message, way_out: sentence about gait ``g``, ``value`` and ``limit``, as templates.
    """

    reason: str
    value: str
    passes: Callable[[Any, Any], Any]
    limit: str | float
    unit: str
    message: str
    way_out: str

    def _limit(self, gait: ClosedForm) -> Any:
        return getattr(gait, self.limit) if isinstance(self.limit, str) else self.limit

    def met(self, gait: ClosedForm) -> Any:
        """Whether a gait keeps the rule."""
        return self.passes(getattr(gait, self.value), self._limit(gait))

    def refusal(self, gait: ClosedForm) -> MathematicalRefusal:
        """Message for one gait that breaks the rule."""
        value, limit = float(getattr(gait, self.value)), float(self._limit(gait))
        texts = [text.format(g=gait, value=value, limit=limit) for text in (self.message, self.way_out)]
        return MathematicalRefusal(
            texts[0], reason=self.reason, value=value, limit=limit, unit=self.unit, way_out=texts[1]
        )


_FASTER = "raise gait.switching_velocity to {g.sufficient_velocity} m/s or shorten gait.step_length"
RULES: tuple[Rule, ...] = (
    Rule(
        "single_support_not_driven",
        "bracket",
        operator.gt,
        0.0,
        "1",
        "gait.c_s - 1/gait.a_s = {value:.6g} must be greater than 0: the COM would not be driven off the "
        "stance foot",
        "raise gait.c_s above {g.inverse_a_s:.6g}{g.sufficient_a_s}",
    ),
    Rule(
        "c_y_not_positive",
        "c_y",
        operator.gt,
        0.0,
        "1",
        "gait.c_y = {value:.6g} must be greater than 0: the COM would not be driven back from the stance "
        "foot to the midline",
        "choose gait.c_y greater than 0, for example 0.4",
    ),
    Rule(
        "switching_velocity_too_low",
        "switching_velocity",
        operator.gt,
        "least_velocity",
        "m/s",
        "gait.switching_velocity = {value:.6g} m/s is too slow to pass over the foot: the least is l_s/T_s = "
        "{limit:.6g} m/s",
        _FASTER,
    ),
    Rule(
        "mid_stance_too_slow",
        "mid_stance_velocity",
        operator.ge,
        "least_mid_stance_velocity",
        "m/s",
        "the COM would pass over the foot at {value:.6g} m/s, less than {limit:.6g} m/s, "
        f"{LEAST_MID_STANCE_SHARE:.0%} of gait.switching_velocity = {{g.switching_velocity:.6g}} m/s (it "
        "passes at all from {g.least_velocity:.6g} m/s)",
        _FASTER,
    ),
    Rule(  # cosh of half of the limit still fits a double
        "single_support_too_long",
        "time_constants",
        operator.le,
        600.0,
        "1",
        "single support lasts {value:.4g} time constants of the lateral pendulum, more than {limit:g}: no "
        "side to side motion of that period can be computed",
        "raise gait.switching_velocity, shorten gait.step_length or lower gait.c_y",
    ),
    Rule(
        "ill_conditioned",
        "rounding",
        operator.le,
        RESIDUAL_LIMIT,
        "1",
        "the gait's numbers are too far apart to be computed: rounding could make the plan jump by "
        "{value:.1e} of its own scale at a switch, more than {limit:g}",
        "bring gait.com_height, gait.step_length, gait.step_width and gait.c_y nearer to each other, and "
        "gait.single_support_ratio away from 0 and 1",
    ),
)
"""All rules, in the order in which they are applied: a gait is refused by the first that it breaks."""


def refusal_of(gait: ClosedForm) -> MathematicalRefusal | None:
    """The refusal of one gait by the first rule that it breaks; None if it has a plan."""
    return next((rule.refusal(gait) for rule in RULES if not rule.met(gait)), None)

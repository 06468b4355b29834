"""One metric: name, readable name, unit, computation and tolerances of a judged number.

Limits may grow with sizes of the body: its weight, the length of its foot, and a momentum of both.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import GRAVITY
from ampm.section import unknown
from validation.judge.compare import Comparison

_KINDS, _NATURES = ("walk", "instrument", "cost"), ("mean", "extreme", "count")


@dataclass(frozen=True)
class Metric:
    """One number that a walk is judged by; smaller is better.

    Attributes:
        name: identifier, such as ``zmp_x_rmse``, for files.
        label: readable name, such as ``ZMP, RMS error along x``, for tables and figures; by default ``name``
            with spaces.
        unit: SI unit, ``1`` for a plain number.
        meaning: one phrase for the description of a table's column.
        kind: what it judges: the ``walk``, the ``instrument`` that measures it (its exact value is zero), or
            its ``cost``.
        compute: value in ``unit``; NaN if it could not be measured. Only built-in ones may return None, if
            the walk has no such metric. A registered one is not called where the window has no instant.
        tolerances: name of a profile to the largest value that passes; see
            :class:`validation.judge.profiles.Profile` for profiles that are not named.
        tolerance_unit: of ``tolerances``: ``unit`` by default, or one that grows with the body, such as
            :data:`~validation.judge.metric.BODY_WEIGHT`.
        reason: why the tolerance is what it is, one or two sentences.
        nature: ``mean``; ``extreme``, which is never extrapolated to a vanishing time step; ``count``, which
            is exact.
        section: part of ``summary.json`` that holds the value; empty: ``metrics``.
    """

    name: str
    label: str = field(default="", kw_only=True)
    unit: str
    meaning: str
    kind: Literal["walk", "instrument", "cost"]
    compute: Callable[[Comparison], float | None]
    tolerances: Mapping[str, float] = field(default_factory=dict)
    tolerance_unit: str = ""
    reason: str = ""
    nature: Literal["mean", "extreme", "count"] = "mean"
    section: str = ""

    def __post_init__(self) -> None:
        """Complete the label; refuse a bad name, an unknown kind or nature, a tolerance of no number."""
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise InputError(f"metric name {self.name!r} is not an identifier; use letters, digits and '_'.")
        object.__setattr__(self, "label", self.label or self.name.replace("_", " "))
        for what, value, known in (("kind", self.kind, _KINDS), ("nature", self.nature, _NATURES)):
            if value not in known:
                raise unknown(value, known, f"{what} of the metric '{self.name}'")
        if not isinstance(self.tolerances, Mapping):
            raise InputError(
                f"metric '{self.name}' has the tolerances {self.tolerances!r}; "
                'give those of its profiles: {"default": 0.1}.'
            )
        for limit in self.tolerances.values():
            if not isinstance(limit, Real) or not math.isfinite(limit) or limit < 0.0:
                raise InputError(
                    f"metric '{self.name}' has the tolerance {limit!r}; give a number, 0 or more."
                )

    @property
    def column(self) -> str:
        """Name of its column in a sweep's table."""
        return self.name if self.section else f"metric_{self.name}"

    @property
    def is_self_check(self) -> bool:
        """Whether it measures the error of the instrument itself: its exact value is zero."""
        return self.kind == "instrument" and self.nature != "count"


def display_unit(unit: str, weight: Any) -> tuple[Any, str]:
    """Factor and unit in which an SI unit is shown, of a body with a weight [N], or of several."""
    if unit == "m":
        return 1e3, "mm"
    if unit == "N":
        return 100.0 / weight, "% of body weight"
    return 1.0, "" if unit == "1" else unit


BODY_WEIGHT, FOOT_LENGTH, FOOT_MOMENTUM = "body weight", "foot length", "foot momentum"
"""Units of limits that grow with the body: its weight [N], the length L of its foot [m], and the angular
momentum m (g L^3)^1/2 [N m s]."""
DEFAULT_BODY: Mapping[str, float] = MappingProxyType({"body_weight": 60.0 * GRAVITY, "foot_length": 0.258})
"""Weight [N] and length of a foot [m] of the default body, for which limits in m and N m s are listed."""


def size_in_si(unit: str, scales: Mapping[str, Any]) -> Any:
    """Size of a body or of several in SI units, of one of the units above; 1 of any other unit."""
    weight, foot = scales["body_weight"], scales["foot_length"]
    momentum = weight * np.sqrt(foot**3 / GRAVITY)
    return {BODY_WEIGHT: weight, FOOT_LENGTH: foot, FOOT_MOMENTUM: momentum}.get(unit, 1.0)

"""Sizes of a body with which limits grow: its weight, the length of its foot, and a momentum of both."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from ampm.parameters import GRAVITY

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


def limit_in_si(limit: float, unit: str, scales: Mapping[str, Any]) -> Any:
    """A limit in SI units, for one body or several.

    Args:
        limit: in ``unit``.
        unit: one of :data:`BODY_WEIGHT`, :data:`FOOT_LENGTH`, :data:`FOOT_MOMENTUM`, else an SI unit.
        scales: ``body_weight`` [N] and ``foot_length`` [m], as :attr:`Comparison.scales` has them.
    """
    if unit in (FOOT_LENGTH, FOOT_MOMENTUM):
        return np.round(limit * size_in_si(unit, scales), 12)  # undo the normalisation's rounding
    return limit * size_in_si(unit, scales)


def share_of_default(limit: float, unit: str) -> float:
    """A limit of the default body in SI units, as a share of its size in ``unit``; a weight's is a share."""
    return limit if unit == BODY_WEIGHT else float(limit / size_in_si(unit, DEFAULT_BODY))

"""Two walked gaits and what they are compared by.

How far a measured value is from that of a vanishing time step only a convergence study says: without one no
value of a walk is called better, however large the difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from ampm.planner.support import StepPlan
from validation.judge.uncertainty import Uncertainty
from validation.show.text import format_number
from validation.store.json import json_ready
from validation.store.saved import SavedRun
from validation.study.compare.metrics import Quantity

EVEN = 1.25
"""Ratio of two values within which neither side is called better."""


@dataclass(frozen=True)
class Joints:
    """Joint accelerations of the periodic motion at a switch, on finer and finer grids.

    Attributes:
        grid: largest step of each grid, descending, shape (n,) [s].
        jump: largest change of a joint's acceleration over the grid interval that ends at a switch, shape
            (n,) [rad/s^2].
        limit: value extrapolated from the two finest grids [rad/s^2]: a jump that stays is the
            motion's, one that vanishes was the grid's.
        joint: the joint with the largest limit.
    """

    grid: tuple[float, ...]
    jump: tuple[float, ...]
    limit: float
    joint: str


@dataclass(frozen=True)
class Side:
    """One of the two gaits, walked.

    Attributes:
        label: how tables call it.
        saved: its run.
        plan: in closed form.
        joints: of its motion.
        outcome: name of the outcome.
    """

    label: str
    saved: SavedRun
    plan: StepPlan
    joints: Joints
    outcome: str

    def as_dict(self) -> dict[str, Any]:
        """Facts about the gait: lengths in m, speeds in m/s, durations in s."""
        gait, constants = self.saved.parameters.gait, self.plan.constants
        return {
            "name": self.label,
            "outcome": self.outcome,
            "steps_completed": self.saved.record.outcome.steps_completed,
            "model": gait.model,
            "step_length": gait.step_length,
            "switching_velocity": gait.switching_velocity,
            "mean_velocity": constants.mean_velocity,
            "single_support_duration": constants.single_support_duration,
            "double_support_duration": constants.double_support_duration,
            "joint_acceleration_jump": self.joints,
        }


_FACTS = {
    "outcome": "{outcome}, {steps_completed} steps",
    "model": "{model}",
    "step length": "{step_length:g} m",
    "speed at a switch": "{switching_velocity:g} m/s",
    "mean speed": "{mean_velocity:.3f} m/s",
    "single support": "{single_support_duration:.3f} s",
    "double support": "{double_support_duration:.3f} s",
    "joint that jumps most": "{joint_acceleration_jump.joint}",
}


class Row(NamedTuple):
    """One quantity of both sides.

    Attributes:
        of: the quantity.
        a: value of the first side as shown, NaN if it has none.
        b: of the second side.
        u_a: numerical uncertainty of ``a``: 0 where nothing is walked, infinite without bound, NaN unknown.
        u_b: of ``b``.
    """

    of: Quantity
    a: float
    b: float
    u_a: float = math.nan
    u_b: float = math.nan

    @property
    def ratio(self) -> float | None:
        """Second over first value; None if one is missing, or noise."""
        known = math.isfinite(self.a) and math.isfinite(self.b)
        return self.b / self.a if known and min(self.a, self.b) >= self.of.least else None

    @property
    def better(self) -> str:
        """``a``, ``b``, or ``even`` where they differ by less than :data:`EVEN`.

        Empty where undecided: a value is missing, its numerical uncertainty is not known, or the
        difference is within that of both.
        """
        u = self.u_a + self.u_b
        if not (math.isfinite(self.a) and math.isfinite(self.b) and math.isfinite(u)):
            return ""
        if u > 0.0 and abs(self.a - self.b) <= u:
            return ""
        ratio = max(self.b, self.of.least) / max(self.a, self.of.least)
        return "a" if ratio > EVEN else "b" if ratio < 1.0 / EVEN else "even"


@dataclass(frozen=True)
class Pair:
    """Both sides and all that they are compared by.

    Attributes:
        a: first side.
        b: second side.
        rows: quantities, group by group.
        studies: convergence study of either side; None without.
    """

    a: Side
    b: Side
    rows: tuple[Row, ...]
    studies: tuple[Uncertainty, Uncertainty] | None = None

    @property
    def parameters(self) -> dict[str, tuple[Any, Any]]:
        """Key to the values of both sides, of every parameter in which they differ."""
        one, two = (side.saved.parameters.model_dump() for side in (self.a, self.b))
        return {
            f"{section}.{key}": (value, two[section][key])
            for section, entries in one.items()
            for key, value in entries.items()
            if value != two[section][key]
        }

    def unbounded(self, count: int = 5) -> list[Row]:
        """Rows of the largest ratios among the undecided ones."""
        open_rows = [row for row in self.rows if row.better == "" and row.ratio]
        return sorted(open_rows, key=lambda row: -abs(math.log(row.ratio or 1.0)))[:count]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        quantities = {
            row.of.name: {
                **{key: getattr(row.of, key) for key in ("group", "label", "unit")},
                **{key: getattr(row, key) for key in ("a", "b", "ratio", "better")},
                "uncertainty": {"a": row.u_a, "b": row.u_b},
            }
            for row in self.rows
        }
        table = {
            "a": self.a.as_dict(),
            "b": self.b.as_dict(),
            "parameters": self.parameters,
            "uncertainty": None if self.studies is None else [study.as_dict() for study in self.studies],
            "quantities": quantities,
        }
        return dict(json_ready(table))


def facts(pair: Pair) -> list[tuple[str, ...]]:
    """Facts about both gaits: name of the fact, first side, second side."""
    a, b = pair.a.as_dict(), pair.b.as_dict()
    return [
        (name, *(text.format(**side).replace("_", " ") for side in (a, b))) for name, text in _FACTS.items()
    ]


def tables(pair: Pair) -> dict[str, list[tuple[str, ...]]]:
    """Heading to rows of label, both values, unit, ratio, and which side is better."""
    names = {"a": pair.a.label, "b": pair.b.label, "even": "=", "": ""}
    found: dict[str, list[tuple[str, ...]]] = {}
    for row in pair.rows:
        cells = (row.of.label, shown(row.a), shown(row.b), row.of.unit, ratio(row), names[row.better])
        found.setdefault(row.of.group, []).append(cells)
    return found


def counts(pair: Pair) -> list[str]:
    """In how many quantities each side is better, neither is, or which are undecided."""
    words = {
        "a": f"{pair.a.label} is better in",
        "even": "no difference in",
        "b": f"{pair.b.label} is better in",
        "": "undecided:",
    }
    found = [row.better for row in pair.rows]
    return [f"{text} {found.count(better)} of {len(found)} quantities" for better, text in words.items()]


def known(pair: Pair) -> str:
    """Explanation of the thresholds for a difference, in a sentence or two."""
    if pair.studies is None:
        return (
            "No convergence study was given (--uncertainty FILE, one per gait): of the walks no value is "
            "called better, only of plan and motion, which are not simulated."
        )
    parts = []
    for side, study in zip((pair.a, pair.b), pair.studies, strict=True):
        inside = " + ".join(study.studies) or "no numerical study"
        lacking = f", not studied: {', '.join(study.not_studied)}" if study.not_studied else ""
        parts.append(f"of {side.label} ({inside}{lacking})")
    return (
        f"A difference within the sum of both numerical uncertainties, {' and '.join(parts)}, is no result, "
        "nor is one of a value whose uncertainty is not known."
    )


def shown(value: float) -> str:
    """A value for a table: rounding errors are 0."""
    return "0" if abs(value) < 1e-9 else format_number(value, 3)


def ratio(row: Row) -> str:
    """Second over first value, for a table."""
    if row.ratio is None:
        return ""
    return "> 1000" if row.ratio > 1000.0 else "< 0.001" if row.ratio < 1e-3 else format_number(row.ratio, 3)

"""Which cases of a sweep have no plan, without planning them: a million gaits in seconds.

Parameter bounds and the refusals of ``plan_gait`` on arrays; the few cases that rounding could decide either
way are given to ``plan_gait`` itself. So the answer is the planner's, case for case and reason for reason. It
is the formula's answer: what soles, legs and joints refuse is seen only when a body is planned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ampm.exceptions import MathematicalRefusal
from ampm.parameters import keys
from ampm.planner.periodic import plan_gait
from validation.study.sweep.closed_form import (
    ACCEPTED,
    BAD_PARAMETER,
    CODES,
    LARGEST_ANGLE,
    PLAIN,
    REASONS,
    Gaits,
    judge,
    sufficient_velocity,
)
from validation.study.sweep.definition import SweepDefinition
from validation.study.sweep.keys import KeyInfo, key_info
from validation.study.sweep.sampling import Cases
from validation.study.sweep.sampling import cases as cases_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MODEL_KEY = "gait.model"
_GAIT_KEYS = tuple("body.mass" if name == "mass" else f"gait.{name}" for name in Gaits._fields)
_RULES = {
    "not_the_plain_pendulum": "exactly",
    "single_support_not_driven": "greater than",
    "c_y_not_positive": "greater than",
    "switching_velocity_too_low": "at least",
    "mid_stance_too_slow": "at least",
    "single_support_too_long": "at most",
}  # what the needed value is to the key; a reason that is not here has no way out by one key

_CHUNK = 16_384  # cases at a time: their arrays stay in the processor's cache


@dataclass(frozen=True)
class Refusal:
    """One reason and the cases that it refuses.

    Attributes:
        reason: code.
        meaning: in words.
        count: cases.
        key: parameter that could be changed, or None.
        unit: SI unit of the figures.
        asked: least and largest value of the key in these cases, or None.
        rule: ``at least``, ``at most``, ``greater than``, ``less than`` or ``exactly`` the needed values.
        needed: least and largest of the values that would pass, each in its own case; None where unknown.
    """

    reason: str
    meaning: str
    count: int
    key: str | None = None
    unit: str = "1"
    asked: tuple[float, float] | None = None
    rule: str | None = None
    needed: tuple[float, float] | None = None

    def way_out(self) -> str:
        """What would pass, in words; empty where that is unknown."""
        if self.key is None or self.rule is None or self.needed is None:
            return ""
        up = self.rule in ("at least", "greater than")
        low, high = (_rounded(value, up) if self.rule != "exactly" else f"{value:g}" for value in self.needed)
        unit = "" if self.unit == "1" else f" {self.unit}"
        several = f"{low}{unit}" if low == high else f"{low} ... {high}{unit}"
        return f"{self.key} {self.rule} {several}"


@dataclass(frozen=True)
class Screening:
    """The planner's answer to every case of a sweep; all arrays are read-only.

    Attributes:
        code: place of the reason in :data:`validation.study.sweep.closed_form.REASONS`, shape (N,).
        key: place in :func:`ampm.parameters.keys` of the parameter that could be changed, or -1, shape (N,).
        asked: value of that key, NaN where there is none, shape (N,).
        needed: the limit that it passed, as a value of the key, NaN where unknown, shape (N,).
        step_duration: T_SS + T_DS of the plan, NaN without one, shape (N,) [s].
        planned: cases that were left to ``plan_gait``.
    """

    code: NDArray[np.int8]
    key: NDArray[np.int16]
    asked: Array
    needed: Array
    step_duration: Array
    planned: int

    def __post_init__(self) -> None:
        for array in (self.code, self.key, self.asked, self.needed, self.step_duration):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.code)

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Which cases have a plan, shape (N,)."""
        return self.code == CODES[ACCEPTED]

    def reason(self, case: int) -> str | None:
        """Why a case is refused, or None."""
        name = tuple(REASONS)[self.code[case]]
        return None if name == ACCEPTED else name

    def counts(self) -> dict[str, int]:
        """Cases by reason, those that occur; the accepted ones first."""
        number = np.bincount(self.code, minlength=len(REASONS))
        return {reason: int(n) for reason, n in zip(REASONS, number, strict=True) if n}

    def refusals(self) -> list[Refusal]:
        """Refused cases by reason and key; parameters beyond their bounds also by bound."""
        found: list[Refusal] = []
        for reason in self.counts():
            if reason == ACCEPTED:
                continue
            mask = self.code == CODES[reason]
            for index in np.unique(self.key[mask]):
                this = mask & (self.key == index)
                if index < 0:
                    found.append(Refusal(reason, REASONS[reason], int(this.sum())))
                    continue
                info = key_info(keys()[index])
                if reason == BAD_PARAMETER:
                    low = this & info.below(self.asked)
                    found += self._group(reason, info, low, info.rules[0])
                    found += self._group(reason, info, this & ~low, info.rules[1])
                else:
                    found += self._group(reason, info, this, _RULES[reason])
        return found

    def _group(self, reason: str, info: KeyInfo, mask: NDArray[np.bool_], rule: str) -> list[Refusal]:
        if not mask.any():
            return []
        asked, needed = _ends(self.asked[mask]), _ends(self.needed[mask])
        return [
            Refusal(reason, REASONS[reason], int(mask.sum()), info.key, info.unit, asked, rule, needed),
        ]


def _ends(values: Array) -> tuple[float, float] | None:
    known = values[~np.isnan(values)]
    return (float(known.min()), float(known.max())) if known.size else None


def _rounded(value: float, up: bool) -> str:
    """Four digits, on the side that passes."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 3)
    count = value / unit
    return f"{(math.ceil(count - 1e-9) if up else math.floor(count + 1e-9)) * unit:.4g}"


def screen(definition: SweepDefinition, cases: Cases | None = None) -> Screening:
    """Ask parameter bounds and the planner's mathematics about every case of a sweep.

    Args:
        definition: the sweep.
        cases: its cases, if they are at hand.

    Returns:
        What ``RunParameters`` and ``plan_gait`` would say of each, without a body.
    """
    cases = cases_of(definition) if cases is None else cases
    total = len(cases)
    sheet = _Sheet(
        np.zeros(total, dtype=np.int8),
        np.full(total, -1, dtype=np.int16),
        *(np.full(total, math.nan) for _ in range(3)),
    )
    planned = 0
    for start in range(0, total, _CHUNK):
        numbers = np.arange(start, min(start + _CHUNK, total), dtype=np.int64)
        planned += _screen_part(cases, numbers, sheet.part(slice(start, start + _CHUNK)))
    return Screening(*sheet, planned)


class _Sheet(NamedTuple):
    """Columns of a :class:`Screening` while they are filled."""

    code: NDArray[np.int8]
    key: NDArray[np.int16]
    asked: Array
    needed: Array
    step_duration: Array

    def part(self, which: slice) -> _Sheet:
        """Views of some cases."""
        return _Sheet(
            self.code[which],
            self.key[which],
            self.asked[which],
            self.needed[which],
            self.step_duration[which],
        )


def _screen_part(cases: Cases, numbers: NDArray[np.int64], sheet: _Sheet) -> int:
    """Fill in some cases; how many were left to ``plan_gait``."""
    _check_bounds(cases, numbers, sheet)
    model = cases.column(MODEL_KEY, numbers)
    planned = 0
    for name in np.unique(model):
        which = np.flatnonzero((model == name) & (sheet.code == CODES[ACCEPTED]))
        chosen = numbers[which]
        gaits = Gaits(*(cases.column(key, chosen) for key in _GAIT_KEYS))
        plain = name == "ipm"
        answer = judge(gaits, plain=plain, steps=cases.definition.steps)
        code, duration = answer.code.copy(), answer.step_duration.copy()
        for i in np.flatnonzero(answer.doubtful):
            code[i], duration[i] = _planned(cases, int(chosen[i]))
            planned += 1
        sheet.code[which], sheet.step_duration[which] = code, duration
        for reason in REASONS:
            some = code == CODES[reason]
            if reason in _RULES and some.any():
                _explain(reason, gaits.of(some), answer.angle[some], sheet, which[some])
    return planned


def _check_bounds(cases: Cases, numbers: NDArray[np.int64], sheet: _Sheet) -> None:
    """Mark cases with a parameter beyond its bounds, by the first key in the order of the file."""
    order = keys()
    for axis in sorted(cases.axes, key=lambda a: order.index(a.key), reverse=True):
        info = key_info(axis.key)
        if info.kind == "text":
            continue
        below, above = info.below(axis.values), info.above(axis.values)
        if not (below | above).any():
            continue
        which = axis.index(numbers)
        bad = (below | above)[which]
        sheet.code[bad] = CODES[BAD_PARAMETER]
        sheet.key[bad] = order.index(axis.key)
        sheet.asked[bad] = axis.values[which[bad]]
        sheet.needed[bad] = np.where(below[which[bad]], *info.ends)


def _planned(cases: Cases, case: int) -> tuple[int, float]:
    """Code and step duration [s] by the planner itself."""
    run = cases.run(case)
    try:
        plan = plan_gait(run.gait, run.body.mass)
    except MathematicalRefusal as refusal:
        return CODES[refusal.reason], math.nan
    except (ArithmeticError, ValueError):  # numbers next to the smallest that there are
        return CODES["ill_conditioned"], math.nan
    return CODES[ACCEPTED], plan.constants.step_duration


def _explain(reason: str, gaits: Gaits, angle: Array, sheet: _Sheet, which: NDArray[np.intp]) -> None:
    """Say which parameter could be changed, and to what."""
    with np.errstate(all="ignore"):
        if reason == "not_the_plain_pendulum":
            for name, fixed in reversed(PLAIN.items()):
                other = getattr(gaits, name) != fixed
                _note(sheet, which[other], f"gait.{name}", getattr(gaits, name)[other], fixed)
        elif reason == "single_support_not_driven":
            _note(sheet, which, "gait.c_s", gaits.c_s, 1.0 / gaits.a_s)
        elif reason == "c_y_not_positive":
            _note(sheet, which, "gait.c_y", gaits.c_y, 0.0)
        elif reason == "single_support_too_long":
            _note(sheet, which, "gait.c_y", gaits.c_y, gaits.c_y * (LARGEST_ANGLE / angle) ** 2)
        else:
            _note(
                sheet, which, "gait.switching_velocity", gaits.switching_velocity, sufficient_velocity(gaits)
            )


def _note(sheet: _Sheet, which: NDArray[np.intp], key: str, asked: Array, needed: Array | float) -> None:
    sheet.key[which] = keys().index(key)
    sheet.asked[which], sheet.needed[which] = asked, needed

"""Rows of the audit: a statement of the paper, the checks it went through, and the verdict that follows.

A verdict is never typed in: it follows from the checks. A check of the printed form that fails makes an
erratum where a corrected form exists, and a contradiction where the statement itself is at fault.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from typing import Any, Literal

import sympy as sp

ROUNDING = 1e-9
"""A number counts as zero below this share of its scale."""


class Verdict(StrEnum):
    """What the audit says of a statement."""

    HOLDS = "holds"
    ERRATUM = "erratum"
    CONTRADICTED = "contradicted by the model"
    UNTESTED = "cannot be tested"


@dataclass(frozen=True)
class Check:
    """One piece of evidence about the printed or the corrected form of a statement.

    Attributes:
        form: which of the two was checked.
        kind: ``symbolic`` (a residual derived with sympy), ``numeric`` (computed on a gait), or ``text`` (two
            places of the paper against each other).
        quantity: what was computed, in words.
        value: number, or symbolic residual as text; None where the words say it.
        unit: SI unit of a number.
        passed: whether the form stands this check.
        gait: gait of a number; empty for symbols.
        rounding: the number stands for zero, but for rounding.
    """

    form: Literal["printed", "corrected"]
    kind: Literal["symbolic", "numeric", "text"]
    quantity: str
    value: float | str | None
    unit: str
    passed: bool
    gait: str = ""
    rounding: bool = False

    def shown(self) -> str:
        """The value for a reader: four digits, ``0`` for what is rounding."""
        if self.value is None:
            return ""
        if isinstance(self.value, str):
            return self.value
        text = "0" if self.rounding else f"{self.value:.4g}"
        return text if self.unit in ("", "1") else f"{text} {self.unit}"


class Evidence:
    """Checks of one statement.

    Args:
        section: of the paper.
        place: of the statement, as in ``statements.toml``.
        checks: at least one.
        why: what a reader must know beside the checks, where it holds computed numbers; else it stands with
            the statement.
    """

    def __init__(self, section: str, place: str, *checks: Check, why: str = "") -> None:
        self.key, self.checks, self.why = (section, place), checks, why


@dataclass(frozen=True)
class Row:
    """One equation or claim of the paper.

    Attributes:
        section: of the paper.
        place: where in it: equation, figure, or the words' subject.
        printed: the statement as printed.
        corrected: the form that holds; empty if it is the printed one, or if there is none.
        checks: evidence; none if the statement cannot be tested.
        errata: numbers of ``docs/errata.md``.
        why: what a reader must know beside the evidence.
        failure: what a failed check of the printed form makes of the statement.
    """

    section: str
    place: str
    printed: str
    corrected: str = ""
    checks: tuple[Check, ...] = ()
    errata: tuple[str, ...] = ()
    why: str = ""
    failure: Verdict = Verdict.ERRATUM

    @property
    def verdict(self) -> Verdict:
        """What follows from the checks of the printed form."""
        if not self.checks:
            return Verdict.UNTESTED
        return Verdict.HOLDS if all(c.passed for c in self.checks if c.form == "printed") else self.failure

    @property
    def consistent(self) -> bool:
        """Whether the corrected form stands its checks, and an erratum has both kinds of checks."""
        forms = {check.form for check in self.checks if check.kind != "text"}
        wrong = self.verdict is Verdict.ERRATUM
        testable = any(c.kind != "text" for c in self.checks)
        return (
            all(check.passed for check in self.checks if check.form == "corrected")
            and bool(self.checks or self.why)
            and (not wrong or bool(self.corrected and self.errata))
            and (not wrong or not testable or forms == {"printed", "corrected"})
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "section": self.section,
            "place": self.place,
            "printed": self.printed,
            "corrected": self.corrected or None,
            "verdict": str(self.verdict),
            "errata": list(self.errata),
            "why": self.why or None,
            "evidence": [
                {
                    "form": check.form,
                    "kind": check.kind,
                    "quantity": check.quantity,
                    "value": check.value,
                    "unit": check.unit or None,
                    "gait": check.gait or None,
                    "passed": check.passed,
                }
                for check in self.checks
            ],
        }


def assemble(evidence: Iterable[Evidence]) -> tuple[Row, ...]:
    """Rows in the order of the paper: every statement with its checks.

    Raises:
        ValueError: checks of a statement that is not listed, or of one statement twice.
    """
    found: dict[tuple[str, str], Evidence] = {}
    for item in evidence:
        if item.key in found:
            raise ValueError(f"two sets of checks for {item.key}")
        found[item.key] = item
    rows = []
    text = resources.files(__package__).joinpath("statements.toml").read_text(encoding="utf-8")
    for statement in tomllib.loads(text)["statement"]:
        checked = found.pop((statement["section"], statement["place"]), None)
        if checked is not None:
            statement |= {"checks": checked.checks} | ({"why": checked.why} if checked.why else {})
        statement["errata"] = tuple(statement.get("errata", ()))
        statement["failure"] = Verdict(statement.get("failure", Verdict.ERRATUM))
        rows.append(Row(**statement))
    if found:
        raise ValueError(f"checks without a statement: {sorted(found)}")
    return tuple(rows)


def symbolic(form: Literal["printed", "corrected"], quantity: str, residual: Any) -> Check:
    """A residual that must vanish for all values of its symbols.

    Args:
        form: what it is the residual of.
        quantity: what it is, in words.
        residual: sympy expression, or several that must all vanish.
    """
    parts = residual if isinstance(residual, Sequence) else (residual,)
    left = [part for part in (sp.simplify(sp.sympify(item)) for item in parts) if part != 0]
    text = "; ".join(_shortest(part) for part in left) or "0"
    return Check(form, "symbolic", quantity, text, "", not left)


def _shortest(expression: sp.Expr) -> str:
    forms = (expression, sp.factor(expression), sp.expand(expression))
    return min((readable(form) for form in forms), key=len)


def zero(
    form: Literal["printed", "corrected"],
    quantity: str,
    value: float,
    unit: str,
    gait: str = "normal",
    *,
    scale: float = 1.0,
    rounding: float = ROUNDING,
) -> Check:
    """A number that must vanish: a jump, or the mismatch of two ways to the same quantity.

    Args:
        form: what the number is about.
        quantity: what it is, in words.
        value: in ``unit``.
        unit: SI unit.
        gait: on which gait it was computed.
        scale: size of the quantities that were subtracted, in ``unit``.
        rounding: share of the scale below which the number is zero.
    """
    passed = math.isfinite(value) and abs(value) <= rounding * scale
    return Check(form, "numeric", quantity, float(value), unit, passed, gait, rounding=passed)


def claim(
    form: Literal["printed", "corrected"],
    quantity: str,
    value: float | str | None,
    unit: str,
    passed: bool,
    gait: str = "normal",
) -> Check:
    """A number that must have some property, which ``quantity`` names."""
    number = float(value) if isinstance(value, int | float) else value
    return Check(form, "numeric", quantity, number, unit, bool(passed), gait)


def property_of(form: Literal["printed", "corrected"], quantity: str, expression: Any, passed: bool) -> Check:
    """A symbolic expression that must have some property, which ``quantity`` names."""
    return Check(form, "symbolic", quantity, readable(expression), "", bool(passed))


def against(quantity: str) -> Check:
    """Two places of the paper that say different things."""
    return Check("printed", "text", quantity, None, "", False)


def readable(expression: Any) -> str:
    """A sympy expression as a reader writes it."""
    return str(expression).replace("**", "^").replace("*", " ")

"""Rows of the audit: a statement of the paper, the checks it went through, and the verdict that follows.

A verdict is never typed in: it follows from the checks. A check of the printed form that fails makes an
erratum where a corrected form exists, and a contradiction where the statement itself is at fault.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from typing import Any, Literal, Self

import sympy as sp

ROUNDING = 1e-9
"""A number counts as zero below this share of its scale."""


Form = Literal["printed", "corrected"]
"""Which form of a statement is checked."""


class Verdict(StrEnum):
    """Verdict of the audit on a statement."""

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
        value: number, or symbolic residual as text; None where the text has it.
        unit: SI unit of a number.
        passed: whether the form stands this check.
        gait: gait of a number; empty for symbols.
        rounding: the number stands for zero, but for rounding.
    """

    form: Form
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
    """Checks of one statement. A method adds one check for each form whose value it is given.

    Args:
        why: what a reader must know beside the checks, where it holds computed numbers; else it stands with
            the statement.
    """

    def __init__(self, why: str = "") -> None:
        self.why = why
        self._checks: list[Check] = []

    @property
    def checks(self) -> tuple[Check, ...]:
        """All checks, those of the printed form first."""
        return tuple(sorted(self._checks, key=lambda check: check.form == "corrected"))

    def symbolic(self, quantity: str, printed: Any = None, corrected: Any = None) -> Self:
        """Add residuals that must vanish for all values of their symbols.

        Args:
            quantity: what they are, in words.
            printed: sympy expression of the printed form, or several that must all vanish.
            corrected: likewise of the corrected form.
        """
        for form, residual in _given(printed, corrected):
            parts = residual if isinstance(residual, Sequence) else (residual,)
            left = [part for part in (sp.simplify(sp.sympify(item)) for item in parts) if part != 0]
            text = "; ".join(_shortest(part) for part in left) or "0"
            self._checks.append(Check(form, "symbolic", quantity, text, "", not left))
        return self

    def zero(
        self, quantity: str, unit: str, printed: float | None = None, corrected: float | None = None, *,
        gait: str = "normal", scale: float = 1.0, rounding: float = ROUNDING,
    ) -> Self:  # fmt: skip
        """Add numbers that must vanish: jumps, or mismatches of two ways to the same quantity.

        Args:
            quantity: what they are, in words.
            unit: SI unit.
            printed: number of the printed form, in ``unit``.
            corrected: likewise of the corrected form.
            gait: on which gait they were computed.
            scale: size of the quantities that were subtracted, in ``unit``.
            rounding: share of the scale below which a number is zero.
        """
        for form, value in _given(printed, corrected):
            passed = math.isfinite(value) and abs(value) <= rounding * scale
            self._checks.append(
                Check(
                    form, "numeric", quantity, float(value), unit, bool(passed), gait, rounding=bool(passed)
                )
            )
        return self

    def sign(
        self, wanted: Literal["positive", "negative"], quantity: str, unit: str,
        printed: float | None = None, corrected: float | None = None, *, gait: str = "normal",
    ) -> Self:  # fmt: skip
        """Add numbers that must have a sign; arguments as of :meth:`zero`."""
        for form, value in _given(printed, corrected):
            passed = value > 0.0 if wanted == "positive" else value < 0.0
            self.claim(form, f"{quantity}, to be {wanted}", passed, value, unit, gait)
        return self

    def claim(
        self, form: Form, quantity: str, passed: bool, value: float | str | None = None, unit: str = "",
        gait: str = "normal",
    ) -> Self:  # fmt: skip
        """Add a value that must have some property, which ``quantity`` names."""
        number = float(value) if isinstance(value, int | float) else value
        self._checks.append(Check(form, "numeric", quantity, number, unit, bool(passed), gait))
        return self

    def expression(self, form: Form, quantity: str, expression: Any, passed: bool) -> Self:
        """Add a symbolic expression that must have some property, which ``quantity`` names."""
        self._checks.append(Check(form, "symbolic", quantity, readable(expression), "", bool(passed)))
        return self

    def against(self, quantity: str) -> Self:
        """Add two places of the paper that disagree."""
        self._checks.append(Check("printed", "text", quantity, None, "", False))
        return self


def _given(printed: Any, corrected: Any) -> list[tuple[Form, Any]]:
    forms: tuple[tuple[Form, Any], ...] = (("printed", printed), ("corrected", corrected))
    return [(form, value) for form, value in forms if value is not None]


class Ledger:
    """Evidence of all statements, by section and place: ``row("2.1", "Eq. 4").symbolic(...)``."""

    def __init__(self) -> None:
        self.evidence: dict[tuple[str, str], Evidence] = {}

    def __call__(self, section: str, place: str, why: str = "") -> Evidence:
        """Begin the checks of a statement.

        Args:
            section: of the paper.
            place: of the statement, as in ``statements.toml``.
            why: as in :class:`Evidence`.

        Raises:
            ValueError: the statement has its checks already.
        """
        if (section, place) in self.evidence:
            raise ValueError(f"two sets of checks for section {section}, {place}")
        return self.evidence.setdefault((section, place), Evidence(why))


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
        """Verdict that follows from the checks of the printed form."""
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


def assemble(ledger: Ledger) -> tuple[Row, ...]:
    """Rows in the order of the paper: every statement with its checks.

    Raises:
        ValueError: checks of a statement that is not listed.
    """
    found = dict(ledger.evidence)
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


def _shortest(expression: sp.Expr) -> str:
    forms = (expression, sp.factor(expression), sp.expand(expression))
    return min((readable(form) for form in forms), key=len)


def readable(expression: Any) -> str:
    """A sympy expression as a reader writes it."""
    return str(expression).replace("**", "^").replace("*", " ")

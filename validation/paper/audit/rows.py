"""Rows of the audit: a statement of the paper, its checks, and the verdict that follows from them.

A check of the printed form that fails makes an erratum where a corrected form exists, and a contradiction
where the statement itself is at fault.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from importlib import resources
from typing import Any, Literal, Self

import sympy as sp

ROUNDING = 1e-9
"""A number below this counts as zero [SI]."""


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
        unit: SI unit of a number; None if it has none.
        gait: gait of a number; None for symbols.
        passed: whether the form passes this check.
        shown: the value as text: four digits, ``0`` for rounding errors.
    """

    form: Form
    kind: Literal["symbolic", "numeric", "text"]
    quantity: str
    value: float | str | None
    unit: str | None
    gait: str | None
    passed: bool
    shown: str


@dataclass
class Row:
    """One equation or claim of the paper. A method adds one check for each form whose value it is given.

    Attributes:
        section: of the paper.
        place: where in it: equation, figure, or subject.
        printed: the statement as printed.
        corrected: the form that holds; empty if it is the printed one, or if there is none.
        errata: numbers of ``docs/errata.md``.
        why: explanation beside the evidence.
        failure: verdict if a check of the printed form fails.
        checks: evidence, that of the printed form first; none if the statement cannot be tested.
    """

    section: str
    place: str
    printed: str
    corrected: str = ""
    errata: Sequence[str] = ()
    why: str = ""
    failure: Verdict = Verdict.ERRATUM
    checks: list[Check] = field(default_factory=list)

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
            self._add(form, "symbolic", quantity, text, not left)
        return self

    def zero(
        self, quantity: str, unit: str, printed: float | None = None, corrected: float | None = None, *,
        gait: str = "normal", within: float = ROUNDING,
    ) -> Self:  # fmt: skip
        """Add numbers that must vanish: jumps, or mismatches of two ways to the same quantity.

        Args:
            quantity: what they are, in words.
            unit: SI unit.
            printed: number of the printed form, in ``unit``.
            corrected: likewise of the corrected form.
            gait: on which gait they were computed.
            within: largest magnitude that counts as zero, in ``unit``.
        """
        for form, value in _given(printed, corrected):
            passed = abs(value) <= within
            self._add(form, "numeric", quantity, float(value), passed, unit, gait, "0" if passed else None)
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
        self, form: Form, quantity: str, passed: bool, value: Any = None, unit: str = "", gait: str = "normal"
    ) -> Self:
        """Add a value that must have some property, which ``quantity`` names: number, text, or formula."""
        if isinstance(value, sp.Basic):
            return self._add(form, "symbolic", quantity, readable(value), passed)
        number = float(value) if isinstance(value, int | float) else value
        return self._add(form, "numeric", quantity, number, passed, unit, gait)

    def against(self, quantity: str) -> Self:
        """Add two places of the paper that disagree."""
        return self._add("printed", "text", quantity, None, False)

    def _add(
        self, form: Form, kind: Literal["symbolic", "numeric", "text"], quantity: str,
        value: float | str | None, passed: bool, unit: str = "", gait: str = "", digits: str | None = None,
    ) -> Self:  # fmt: skip
        shown = value or "" if not isinstance(value, float) else digits or f"{value:.4g}"
        if isinstance(value, float) and unit not in ("", "1"):
            shown = f"{shown} {unit}"
        check = Check(form, kind, quantity, value, unit or None, gait or None, bool(passed), shown)
        self.checks.append(check)
        self.checks.sort(key=lambda item: item.form == "corrected")
        return self

    def of(self, form: Form) -> list[Check]:
        """Checks of one form."""
        return [check for check in self.checks if check.form == form]

    @property
    def verdict(self) -> Verdict:
        """Verdict that follows from the checks of the printed form."""
        if not self.checks:
            return Verdict.UNTESTED
        return Verdict.HOLDS if all(check.passed for check in self.of("printed")) else self.failure

    @property
    def consistent(self) -> bool:
        """Whether the corrected form passes its checks, and an erratum has both kinds of checks."""
        if not all(check.passed for check in self.of("corrected")):
            return False
        if self.verdict is not Verdict.ERRATUM:
            return bool(self.checks or self.why)
        forms = {check.form for check in self.checks if check.kind != "text"}
        return bool(self.corrected and self.errata) and forms in (set(), {"printed", "corrected"})

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        evidence = [asdict(check) for check in self.checks]
        for item in evidence:
            del item["shown"]
        return {
            "section": self.section,
            "place": self.place,
            "printed": self.printed,
            "corrected": self.corrected or None,
            "verdict": str(self.verdict),
            "errata": list(self.errata),
            "why": self.why or None,
            "evidence": evidence,
        }


Rows = Mapping[str, Row]
"""Statements of a section by place: ``rows["Eq. 4"].symbolic(...)``."""


def statements() -> list[Row]:
    """All statements in the order of the paper, without checks."""
    text = resources.files(__package__).joinpath("statements.toml").read_text(encoding="utf-8")
    rows = [Row(**statement) for statement in tomllib.loads(text)["statement"]]
    for row in rows:
        row.failure = Verdict(row.failure)
    return rows


def _given(printed: Any, corrected: Any) -> list[tuple[Form, Any]]:
    forms: tuple[tuple[Form, Any], ...] = (("printed", printed), ("corrected", corrected))
    return [(form, value) for form, value in forms if value is not None]


def _shortest(expression: sp.Expr) -> str:
    forms = (expression, sp.factor(expression), sp.expand(expression))
    return min((readable(form) for form in forms), key=len)


def readable(expression: Any) -> str:
    """A sympy expression as plain text."""
    return str(expression).replace("**", "^").replace("*", " ")

"""The paper, statement by statement, against first principles and against the project's own numbers.

Every displayed equation and every claim of

    S. Kudoh and T. Komura, "C2 Continuous Gait-Pattern Generation for Biped Robots", IROS 2003

is one :class:`~validation.paper.audit.rows.Row`. ``statements.toml`` holds the statements, one module per
section the checks: formulas against mechanics derived with sympy, claims against numbers computed on the
``normal`` gait.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ampm.exceptions import InputError
from validation.progress import Progress

if TYPE_CHECKING:
    from validation.paper.audit.rows import Row


def audit(stages: Progress | None = None) -> tuple[Row, ...]:
    """Check the whole paper.

    Args:
        stages: where to report progress.

    Returns:
        Rows in the order of the paper.

    Raises:
        InputError: sympy is not installed.
    """
    try:
        import sympy  # noqa: F401  # an optional package
    except ImportError:
        raise InputError(
            "the audit derives the paper's formulas with sympy, which is not installed; install it with "
            "'.venv/bin/python -m pip install sympy' and run the audit again."
        ) from None
    # Imported here: SymPy is slow to load.
    from validation.paper.audit import (
        section_1,
        section_2,
        section_2_1,
        section_2_2,
        section_2_3,
        section_3,
        section_4,
    )
    from validation.paper.audit.case import Case
    from validation.paper.audit.rows import statements

    stages = stages or Progress()
    case, rows = Case(), statements()
    for module, sections in (
        (section_1, ("abstract", "1", "1.1", "1.2")),
        (section_2, ("2",)),
        (section_2_1, ("2.1",)),
        (section_2_2, ("2.2",)),
        (section_2_3, ("2.3",)),
        (section_3, ("3",)),
        (section_4, ("4",)),
    ):
        with stages.stage(f"section {sections[-1]}"):
            module.check(case, {row.place: row for row in rows if row.section in sections})
    return tuple(rows)

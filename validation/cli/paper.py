"""``ampm audit`` and ``ampm figures``: the paper's claims and figures.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import Force, Json, Status, answer, option
from validation.show.text import print_line

app = typer.Typer()


@app.command()
def audit(as_json: Json = False) -> int:
    """Check every equation and claim of the paper, and report where it is wrong and by how much.

    The status is 0 if every corrected form passes its checks.
    """
    from validation.paper.audit import audit as audit_paper

    narrator = Narrator()
    rows = audit_paper(narrator)
    from validation.paper.audit.table import describe, print_rows  # after the check for sympy

    answer(rows, describe, print_rows, as_json=as_json)
    failed = [row for row in rows if not row.consistent]
    for row in failed:
        narrator.say(f"section {row.section}, {row.place}: the corrected form fails its checks")
    return Status.OUT_OF_TOLERANCE if failed else Status.PASS


@app.command()
def figures(
    out: Annotated[Path, option("--out", "Folder to write SVG and PNG into.", "DIR")],
    steps: Annotated[int, option("--steps", "Steps walked for a figure.", "N")] = 12,
    only: Annotated[str | None, option("--only", "Of 4, 5, 7, 8, 9, 10, 11, 12, human.", "8,9")] = None,
    force: Force = False,
) -> int:
    """Draw the paper's figures from data: plan, inverse kinematics and simulation on the same axes."""
    from validation.paper.figures import make_figures

    for path in make_figures(out, only, steps, force=force, stages=Narrator()):
        print_line(str(path))
    return Status.PASS

"""``ampm audit`` and ``ampm figures``: the paper's claims and figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator, print_json
from validation.cli.options import Force, Json, Status
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

    if as_json:
        print_json(describe(rows))
    else:
        print_rows(rows)
    failed = [row for row in rows if not row.consistent]
    for row in failed:
        narrator.say(f"section {row.section}, {row.place}: the corrected form fails its checks")
    return Status.OUT_OF_TOLERANCE if failed else Status.PASS


@app.command()
def figures(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write SVG and PNG into.")],
    steps: Annotated[int, typer.Option("--steps", metavar="N", help="Steps walked for a figure.")] = 12,
    only: Annotated[
        str | None, typer.Option("--only", metavar="8,9", help="Of 4, 5, 7, 8, 9, 10, 11, 12, human.")
    ] = None,
    force: Force = False,
) -> int:
    """Draw the paper's figures from data: plan, inverse kinematics and simulation on the same axes."""
    from validation.paper.figures import make_figures

    for path in make_figures(out, only, steps, force=force, stages=Narrator()):
        print_line(str(path))
    return Status.PASS

"""``ampm convergence``: how far the metrics depend on grids and tolerances."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from validation.cli.console import Narrator
from validation.cli.options import Force, Gait, Json, Settings, Status, Workers, answer
from validation.show.text import print_line, print_table

if TYPE_CHECKING:
    from validation.study.convergence.result import Convergence

app = typer.Typer()

_EPILOG = (
    "Exit status: 0 every metric is within its limit by more than its numerical uncertainty, 1 one is over "
    "it, undecided or not measured, 2 bad input or refused, 3 a walk of a numerical study did not complete, "
    "4 crash of ampm itself, 130 interrupted."
)


@app.command(epilog=_EPILOG)
def convergence(
    gait: Gait = "normal",
    settings: Settings = None,
    steps: Annotated[
        int, typer.Option("--steps", metavar="N", help="Walked at every level: the gait is periodic.")
    ] = 6,
    levels: Annotated[
        int,
        typer.Option(
            "--levels", metavar="N", help="Of every numerical study, 3 ... 6; 4 can confirm an order."
        ),
    ] = 4,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--study",
            metavar="NAME",
            help="time_step, ik_grid, qp_tolerance, contact_stiffness or contact_depth; repeatable, all by "
            "default.",
        ),
    ] = None,
    profile: Annotated[
        str, typer.Option("--profile", metavar="P", help="Tolerance profile: default, strict, or wide.")
    ] = "default",
    workers: Workers = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write convergence.json, a table and a picture."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Measure how far a gait's metrics depend on time step, grids, tolerances and contact parameters.

    The time step is halved again and again, at the same control frequency; so is the grid of the inverse
    kinematics; the QP's tolerance is tightened; contact stiffness is varied. Every metric gets its observed
    order, extrapolated value and numerical uncertainty, or "no asymptotic range"; 'ampm validate
    --uncertainty' quotes the uncertainty in its verdict.
    """
    from validation.study.convergence.run import FILES, study_gait, write

    progress = Narrator()
    result = study_gait(
        gait,
        settings or (),
        steps=steps,
        levels=levels,
        only=only or (),
        profile=profile,
        workers=workers,
        out=out,
        force=force,
        progress=progress,
    )
    answer(result, type(result).as_dict, print_convergence, as_json=as_json)
    if out is not None:
        write(result, out)
        progress.wrote(*(out / name for name in FILES))
    if not result.completed:
        return Status.NOT_COMPLETED
    return Status.PASS if result.verdict.passed else Status.OUT_OF_TOLERANCE


_COLOURS = {"pass": "green", "FAIL": "red", "fail": "red", "": "default"}


def print_convergence(result: Convergence) -> None:
    """Print what the studies found: metrics with their uncertainty, and the verdict on them."""
    from validation.study.convergence.text import cells, header, legend, shortlist

    name, verdict = result.request.name, result.verdict
    left = ("metric", "unit", "verdict", "observed order")
    rows = []
    for item in shortlist(result):
        row = list(cells(item))
        row[4] = f"[{_COLOURS.get(row[4], 'yellow')}]{row[4]}[/]"
        rows.append(row)
    print_table(
        f"{name}: value ± numerical uncertainty, {result.request.run.gait.steps} steps "
        f"(profile {verdict.profile})",
        [(text, "left" if text in left else "right") for text in header(result)],
        rows,
    )
    print_line(f"  {legend(result)}")
    for note in result.notes:
        print_line(f"  note: {escape(note)}")
    colour = _COLOURS.get(verdict.name, "yellow")
    word = verdict.name.replace("_", " ").upper()
    print_line(f"[bold {colour}]{name}: {word}[/]  {escape(verdict.reason)}")

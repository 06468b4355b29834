"""``ampm convergence``: how far the metrics depend on grids and tolerances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import Force, Gait, Json, Settings, Status, Workers, answer

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
    from validation.study.convergence import command
    from validation.study.convergence.table import print_convergence

    options = command.Options(
        steps=steps, levels=levels, only=only or (), profile=profile, workers=workers, out=out, force=force
    )
    narrator = Narrator()
    result = command.run(gait, settings or (), options, stages=narrator)
    answer(result, command.Convergence.as_dict, print_convergence, as_json=as_json)
    narrator.wrote(*(out / name for name in command.FILES) if out is not None else ())
    if not result.completed:
        return Status.NOT_COMPLETED
    return Status.PASS if result.verdict == "pass" else Status.OUT_OF_TOLERANCE

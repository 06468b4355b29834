"""``ampm convergence``: how far the metrics depend on grids and tolerances.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import Force, Gait, Json, Settings, Status, Workers, answer, option
from validation.show.text import judged, print_line, print_table, print_verdict

if TYPE_CHECKING:
    from validation.study.convergence.result import Convergence

app = typer.Typer()

_EPILOG = (
    "Exit status: 0 every metric is within its limit by more than its numerical uncertainty, 1 one is over "
    "it, undecided or not measured, 2 bad input or refused, 3 a walk of a numerical study did not complete, "
    "4 crash of ampm itself, 130 interrupted."
)
_STUDIES = "time_step, ik_grid, qp_tolerance, contact_stiffness or contact_depth"


@app.command(epilog=_EPILOG)
def convergence(
    gait: Gait = "normal",
    settings: Settings = None,
    steps: Annotated[int, option("--steps", "Walked at every level: the gait is periodic.", "N")] = 6,
    levels: Annotated[
        int, option("--levels", "Of every numerical study, 3 ... 6; 4 can confirm an order.", "N")
    ] = 4,
    only: Annotated[
        list[str] | None, option("--study", f"{_STUDIES}; repeatable, all by default.", "NAME")
    ] = None,
    profile: Annotated[
        str, option("--profile", "Tolerance profile: default, strict, or wide.", "P")
    ] = "default",
    workers: Workers = None,
    out: Annotated[
        Path | None, option("--out", "Write convergence.json, a table and a picture.", "DIR")
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
        gait, settings or (), steps=steps, levels=levels, only=only or (), profile=profile, workers=workers,
        out=out, force=force, progress=progress,
    )  # fmt: skip
    answer(result, type(result).as_dict, print_convergence, as_json=as_json)
    if out is not None:
        write(result, out)
        progress.wrote(*(out / name for name in FILES))
    if not result.completed:
        return Status.NOT_COMPLETED
    return Status.PASS if result.verdict.passed else Status.OUT_OF_TOLERANCE


def print_convergence(result: Convergence) -> None:
    """Print what the studies found: metrics with their uncertainty, and the verdict on them."""
    from validation.study.convergence.text import cells, header, legend, shortlist

    left = ("metric", "unit", "verdict", "observed order")
    print_table(
        f"{result.request.name}: value ± numerical uncertainty, {result.request.run.gait.steps} steps "
        f"(profile {result.verdict.profile})",
        [text if text in left else f">{text}" for text in header(result)],
        [(*row[:4], judged(row[4]), *row[5:]) for row in map(cells, shortlist(result))],
    )
    print_line(f"  {legend(result)}")
    for note in result.notes:
        print_line(f"  note: {note}")
    print_verdict(result.request.name, result.verdict.name, result.verdict.reason)

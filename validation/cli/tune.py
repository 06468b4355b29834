"""``ampm tune``: the values that a gait leaves open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import Force, Gait, Json, Settings, Status, answer

app = typer.Typer()


@app.command()
def tune(
    gait: Gait = "normal",
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE.toml", help="Write the complete run, for 'ampm validate'."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Find what a gait leaves open: share of single support, roll, heights, foot timing and angles, lean.

    What the preset, the file or --set names stays as it is. An optimiser works on plan and whole-body motion
    alone; nothing is simulated. Where no choice walks, the refusal names the limit and the best it found.
    """
    from validation.cli import tune_text as output
    from validation.store.folders import check_output_file
    from validation.trial.plan import load_request
    from validation.trial.tune import tune_walk

    if out is not None:
        output.check_toml(out)
        check_output_file(out, force=force)
    narrator = Narrator()
    walk = tune_walk(load_request(gait, settings or ()), narrator)
    if out is not None:
        output.write_tuned(walk, out, force=force)
    answer(walk, output.describe_tuned, output.print_tuned, as_json=as_json)
    narrator.wrote(out)
    return Status.PASS

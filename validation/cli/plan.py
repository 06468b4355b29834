"""``ampm plan``, ``ampm motion`` and ``ampm keys``: what is known before anything walks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ampm.run_file import PRESETS
from validation.cli.console import Narrator, print_json
from validation.cli.options import Force, Gait, Gaits, Json, Settings, Status, answer

app = typer.Typer()

_PRESET_LINES = "\n\n".join(f"{name}: {meaning}" for name, meaning in PRESETS.items())


@app.command(epilog=f"Presets.\n\n{_PRESET_LINES}")
def plan(
    gait: Gait = "normal",
    settings: Settings = None,
    no_body: Annotated[
        bool, typer.Option("--no-body", help="Pure mathematics: no soles, no joints, mean L_y zero.")
    ] = False,
    as_json: Json = False,
    samples: Annotated[
        Path | None,
        typer.Option("--samples", metavar="FILE.csv|.parquet", help="Write the plan's signals at k / rate."),
    ] = None,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Samples per second.")] = 200.0,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw the plan.")] = None,
) -> int:
    """Plan a gait in closed form: constants, residuals, samples, a picture.

    With a body (the default) the plan is checked against its soles, legs and joints, and the constant of L_y
    is the one that makes the body's motion periodic.
    """
    from ampm.planner.periodic import plan_gait
    from validation.cli import plan_text as output
    from validation.store.folders import check_folder_of
    from validation.trial.plan import load_request, plan_walk

    request = load_request(gait, settings or ())
    for path in (samples, plot):
        if path is not None:
            check_folder_of(path)
    if samples is not None:
        output.check_samples(samples, request.run, rate)
    if plot is not None:
        output.check_picture(plot)
    narrator = Narrator()
    walk = None if no_body else plan_walk(request, narrator)
    run = request.run
    planned = plan_gait(run.gait, run.body.mass) if walk is None else walk.plan
    if samples is not None:
        output.write_samples(planned, samples, rate)
    if plot is not None:
        output.write_picture(request.name, planned, plot, settings or ())
    if as_json:
        print_json(output.describe(request, planned, walk))
    else:
        output.print_plan(request, planned, walk)
    narrator.wrote(samples, plot)
    return Status.PASS


@app.command()
def motion(
    gaits: Gaits = None,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE.parquet|.csv", help="Write one step's joints, all gaits in one."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Solve the periodic whole-body motion of one step: what every joint does."""
    from validation.cli import plan_text as output
    from validation.store.folders import check_output_file
    from validation.trial.plan import load_requests, plan_walk

    if out is not None:
        check_output_file(out, force=force)
    requests = load_requests(gaits or ["normal"], settings or ())
    narrator = Narrator()
    walks = [plan_walk(request, narrator) for request in requests]
    if out is not None:
        output.write_motions(walks, out, force=force)
    answer(walks, output.describe_motions, output.print_motions, as_json=as_json)
    narrator.wrote(out)
    return Status.PASS


@app.command()
def keys(
    gait: Gait = "normal",
    settings: Settings = None,
    as_json: Json = False,
) -> int:
    """List every parameter: its value in a gait, unit, bounds and meaning.

    Any of them can be given as --set KEY=VALUE, in a gait's TOML file, and varied by a sweep.
    """
    from validation.cli import plan_text as output
    from validation.trial.plan import load_request

    answer(load_request(gait, settings or ()), output.describe_keys, output.print_keys, as_json=as_json)
    return Status.PASS

"""``ampm robustness`` and ``explain``: what a gait survives, and why a trial fails.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import (
    Body,
    Controller,
    Engine,
    Gait,
    Json,
    OwnProfile,
    PlannerName,
    Resume,
    Scheduler,
    Settings,
    Status,
    Steps,
    Workers,
    answer,
    option,
    with_short,
)
from validation.show.text import print_line
from validation.table import print_tables

app = typer.Typer()

EPILOG = (
    "Exit status: 0 the study is done, 2 bad input or refused, 4 an error ended a walk, "
    "5 stopped from outside: --resume goes on, 130 interrupted: --resume goes on."
)


@app.command(epilog=EPILOG)
def robustness(
    gait: Gait = None,
    settings: Settings = None,
    body: Body = None,
    controller: Controller = None,
    engine: Engine = None,
    quick: Annotated[
        bool, option("--quick", "Fewer pushes, and every grid coarser: a quarter of an hour on two cores.")
    ] = False,
    only: Annotated[
        list[str] | None,
        option("--only", "Kind: pushes, or a key of disturbance or sensors. Repeatable.", "KIND"),
    ] = None,
    replicas: Annotated[
        int, option("--replicas", "Walks of every value, of which four fifths have to survive.", "N")
    ] = 5,
    profile: OwnProfile = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None, option("--out", "Write robustness.json, a table and every walk.", "DIR")
    ] = None,
    resume: Resume = False,
    as_json: Json = False,
) -> int:
    """Find the pushes and disturbances that a gait survives.

    Body and controller are those of the run. Pushes of 0.1 s by direction, phase and height, and rising
    values of the keys of disturbance and sensors. A value counts if it and
    all smaller ones are survived.
    """
    from validation.study.robustness.result import Robustness
    from validation.study.robustness.study import robustness as study

    found = study(
        gait,
        with_short(settings, body=body, controller=controller, engine=engine),
        quick=quick,
        only=only or (),
        replicas=replicas,
        profile=profile,
        workers=workers,
        scheduler=scheduler,
        out=out,
        resume=resume,
        progress=Narrator(),
    )
    answer(found, Robustness.as_dict, lambda found: print_tables(found.tables()), as_json=as_json)
    Narrator().wrote(out)
    return Status.CRASH if found.crashes else Status.PASS


@app.command(
    epilog="Exit status: 0 explained, 2 bad input or refused, 5 stopped from outside, 130 interrupted."
)
def explain(
    run: Annotated[
        str | None, typer.Argument(help="Gait, or the folder of a run.", metavar="GAIT|RUN")
    ] = None,
    settings: Settings = None,
    steps: Steps = None,
    body: Body = None,
    controller: Controller = None,
    planner: PlannerName = None,
    engine: Engine = None,
    workers: Workers = None,
    out: Annotated[Path | None, option("--out", "Write explain.json and every walk.", "DIR")] = None,
    as_json: Json = False,
) -> int:
    """Say which part of a trial makes it fail.

    The trial is walked again with one layer made ideal at a time: sensing, motors, body, friction, floor,
    contact law, numerics, controller, planner, pushes. What is ideal already is not walked. If no single
    layer restores the pass, pairs of the best three are. The folder of a run gets explain.json, which 'ampm
    report' shows.
    """
    from validation.study.explain import Explanation
    from validation.study.explain import explain as study

    found = study(
        run,
        with_short(settings, steps=steps, body=body, controller=controller, planner=planner, engine=engine),
        workers=workers,
        out=out,
        progress=Narrator(),
    )
    answer(found, Explanation.as_dict, lambda found: print_tables(found.tables()), as_json=as_json)
    if not as_json:
        print_line(found.sentence)
    return Status.PASS

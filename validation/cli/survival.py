"""``ampm robustness``, ``tour`` and ``explain``: what a gait survives, and why a trial fails.

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


@app.command(epilog=EPILOG)
def tour(
    gait: Gait = None,
    settings: Settings = None,
    body: Body = None,
    controller: Controller = None,
    engine: Engine = None,
    punches: Annotated[
        float, option("--punches", "Share of the protocol's force: 0 for none, 1 for up to 500 N.", "SHARE")
    ] = 1.0,
    seeds: Annotated[int, option("--seeds", "Tours, of the seeds 0, 1, ...", "N")] = 100,
    targets: Annotated[int, option("--targets", "Targets of a tour.", "N")] = 18,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, option("--out", "Write tour.json and every tour.", "DIR")] = None,
    resume: Resume = False,
    as_json: Json = False,
) -> int:
    """Walk tours over random targets under random punches.

    This is the public protocol for the Unitree G1. Both feet stand at one target after the other: each
    uniform in a disc of 1 m about the one before, with a random heading. In every 5 s a random segment is hit
    for 0.08 s in a random direction.
    """
    from validation.study.tour import Tours
    from validation.study.tour import tour as study

    found = study(
        gait,
        with_short(settings, body=body, controller=controller, engine=engine),
        share=punches,
        seeds=seeds,
        count=targets,
        workers=workers,
        scheduler=scheduler,
        out=out,
        resume=resume,
        progress=Narrator(),
    )
    answer(found, Tours.as_dict, lambda found: print_tables([found.table()]), as_json=as_json)
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
    body: Body = None,
    controller: Controller = None,
    planner: PlannerName = None,
    workers: Workers = None,
    out: Annotated[Path | None, option("--out", "Write explain.json and every walk.", "DIR")] = None,
    as_json: Json = False,
) -> int:
    """Say which part of a trial makes it fail, or costs most of its margin.

    The trial is walked again with one layer made ideal at a time: sensing, motors, body, friction, floor,
    contact law, numerics, controller, planner, pushes. What is ideal already is not walked. If no single
    layer restores the pass, pairs of the best three are. The folder of a run gets explain.json, which 'ampm
    report' shows.
    """
    from validation.study.explain import Explanation
    from validation.study.explain import explain as study

    found = study(
        run,
        with_short(settings, body=body, controller=controller, planner=planner),
        workers=workers,
        out=out,
        progress=Narrator(),
    )
    answer(found, Explanation.as_dict, lambda found: print_tables(found.tables()), as_json=as_json)
    if not as_json:
        print_line(found.sentence)
    return Status.PASS

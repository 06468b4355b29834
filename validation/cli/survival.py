"""``ampm robustness`` and ``explain``: what a gait survives, and why a trial fails.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import (
    Disturbing,
    Execution,
    Gait,
    Json,
    OwnProfile,
    Status,
    Steps,
    WalkOptions,
    answer,
    grouped,
    option,
)
from validation.show.text import print_line
from validation.table import print_tables

app = typer.Typer()

EPILOG = (
    "Exit status: 0 the study is done, 2 bad input or refused, 4 an error ended a walk, "
    "5 stopped from outside: --resume goes on, 130 interrupted: --resume goes on."
)


@app.command(epilog=EPILOG)
@grouped
def robustness(
    gait: Gait = None,
    *,
    walk: WalkOptions,
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
    execution: Execution,
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
        walk.request(gait),
        quick=quick,
        only=only or (),
        replicas=replicas,
        profile=profile,
        **vars(execution),
        progress=Narrator(),
    )
    answer(found, Robustness.as_dict, lambda found: print_tables(found.tables()), as_json=as_json)
    Narrator().wrote(execution.out)
    return Status.CRASH if found.crashes else Status.PASS


@app.command(
    epilog="Exit status: 0 explained, 2 bad input or refused, 5 stopped from outside, 130 interrupted."
)
@grouped
def explain(
    run: Annotated[
        str | None, typer.Argument(help="Gait, or the folder of a run.", metavar="GAIT|RUN")
    ] = None,
    *,
    walk: WalkOptions,
    steps: Steps = None,
    disturbing: Disturbing,
    execution: Execution,
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

    is_folder = run is not None and Path(run).is_dir()
    found = study(
        run if is_folder else walk.request(run, steps),
        walk.changes(steps) if is_folder else (),
        disturbances=disturbing.load(),
        **vars(execution),
        progress=Narrator(),
    )
    answer(found, Explanation.as_dict, lambda found: print_tables(found.tables()), as_json=as_json)
    if not as_json:
        print_line(found.sentence)
    return Status.PASS

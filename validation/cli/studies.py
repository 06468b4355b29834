"""``ampm sweep``, ``people``, ``convergence``: several walks.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator, print_json
from validation.cli.options import (
    PROFILES,
    AsIs,
    Body,
    Force,
    Gait,
    Json,
    Resume,
    Scheduler,
    Settings,
    Status,
    Workers,
    answer,
    check_picture,
    option,
    with_short,
)
from validation.show.text import print_line
from validation.store.folders import output_file
from validation.table import Table, print_tables

if TYPE_CHECKING:
    from validation.study.people.compare import People
    from validation.study.sweep.table import SweepTable

app = typer.Typer()

SWEEP_EPILOG = (
    "Exit status: 0 every run that walked passed, 1 some are out of tolerance, 2 bad input, or every run was "
    "refused, 3 some did not complete, 4 some crashed, 5 stopped from outside (full disk, lost scheduler, a "
    "worker that cannot load a class of yours): --resume goes on, 130 interrupted: --resume goes on. "
    "--dry-run: 0, or 2 if it is sure that every run is refused."
)
CONVERGENCE_EPILOG = (
    "Exit status: 0 every metric is within its limit by more than its numerical uncertainty, 1 one is over "
    "it, undecided or not measured, 2 bad input or refused, 3 a walk of a numerical study did not complete, "
    "4 crash of ampm itself, 5 stopped from outside, 130 interrupted: --resume goes on."
)
_STUDIES = "time_step, ik_grid, qp_tolerance, contact_stiffness or contact_depth"


@app.command(epilog=SWEEP_EPILOG)
def sweep(
    file: Annotated[Path, typer.Argument(help="Definition of the sweep (TOML).", metavar="FILE")],
    out: Annotated[
        Path | None, option("--out", "Folder of the sweep; only --dry-run needs none.", "DIR")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    dry_run: Annotated[
        bool, option("--dry-run", "Count runs and refusals by formula; walk one run to measure its time.")
    ] = False,
    as_json: Json = False,
) -> int:
    """Walk many runs over any parameters, on all cores.

    FILE defines the runs: grids, lists, Latin hypercubes or Sobol points over any parameter. Runs walk on
    this machine or a cluster; every finished one is on the disk at once. After a kill, a full disk or Ctrl-C,
    --resume walks exactly what is missing, and the table is the same to the bit.
    """
    from validation.study.sweep.run import forecast  # loads simulator and measurement
    from validation.study.sweep.run import sweep as walk_sweep

    if dry_run:
        from validation.study.sweep.design import load_sweep

        expected = forecast(load_sweep(file), workers, progress=Narrator())
        if as_json:
            print_json(expected.as_dict())
        else:
            print_tables([expected.table()])
        return Status.REFUSED if expected.all_refused else Status.PASS
    if out is None:
        raise InputError("a sweep needs a folder; give --out DIR, or --dry-run to walk nothing.")
    try:
        found = walk_sweep(
            file, out, workers=workers, scheduler=scheduler, resume=resume, progress=Narrator()
        )
    except KeyboardInterrupt as error:
        again = shlex.join(["ampm", "sweep", str(file), "--out", str(out), "--resume"])
        error.add_note(f"every finished row is kept; go on with the same options and --resume: {again}")
        raise
    if as_json:
        print_json({**found.summary(), "directory": str(out)})
    else:
        print_tables([found.result()])
        print_line(str(out))
    return _sweep_status(found)


def _sweep_status(found: SweepTable) -> int:
    """Exit status of a sweep: the worst of its runs."""
    from validation.study.sweep.table import State

    ended = {state for state, count in found.counts.items() if count}
    if State.CRASHED in ended:
        return Status.CRASH
    if ended - {State.PASS, State.OUT_OF_TOLERANCE, State.NOT_MEASURED, State.REFUSED}:
        return Status.NOT_COMPLETED
    if ended == {State.REFUSED}:
        return Status.REFUSED
    return Status.PASS if ended <= {State.PASS, State.REFUSED} else Status.OUT_OF_TOLERANCE


@app.command()
def people(
    file: Annotated[
        Path,
        typer.Argument(
            help="Recording of a person: force, centre of pressure, COM.", metavar="FILE.csv|.parquet|.json"
        ),
    ],
    beside: Annotated[Path | None, option("--beside", "Run to compare it with.", "DIR")] = None,
    profile: Annotated[str, option("--profile", f"Tolerances to show: {PROFILES}.", "P")] = "default",
    plot: Annotated[Path | None, option("--plot", "Draw the mean strides.", "FILE.png")] = None,
    write: Annotated[
        Path | None,
        option("--write", "Write the recording as a table of our columns, and stop.", "FILE.csv|.parquet"),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Compare a recorded person with plan and simulation.

    The mean strides of all three are compared in the signals that metrics judge: net force, force on the left
    foot, ZMP, COM, angular momentum. FILE has a row for every instant, in SI units: time, left_force_x ...
    right_force_z (or force_x ...), left_cop_x ... (or cop_x, cop_y), com_x ..., belt_speed. A .json file is
    one of the benchmark of predictive simulations. Limits are shown, not judged: the exit status is 0.
    """
    from validation.judge.profiles import profile as find_profile
    from validation.study.people.compare import People, convert
    from validation.study.people.compare import people as compare_people
    from validation.trial.columns import check_suffix

    if plot is not None:
        check_picture(plot)
    if write is not None:
        check_suffix(write)
        with output_file(write, force=force) as work:
            convert(file, work)
        Narrator().wrote(write)
        return Status.PASS
    with Narrator().stage("comparison"):
        found = compare_people(file, beside, profile=find_profile(profile))
    if plot is not None:
        from validation.study.people.report import draw  # loads matplotlib

        draw(found, plot)
    answer(found, People.as_dict, print_people, as_json=as_json)
    Narrator().wrote(plot)
    return Status.PASS


def print_people(found: People) -> None:
    """Print facts, differences and notes for a reader."""
    from validation.study.people.compare import PAIRS
    from validation.study.people.report import difference_rows, fact_rows  # loads matplotlib

    columns = ("", *(f">{who}" for who in found.strides), "unit")
    tables = [Table(found.name, columns, fact_rows(found), found.notes)]
    if found.differences:
        words = "simulation - plan", "person - plan", "largest", "person - simulation", "largest", "limit"
        columns = ("mean stride", ">person's SD", *(f">{word}" for word in words))
        title = f"difference, RMS and largest at a share of the stride; limits of {found.profile}"
        notes = []
        for of, against in PAIRS:
            kept, known = found.kept(of, against)
            notes.append(f"{of} less {against}: {kept} of {known} signals within their limits")
        tables.append(Table(title, columns, difference_rows(found), notes))
    print_tables(tables)


@app.command(epilog=CONVERGENCE_EPILOG)
def convergence(
    gait: Gait = None,
    settings: Settings = None,
    as_is: AsIs = False,
    body: Body = None,
    steps: Annotated[int, option("--steps", "Walked at every level: the gait is periodic.", "N")] = 6,
    levels: Annotated[
        int, option("--levels", "Of every numerical study, 3 ... 6; 4 can confirm an order.", "N")
    ] = 4,
    only: Annotated[
        list[str] | None, option("--study", f"{_STUDIES}; repeatable, all by default.", "NAME")
    ] = None,
    profile: Annotated[str, option("--profile", f"Tolerance profile: {PROFILES}.", "P")] = "default",
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None, option("--out", "Write convergence.json, a table, a picture and every walk.", "DIR")
    ] = None,
    resume: Resume = False,
    as_json: Json = False,
) -> int:
    """Measure the numerical uncertainty of a gait's metrics.

    Metrics depend on time step, grids, tolerances and contact parameters. The time step is halved repeatedly,
    at the same control frequency; so is the grid of the inverse kinematics; the QP's tolerance is tightened;
    contact stiffness is varied. Every metric gets its observed order, extrapolated value and numerical
    uncertainty, or "no asymptotic range"; 'ampm validate --uncertainty' quotes the uncertainty in its
    verdict.
    """
    from validation.study.convergence.result import Convergence
    from validation.study.convergence.study import convergence as study

    found = study(
        gait,
        with_short(settings, body=body),
        as_is=as_is,
        steps=steps,
        levels=levels,
        only=only or (),
        profile=profile,
        workers=workers,
        scheduler=scheduler,
        out=out,
        resume=resume,
        progress=Narrator(),
    )
    answer(found, Convergence.as_dict, lambda found: print_tables([found.table()]), as_json=as_json)
    Narrator().wrote(out)
    if not found.completed:
        return Status.NOT_COMPLETED
    return Status.PASS if found.verdict.passed else Status.OUT_OF_TOLERANCE

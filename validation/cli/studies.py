"""``ampm sweep``, ``rank``, ``convergence``, ``robustness`` and ``explain``: many walks."""

from pathlib import Path

import typer

from ampm.exceptions import InputError
from validation.cli import options
from validation.cli.console import Narrator
from validation.cli.options import Status, grouped, option
from validation.store.folders import names_folder

app = typer.Typer()


@app.command(
    rich_help_panel=options.WALK,
    epilog="Exit status: 0 every run that walked passed, 1 some are out of tolerance, 2 bad input, or every "
    f"run refused, 3 some did not complete, 4 a crash of ampm itself, {options.STOPPED}",
)
@grouped
def sweep(
    file: Path = typer.Argument(..., help="Definition of the sweep (TOML).", metavar="FILE"),
    *,
    execution: options.Running,
    metric: list[str] | None = options.METRICS,
    dry_run: bool = option("--dry-run", "Count runs and refusals by formula; walk one to measure the time."),
) -> int:
    """Walk many runs over parameters, on all cores.

    FILE defines the runs: grids, lists, Latin hypercubes or Sobol points over parameters. Runs walk on
    this machine or a cluster; every finished one is on the disk at once. After a kill, a full disk or Ctrl-C,
    --resume walks only what is missing, and the table is the same to the bit.
    """
    from validation.study.sweep import run  # loads simulator and measurement
    from validation.study.sweep.design import load_sweep
    from validation.study.sweep.table import RunState

    options.load_metrics(metric)
    if dry_run:
        expected = run.forecast(load_sweep(file), **execution.given())
        options.print_result(expected, as_json=execution.as_json)
        return Status.PASS if expected.found["walking"] or expected.found["finished"] else Status.REFUSED
    if execution.out is None:
        raise InputError("a sweep needs a folder; give --out DIR, or --dry-run to walk nothing.")
    found = run.sweep(file, **execution.given())
    execution.answer(found)
    ended = set(found.states)
    users = ("UsersError", "worker_died")
    if any(state is RunState.CRASHED and reason not in users for state, reason in found.endings):
        return Status.CRASH  # an error of our own
    if ended - {RunState.PASS, RunState.OUT_OF_TOLERANCE, RunState.NOT_MEASURED, RunState.REFUSED}:
        return Status.NOT_COMPLETED
    if ended == {RunState.REFUSED}:
        return Status.REFUSED
    return Status.PASS if ended <= {RunState.PASS, RunState.REFUSED} else Status.OUT_OF_TOLERANCE


@app.command(rich_help_panel=options.WALK, epilog="Exit status: 0 ranked, 2 bad input.")
@grouped
def rank(
    folder: Path = typer.Argument(..., help="Folder of a sweep, finished or not.", metavar="DIR"),
    *,
    by: str = option(
        "--by",
        "What is ranked: planner, controller, or a key that the sweep varies.",
        "KEY",
        default="planner",
    ),
    recordings: Path | None = option(
        "--recordings", "Walk the best and worst run of each planner again, into folders.", "DIR"
    ),
    resume: bool = option("--resume", "Go on with what is missing in --recordings."),
    as_json: bool = options.JSON,
) -> int:
    """Rank the planners of a sweep.

    Every gait of the sweep is a task; runs that differ in other keys are replicas. A rank is one more than
    the number of planners whose survival or error is better by more than the doubt of replicas, numerics and
    contact.
    """
    from validation.study.rank import rank as ranked

    if resume and recordings is None:
        raise InputError("--resume needs the folder of the walks; give --recordings DIR.")
    found = ranked(folder, by)
    if recordings is not None:
        from validation.study.sweep.design import load_sweep
        from validation.study.sweep.run import keep_runs
        from validation.study.sweep.table import SweepFile, read_sweep

        if recordings.resolve() == folder.resolve():
            raise InputError(f"--recordings {recordings} is the folder of the sweep; give another one.")
        definition, table = load_sweep(folder / SweepFile.DEFINITION), read_sweep(folder)
        keep_runs(definition, table, found.extremes, out=recordings, resume=resume, progress=Narrator())
    options.print_result(found, as_json=as_json)
    return Status.PASS


@app.command(
    rich_help_panel=options.CHECK,
    epilog="Exit status: 0 every metric is within its limit by more than its numerical uncertainty, 1 one is "
    f"over it, undecided or not measured, 3 a walk of a numerical study did not complete; {options.EXITS}",
)
@grouped
def convergence(
    gait: str | None = options.GAIT,
    *,
    walk: options.WalkOptions,
    steps: int = option("--steps", "Steps of every walk.", "N", default=6),
    profile: str | None = options.PROFILE,
    execution: options.Running,
) -> int:
    """Measure the numerical uncertainty of a gait's metrics.

    Metrics depend on time step, grids, tolerances and contact parameters. The time step is halved repeatedly,
    at the same control frequency; so is the grid of the inverse kinematics; the QP's tolerance is tightened;
    contact law and engine are varied. Every metric gets its observed order, extrapolated value and numerical
    uncertainty, or "no asymptotic range"; 'ampm validate --uncertainty' quotes the uncertainty in its
    verdict.
    """
    from validation.study.convergence.study import convergence as study

    found = study(walk.request(gait), steps=steps, profile=profile, **execution.given())
    execution.answer(found)
    if not found.completed:
        return Status.NOT_COMPLETED
    return Status.PASS if found.verdict.passed else Status.OUT_OF_TOLERANCE


@app.command(
    rich_help_panel=options.CHECK,
    epilog=f"Exit status: 0 the study is done, 2 bad input or refused, 4 a crash, {options.STOPPED}",
)
@grouped
def robustness(
    gait: str | None = options.GAIT,
    *,
    walk: options.WalkOptions,
    quick: bool = option("--quick", "Fewer pushes and coarser grids: a quarter of an hour on two cores."),
    only: list[str] | None = option(
        "--only", "Study only these kinds, such as pushes; an unknown one lists all. Repeatable.", "KIND"
    ),
    replicas: int = option("--replicas", "Walks of each value; four fifths have to survive.", "N", default=5),
    execution: options.Running,
) -> int:
    """Find the pushes and disturbances that a gait survives.

    Pushes of 0.1 s grow for each direction, phase and height, and so do values of keys of disturbance and
    sensors. The result is the largest value that is survived, as are all smaller ones.
    """
    from validation.study.robustness.study import robustness as study

    found = study(walk.request(gait), quick=quick, only=only or (), replicas=replicas, **execution.given())
    execution.answer(found)
    return Status.CRASH if found.crashes else Status.PASS


@app.command(rich_help_panel=options.CHECK, epilog=f"Exit status: 0 explained; {options.EXITS}")
@grouped
def explain(
    run: str | None = typer.Argument(None, help="Gait, or the folder of a run.", metavar="GAIT|RUN"),
    *,
    walk: options.WalkOptions,
    steps: int | None = options.STEPS,
    disturbing: options.Disturbing,
    metric: list[str] | None = options.METRICS,
    execution: options.Running,
) -> int:
    """Say which part of a trial makes it fail.

    The trial is walked with one layer made ideal at a time: sensing, motors, body, friction, floor, contact
    law, numerics, controller, gait, feet, posture, planner, pushes. A run's folder gets explain.json, which
    'ampm report' shows.
    """
    from validation.study.explain import explain as study

    options.load_metrics(metric)
    is_folder = run is not None and names_folder(run)
    if is_folder and walk.as_is:
        raise InputError(f"{run} is repeated as it was walked; leave out --as-is.")
    found = study(
        run if is_folder else walk.request(run, steps),
        walk.changes(steps) if is_folder else (),
        disturbances=disturbing.load(),
        **execution.given(),
    )
    execution.answer(found)
    return Status.PASS

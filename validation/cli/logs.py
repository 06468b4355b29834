"""``ampm judge`` and ``ampm fit``: commands that read a log of measured signals."""

from dataclasses import dataclass
from pathlib import Path

import typer

from ampm.exceptions import InputError
from validation.cli import options
from validation.cli.console import Narrator, print_json
from validation.cli.options import Status, grouped, option
from validation.cli.validate import print_trial, status_of
from validation.store.folders import check_run_folder, new_folder

app = typer.Typer()


@dataclass(frozen=True)
class Comparing:
    """The plan, and how a log is laid on it."""

    plan: str | None = option(
        "--plan",
        "Preset (normal if not given), TOML file, folder of a run, or a table of COM, ZMP and footsteps.",
        "GAIT|DIR|FILE.csv|.parquet",
    )
    columns: list[str] | None = options.COLUMNS
    settings: list[str] | None = options.SETTINGS
    steps: int | None = options.STEPS
    body: str | None = option(
        "--body", "Body of the plan, a name of 'ampm body list' or a description.", "NAME|FILE.toml"
    )
    start: float | None = option(
        "--start", "Time in the log at which the plan begins; by default it is found.", "S"
    )
    place: tuple[float, float] | None = option(
        "--place", "Move the log by X and Y [m]; by default to the plan's mean ZMP.", "X Y"
    )
    strides: bool = option("--strides", "Compare the mean stride with that of a periodic plan.")


@app.command(
    rich_help_panel=options.CHECK,
    epilog="Exit status: 0 pass, 1 out of tolerance, 2 bad input or refused, 3 a run that did not complete, "
    "4 crash of ampm itself, 6 partial, pass on all that was measured, 130 interrupted.",
)
@grouped
def judge(
    log: Path = typer.Argument(..., help="Table of measured signals, or the folder of a run.", metavar="LOG"),
    *,
    comparing: Comparing,
    judging: options.Judging,
    result: options.Result,
) -> int:
    r"""Judge a log of measured signals by a plan.

    The log is of a robot, another simulator or a person; metrics, limits, report and recording are those of
    'ampm validate'. LOG is a CSV or Parquet file with a row per instant, in SI units, x forward, y left, z
    up: time, and the ground force in one of three ways. Both feet together: force_x, force_y, force_z,
    zmp_x, zmp_y. Each foot: left_force_x ..., left_cop_x, left_cop_y, and right_.... Six-axis sensors:
    left_sensor_force_x ..., left_sensor_torque_x ... in the sensor's axes, its place left_sensor_x ... and
    its axes left_sensor_quaternion_w ... in the world, and right_.... com_x ...,
    angular_momentum_x ..., command_zmp_x ... are optional.

    The start is found by cross-correlation, the place by the mean ZMP, and both are printed; --start 0
    --place 0 0 keeps a log as it is. An empty cell is a gap. Metrics whose signals the log lacks are named as
    not measured. --set body.mass=72 gives the plan another mass.

    The folder of a run is judged again by its stored metrics.

    ampm judge walk.csv --plan gait.toml

    ampm judge robot.csv --columns time=t\[ms] --columns force_z=Fz_total

    ampm judge person.csv --plan normal --set body.mass=72 --strides

    ampm judge runs/walk --profile strict
    """
    from validation.run.judge_log import judge_log, judge_run

    profile, given = judging.load(), {**vars(comparing), "out": result.out, "force": result.force}
    if log.is_dir():
        if comparing.plan and Path(comparing.plan).is_dir() and Path(comparing.plan).samefile(log):
            given["plan"] = None
        if used := [name for name, value in given.items() if not (value is None or value is False)]:
            said = ", ".join(f"--{name}" for name in used).replace("settings", "set")
            raise InputError(f"{log} is the folder of a run; leave out what is for a table: {said}.")
        summary = judge_run(log, profile).summary
        target = log
    else:
        narrator = Narrator()
        target = result.out or new_folder(log.stem)
        check_run_folder(target, force=result.force)
        trial = judge_log(
            log,
            "normal" if comparing.plan is None else comparing.plan,
            columns=options.read_mapping(comparing.columns or ()),
            settings=options.with_short(comparing.settings, steps=comparing.steps, body=comparing.body),
            start=comparing.start,
            place=comparing.place,
            strides=comparing.strides,
            progress=narrator,
        )
        trial = trial if profile is None else trial.judged(profile)
        with narrator.stage("recording and report"):
            trial.save(target, force=result.force)
        summary = trial.summary
    if result.as_json:
        print_json({**summary, "directory": str(target)})
    else:
        print_trial(summary, target, wrote=target != log)
    return status_of(summary)


@app.command(
    rich_help_panel=options.CHECK,
    epilog="Exit status: 0 fitted, 2 bad input or too few strides, 4 crash of ampm itself, 130 interrupted.",
)
@grouped
def fit(
    log: Path = typer.Argument(..., help="Table of a measured walk, or the folder of a run.", metavar="LOG"),
    *,
    columns: list[str] | None = options.COLUMNS,
    mass: float | None = option("--mass", "Mass of the body; by default from the mean vertical force.", "KG"),
    com_height: float | None = option(
        "--com-height", "Mean height of the COM over the floor, for a log without COM.", "M"
    ),
    result: options.Result,
) -> int:
    """Fit the AMPM to a measured walk, and say how much of it the AMPM explains.

    LOG is a table as 'ampm judge' takes it, of steady walking along x, with the COM or its height. 1/a, b, c,
    H and timings have 95 % intervals over the strides. They explain ZMP, ground force and angular momentum of
    other strides, beside pendulums with a resting and with a rolling ZMP (c = 1). The folder holds
    report.html, fit.json, and gait.toml for 'ampm validate', if the closed form has such a gait.

    ampm fit walk.csv --out runs/fit

    ampm fit plates.csv --com-height 0.92 --mass 71
    """
    from validation.run.fit import fit_log

    target = result.out or new_folder(f"fit-{log.stem}")
    with Narrator().stage("fit and report"):
        found = fit_log(log, columns=options.read_mapping(columns or ()), mass=mass, com_height=com_height)
        found.save(target, force=result.force)
    if result.as_json:
        print_json({**found.as_dict(), "directory": str(target)})
    else:
        options.print_result(found, as_json=False)
        Narrator().wrote(*sorted(target.iterdir()))
    return Status.PASS

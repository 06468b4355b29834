"""``ampm validate``, and the commands on a run's folder: ``replay``, ``report`` and ``instrument``.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from ampm.exceptions import InputError, RefusedGait
from validation.cli.console import Narrator, print_json
from validation.cli.errors import describe_error, explain
from validation.cli.options import (
    AsIs,
    Body,
    Controller,
    Footsteps,
    Force,
    Gaits,
    Json,
    OwnProfile,
    PlannerName,
    RunFolder,
    Settings,
    Status,
    Steps,
    Uncertainty,
    answer,
    check_picture,
    option,
    with_footsteps,
    with_short,
)  # fmt: skip
from validation.progress import interruption
from validation.show.text import ABSENT, format_number, judged, print_line, print_table, print_verdict
from validation.store.folders import check_output_file, output_file

if TYPE_CHECKING:
    from validation.measure.instruments.observe import Observation

app = typer.Typer()

EPILOG = (
    "Exit status: 0 pass, 1 out of tolerance, 2 bad input or refused, 3 did not complete (fell, diverged, "
    "infeasible, crashed), 4 crash of ampm itself, 130 interrupted."
)


@app.command(epilog=EPILOG)
def validate(
    gaits: Gaits = None,
    settings: Settings = None,
    as_is: AsIs = False,
    steps: Steps = None,
    body: Body = None,
    profile: OwnProfile = None,
    qp: Annotated[str | None, option("--qp", "Short for solver.qp.", "osqp|admm|daqp")] = None,
    out: Annotated[
        Path | None,
        option(
            "--out",
            "Folder of the run; with several gaits, one sub-folder each. runs/GAIT-TIME if not given.",
            "DIR",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    uncertainty: Uncertainty = None,
    controller: Controller = None,
    planner: PlannerName = None,
    footsteps: Footsteps = None,
    push: Annotated[
        list[str] | None,
        option(
            "--push",
            "Push a segment: force in N, begin and duration in s; e.g. chest,50,0,0,2,0.1. Repeatable.",
            "SEGMENT,FX,FY,FZ,AT,DURATION",
        ),
    ] = None,
    instrument: Annotated[
        str | None,
        option(
            "--instrument",
            "Also show the ZMP as force-plate, foot-ft, imu or an instrument of your own (TOML) would.",
            "NAME|FILE",
        ),
    ] = None,
) -> int:
    """Plan, walk, measure and judge: the trial. Leaves a verdict, a recording and a report.

    The controller tracks the plan, so agreement alone proves nothing: the trial tests whether a body with
    real mass distribution, unilateral contact, friction and limited torque can realise the plan, how closely,
    and at what effort.

    Where a preset's gait or body is changed, what it leaves open (heights, timing, angles of the feet) is
    found for the change, and printed; what is given stays.
    """
    from ampm.run_file import changes
    from validation.judge import profiles
    from validation.judge.uncertainty import load_uncertainty, matching
    from validation.measure.instruments.model import load_instrument
    from validation.run import validate as run
    from validation.trial.disturbances import parse_push
    from validation.trial.plan import complete, load_requests

    if steps is not None and footsteps is not None:
        raise InputError("--steps counts the steps of a periodic gait; leave it out, or --footsteps.")
    extra = with_short(settings, body=body, steps=steps, planner=planner, qp=qp, controller=controller)
    requests = load_requests(gaits or [None], extra, as_is=as_is, sections=with_footsteps(footsteps))
    judges = [
        profiles.own_profile(gait, footsteps=bool(request.run.footsteps))
        if profile is None
        else profiles.profile(profile)
        for gait, request in zip(gaits or ["normal"], requests, strict=True)
    ]
    known = [load_uncertainty(path) for path in uncertainty or ()]
    for request in requests if known else ():  # before any walks
        if not changes(request.run):
            matching(known, request)
    sensors = None if instrument is None else load_instrument(instrument)
    pushes = [parse_push(text) for text in push or ()]
    targets = run.targets(requests, out, force=force)
    narrator = Narrator()
    answers: list[dict[str, Any]] = []
    statuses = [Status.PASS]
    for request, target, judge in zip(requests, targets, judges, strict=True):
        try:
            request = complete(request, narrator) if known else request
            summary = run.validate(
                request, target, judge, force=force, instrument=sensors, disturbances=pushes,
                uncertainty=matching(known, request) if known else None, progress=narrator,
            )  # fmt: skip
        except RefusedGait as error:  # the other gaits may still walk
            narrator.say(f"ampm: {request.name}: {explain(error)[1]}")
            answers.append({"gait": request.name, **describe_error(error)})
            statuses.append(Status.REFUSED)
            continue
        answers.append({**summary, "directory": str(target)})
        statuses.append(_status(summary))
        if not as_json:
            print_result(summary, target)
        if interruption.pending:  # interrupted during the measurement, which is finished first
            narrator.say(f"ampm: interrupted; the run is complete in {target} but for recording and report")
            interruption.acknowledge()
            statuses.append(Status.INTERRUPTED)
        if statuses[-1] is Status.INTERRUPTED:
            break
    if as_json:
        print_json(answers[0] if len(requests) == 1 else answers)
    return max(statuses)


def _status(summary: dict[str, Any]) -> Status:
    """Exit status of one finished run."""
    if summary["outcome"] == "interrupted":
        return Status.INTERRUPTED
    if summary["outcome"] != "completed":
        return Status.NOT_COMPLETED
    return Status.PASS if summary["verdict"] == "pass" else Status.OUT_OF_TOLERANCE


@app.command()
def replay(directory: RunFolder) -> int:
    """Step MuJoCo again from a run's recorded start with its recorded torques, and compare every bit."""
    from validation.run.replay import replay as step_again

    narrator = Narrator()
    result = step_again(directory, progress=narrator)
    if result.note:
        narrator.say(result.note)
    print_line(str(result))
    return Status.PASS if result.identical else Status.OUT_OF_TOLERANCE


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a run or of a sweep.", metavar="DIR")],
) -> int:
    """Write the report.html of a run or a sweep again from its saved files."""
    from validation.study.sweep.table import is_sweep

    with Narrator().stage("report"):
        if is_sweep(directory):
            from validation.study.sweep.report import write_sweep_report

            path = write_sweep_report(directory)
        else:
            from validation.show.report import write_report

            path = write_report(directory)
    print_line(str(path))
    return Status.PASS


@app.command()
def instrument(
    directory: RunFolder,
    name: Annotated[
        str,
        option("--instrument", "force-plate, foot-ft, imu, or a TOML file of your own.", "NAME|FILE"),
    ] = "force-plate",
    plot: Annotated[Path | None, option("--plot", "Draw the ZMP, its error, its causes.", "FILE.png")] = None,
    out: Annotated[
        Path | None, option("--out", "Write truth and readings at every step.", "FILE.parquet|.csv")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Apply the model of an instrument to a finished run; show the error it adds, and by which fault.

    Models of force plates, foot force/torque sensors or an IMU are compared with the simulator's true values:
    noise, bias, cross-talk, low-pass, sampling, delay, range and resolution. Nothing is simulated or judged:
    the exit status is 0.
    """
    from validation.measure.instruments.model import load_instrument
    from validation.measure.instruments.observe import Observation, observe_folder
    from validation.store.tables import write_columns
    from validation.trial.columns import check_suffix

    if plot is not None:
        check_picture(plot)
    if out is not None:
        check_suffix(out)
        check_output_file(out, force=force)
    observed = observe_folder(directory, load_instrument(name))
    if out is not None:
        with output_file(out, force=force) as work:
            write_columns(observed.signal_columns(), work)
    if plot is not None:
        from validation.show.instrument import draw  # loads matplotlib

        draw(observed, plot)
    answer(observed, Observation.as_dict, print_observation, as_json=as_json)
    Narrator().wrote(out, plot)
    return Status.PASS


def print_observation(observed: Observation) -> None:
    """Print the error and its causes."""
    from validation.show.instrument import cause_rows, error_rows

    name, found, columns = (
        observed.instrument.name,
        observed.as_dict(),
        ("", ">RMSE x", ">y", ">largest x", ">y"),
    )
    print_table(f"{name}: error that it adds to the ZMP, mm", columns, error_rows(found))
    print_table("each cause alone, whole walk, mm", columns, cause_rows(found))
    print_line(f"  latency           {1e3 * observed.latency:.3g} ms")
    error = observed.errors["run"]
    if error.unmeasured:
        print_line(f"  no ZMP            at {error.unmeasured} of {error.count + error.unmeasured} instants")
    for note in observed.notes:
        print_line(f"  {note}")


# ------------------------------------------------------------------------------------- a trial for a reader


def print_result(summary: Mapping[str, Any], folder: Path) -> None:
    """Print a trial's ``summary.json`` for a reader.

    Args:
        summary: contents of the file.
        folder: that holds it.
    """
    from validation.trial.plan import gait_title

    title = gait_title(summary["gait"], summary.get("changed", {}), summary.get("planner", ""))
    whole = all(item["first_step"] is None for item in summary["metrics"].values())
    print_table(
        f"{title}: measured against plan{'' if whole else ', without the first step'} "
        f"(profile {summary['profile']})",
        ("metric", ">value", ">limit", "unit", ""),
        [_row(name, item) for name, item in summary["metrics"].items() if item["tolerance"] is not None],
    )
    for name, text in _cost(summary).items():
        print_line(f"  {name:<18}{text}")
    print_verdict(title, summary["verdict"], summary["reason"])
    if known := summary.get("uncertainty"):
        inside = " + ".join(known.get("studies") or ())
        text = f"± numerical uncertainty{f' ({inside})' if inside else ''} of a convergence study of "
        text += f"{known['steps']} steps; a value closer to its limit than that is undecided"
        if lacking := known.get("not_studied"):
            text += f"; not studied, so nothing is decided: {', '.join(lacking)}"
        print_line(f"  {text}")
    for file, what in (("recording.rrd", f"ampm view {folder}"), ("report.html", "open in a browser")):
        if (folder / file).is_file():
            print_line(f"  {folder / file}  ({what})")
    print_line()


def _row(name: str, metric: Mapping[str, Any]) -> tuple[str | Text, ...]:
    shown = metric["display"]
    mark = "undecided" if metric.get("undecided") else {True: "pass", False: "FAIL"}.get(metric["pass"])
    value = format_number(shown["value"], 3)
    if metric.get("not_studied"):
        known = shown["uncertainty_at_least"]
        value += " ± not studied" if known is None else f" ± ≥ {format_number(float(known), 2)}"
    elif "uncertainty" in shown:
        value += f" ± {format_number(float(shown['uncertainty']), 2)}"
    unit = shown["unit"].replace("% of body weight", "% of weight")  # a terminal has 80 columns
    return name, value, format_number(shown["tolerance"], 3), unit, judged(mark) if mark else "not judged"


def _cost(summary: Mapping[str, Any]) -> dict[str, str]:
    """Cost of the walk, by name."""
    margins, solver, timing = summary["margins"], summary["solver"], summary["timing"]
    torque, support = margins["torque"], margins["measured_polygon"]["value"]
    gap = margins["clearance"]
    simulated, friction = format_number(timing["simulated"]), format_number(margins["friction"]["value"], 2)
    lines = {
        "outcome": f"{summary['outcome']}, {summary['steps_completed']} steps in {simulated} s",
        "feedback": f"command minus plan, RMS: ZMP x y {_millimetres(summary['effort']['zmp'], 2)} mm",
        "torque": f"{_scaled(torque['value'], 100, ' %')} of a motor's limit at most ({torque['where']})",
        "friction": f"{friction} used of {format_number(margins['friction_available'], 2)}",
        "ZMP margin": f"measured, at least {_scaled(support, 1000, ' mm', 1)}",
        "knee": f"bent by {format_number(margins['knee']['value'], 3)} rad at least",
        "clearance": "not judged, as the model has no shapes"
        if gap["value"] is None
        else f"{_scaled(gap['value'], 1000, ' mm', 1)} at least ({gap['where']})",
        "QP": f"{solver['ticks']} ticks, {solver['unsolved']} unsolved, "
        f"{_scaled(solver['time_median'], 1e6, ' us')} median, "
        f"{_scaled(solver['time_p99'], 1e6, ' us')} at the 99th percentile",
        "speed": f"closed loop at {format_number(timing['real_time_factor'], 3)} times real time",
    }
    if solver["unsolved"] is None:
        lines["QP"] = "none, so failed_qp does not apply"
    if summary["effort"]["zmp"] == [None, None]:
        lines["feedback"] = "not measured: no command was reported after the first step"
    if observed := summary.get("instrument"):
        sizes = {cause: windows["run"]["rmse"] for cause, windows in observed["causes"].items()}
        known = {cause: math.hypot(*rmse) for cause, rmse in sizes.items() if None not in rmse}
        most = f", most of it by {max(known, key=known.__getitem__).replace('_', ' ')}" if known else ""
        off = _millimetres(observed["zmp_error"]["run"]["rmse"], 3)
        lines["instrument"] = f"{observed['name']} shows the ZMP x y {off} mm off (RMS){most}"
    return lines


def _millimetres(values: list[float | None], digits: int) -> str:
    return " ".join(format_number(None if value is None else 1000 * value, digits) for value in values)


def _scaled(value: float | None, scale: float, unit: str, decimals: int = 0) -> str:
    return ABSENT if value is None else f"{scale * value:.{decimals}f}{unit}"

"""``ampm validate``, ``ampm replay`` and ``ampm report``: one trial, and what its folder gives again.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ampm.exceptions import RefusedGait
from validation.cli.console import Narrator, print_json
from validation.cli.errors import describe_error, explain
from validation.cli.options import (
    Force,
    Gaits,
    Json,
    RunFolder,
    Settings,
    Status,
    Steps,
    Uncertainty,
    option,
    with_steps,
)  # fmt: skip
from validation.progress import interruption
from validation.show.text import print_line

app = typer.Typer()

EPILOG = (
    "Exit status: 0 pass, 1 out of tolerance, 2 bad input or refused, 3 did not complete (fell, diverged, "
    "infeasible), 4 crash of ampm itself, 130 interrupted."
)


@app.command(epilog=EPILOG)
def validate(
    gaits: Gaits = None,
    settings: Settings = None,
    steps: Steps = None,
    profile: Annotated[
        str | None,
        option(
            "--profile", "Tolerance profile: default, strict, or wide; if not given, the preset's own.", "P"
        ),
    ] = None,
    qp: Annotated[str | None, option("--qp", "Short for solver.qp.", "osqp|daqp")] = None,
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
    tune: Annotated[
        bool,
        option("--tune", "Find what the gait leaves out, as 'ampm tune' does, instead of taking defaults."),
    ] = False,
    uncertainty: Uncertainty = None,
    controller: Annotated[
        str | None, option("--controller", "Walk under a controller of your own.", "MODULE:CLASS")
    ] = None,
    planner: Annotated[
        str | None, option("--planner", "Walk what a planner of your own plans.", "MODULE:CLASS")
    ] = None,
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
    """
    from validation.cli.summary_text import print_result
    from validation.judge import profiles
    from validation.judge.uncertainty import load_uncertainty, matching
    from validation.measure.instruments.model import load_instrument
    from validation.run import validate as run
    from validation.trial.disturbances import parse_push
    from validation.trial.plan import load_requests
    from validation.trial.tune import tune_walk
    from validation.trial.users import load_object, make_object

    extra = [*with_steps(settings, steps), *([] if qp is None else [f'solver.qp="{qp}"'])]
    gaits = gaits or ["normal"]
    requests = load_requests(gaits, extra, check=not tune)
    judges = [profiles.own_profile(gait) if profile is None else profiles.profile(profile) for gait in gaits]
    known = [load_uncertainty(path) for path in uncertainty or ()]
    if known and not tune:
        for request in requests:  # all of them before any walks
            matching(known, request)
    options = run.Options(
        force=force,
        instrument=None if instrument is None else load_instrument(instrument),
        controller=None if controller is None else load_object("--controller", controller),
        planner=None if planner is None else make_object("--planner", planner),
        disturbances=[parse_push(text) for text in push or ()],
    )
    targets = run.targets(requests, out, force=force)
    narrator = Narrator()
    answers: list[dict[str, Any]] = []
    statuses = [Status.PASS]
    for request, target, judge in zip(requests, targets, judges, strict=True):
        try:
            options = replace(options, profile=judge)
            if tune:
                request = tune_walk(request, narrator).request
            if known:
                options = replace(options, uncertainty=matching(known, request))
            summary = run.validate(request, target, options, progress=narrator)
        except RefusedGait as error:  # the other gaits may still walk
            narrator.say(f"ampm: {request.name}: {explain(error)[1]}")
            answers.append({"gait": request.name, **describe_error(error)})
            statuses.append(Status.REFUSED)
            continue
        answers.append({**summary, "directory": str(target)})
        statuses.append(_status(summary))
        if not as_json:
            print_result(summary, target)
        if interruption.pending:  # during the measurement, which has been finished
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
    from validation.study.sweep.store import is_sweep

    with Narrator().stage("report"):
        if is_sweep(directory):
            from validation.study.sweep.report import write_sweep_report

            path = write_sweep_report(directory)
        else:
            from validation.show.report import write_report

            path = write_report(directory)
    print_line(str(path))
    return Status.PASS

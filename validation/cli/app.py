"""The console script ``ampm``.

Results go to stdout, everything else to stderr. Exit status: 0 pass, 1 out of tolerance, 2 bad input or
refused, 3 did not complete, 4 our crash, 130 interrupted. Modules that simulate are imported by the command
that needs them, so that ``ampm --help`` and ``ampm plan --no-body`` answer at once.
"""

from __future__ import annotations

if __name__ == "__main__":  # ready for Ctrl-C before the imports below
    from validation.cli.entry import main as _main

    _main()

import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

import ampm
from ampm.exceptions import RefusedGait
from ampm.parameters import PRESETS
from validation.cli import instrument
from validation.cli import sweeps as cli_sweeps
from validation.cli.console import Narrator, print_json
from validation.cli.entry import main as main  # for callers from Python
from validation.cli.errors import describe_error, explain, keep_traceback
from validation.cli.options import Debug, Force, Json, Status
from validation.judge.profiles import OWN
from validation.progress import interruption
from validation.show.text import print_line

_PRESET_LINES = "\n\n".join(f"{name}: {meaning}" for name, meaning in PRESETS.items())
_EPILOG = (
    "Exit status: 0 pass, 1 out of tolerance, 2 bad input or refused, 3 did not complete (fell, diverged, "
    "infeasible), 4 crash of ampm itself, 130 interrupted."
)

app = typer.Typer(
    name="ampm",
    help="Plan the gait of the angular-momentum-inducing pendulum, walk it in MuJoCo under torque control, "
    "and say how far physics and formula agree.",
    epilog=_EPILOG,
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="rich",
)

Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one parameter, e.g. gait.c_s=1.2; repeatable."),
]
Gait = Annotated[str, typer.Argument(help=f"Preset ({', '.join(PRESETS)}) or TOML file.", metavar="[GAIT]")]
Gaits = Annotated[
    list[str] | None,
    typer.Argument(help=f"Presets ({', '.join(PRESETS)}) or TOML files.", metavar="[GAIT]..."),
]
RunDir = Annotated[Path, typer.Argument(help="Folder of a run.", metavar="DIR")]


def _version(value: bool) -> None:
    if value:
        print_line(f"ampm {ampm.__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print_line(context.get_help())


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
    debug: Debug = False,
) -> int:
    """Plan a gait in closed form: constants, residuals, samples, a picture.

    With a body (the default) the plan is checked against its soles, legs and joints, and the constant of L_y
    is the one that makes the body's motion periodic.
    """
    from ampm.planner.periodic import plan_gait
    from validation.cli import plan as output
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
        output.write_picture(request.name, planned, plot)
    if as_json:
        print_json(output.describe(request, planned, walk))
    else:
        output.print_plan(request, planned, walk)
    for path in (samples, plot):
        if path is not None:
            narrator.say(f"wrote {path}")
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
    debug: Debug = False,
) -> int:
    """Solve the periodic whole-body motion of one step: what every joint does."""
    from validation.cli import plan as output
    from validation.store.folders import check_output_file
    from validation.trial.plan import load_requests, plan_walk

    if out is not None:
        check_output_file(out, force=force)
    requests = load_requests(gaits or ["normal"], settings or ())
    narrator = Narrator()
    walks = [plan_walk(request, narrator) for request in requests]
    if out is not None:
        output.write_motions(walks, out, force=force)
    if as_json:
        print_json([output.describe_motion(walk) for walk in walks])
    else:
        for walk in walks:
            output.print_motion(walk)
    if out is not None:
        narrator.say(f"wrote {out}")
    return Status.PASS


@app.command(epilog=_EPILOG)
def validate(
    gaits: Gaits = None,
    settings: Settings = None,
    steps: Annotated[int | None, typer.Option("--steps", metavar="N", help="Short for gait.steps=N.")] = None,
    profile: Annotated[
        str | None,
        typer.Option(
            "--profile",
            metavar="P",
            help=f"Tolerance profile: default, strict, or wide. Not given: default, but wide for "
            f"{' and '.join(OWN)}.",
        ),
    ] = None,
    qp: Annotated[str | None, typer.Option("--qp", metavar="osqp|daqp", help="Short for solver.qp.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder of the run; with several gaits, one sub-folder each. runs/GAIT-TIME if not given.",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    tune: Annotated[
        bool,
        typer.Option(
            "--tune", help="Find what the gait leaves out, as 'ampm tune' does, instead of taking defaults."
        ),
    ] = False,
    uncertainty: Annotated[
        list[Path] | None,
        typer.Option(
            "--uncertainty",
            metavar="FILE",
            help="convergence.json of this gait, from 'ampm convergence': figures are quoted with their "
            "numerical uncertainty, and one closer to its limit than that is undecided (status 1). "
            "Repeatable, one per gait.",
        ),
    ] = None,
    instrument_name: Annotated[
        str | None,
        typer.Option(
            "--instrument",
            metavar="NAME|FILE",
            help="Also show the ZMP as force-plate, foot-ft, imu or an instrument of your own (TOML) would.",
        ),
    ] = None,
    debug: Debug = False,
) -> int:
    """Plan, walk, measure and judge: the trial. Leaves a verdict, a recording and a report.

    What it shows is whether a body with real mass distribution, unilateral contact, friction and limited
    torque can realise the plan, how closely, and at what cost. The controller follows the plan: agreement is
    no prophecy.
    """
    from validation.judge import profiles
    from validation.judge.uncertainty import load_uncertainty, matching
    from validation.run import validate as run
    from validation.show import summary as summary_text
    from validation.trial.plan import load_requests
    from validation.trial.tune import tune_walk

    extra = list(settings or ())
    if steps is not None:
        extra.append(f"gait.steps={steps}")
    if qp is not None:
        extra.append(f'solver.qp="{qp}"')
    gaits = gaits or ["normal"]
    requests = load_requests(gaits, extra, check=not tune)
    judges = [profiles.own_profile(gait) if profile is None else profiles.profile(profile) for gait in gaits]
    known = [load_uncertainty(path) for path in uncertainty or ()]
    if known and not tune:
        for request in requests:  # all of them before any walks
            matching(known, request)
    options = run.Options(
        force=force,
        instrument=None if instrument_name is None else _instrument(instrument_name),
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
            result = run.validate(request, target, options, stages=narrator)
        except RefusedGait as error:  # the other gaits may still walk
            narrator.say(f"ampm: {request.name}: {explain(error)[1]}")
            answers.append({"gait": request.name, **describe_error(error)})
            statuses.append(Status.REFUSED)
            continue
        answers.append({**result.summary, "directory": str(result.directory)})
        statuses.append(_status(result.summary))
        if not as_json:
            summary_text.print_result(result)
        del result  # the next walk needs the room
        if interruption.pending:  # during the measurement, which has been finished
            narrator.say(f"ampm: interrupted; the run is complete in {target} but for recording and report")
            interruption.acknowledge()
            statuses.append(Status.INTERRUPTED)
        if statuses[-1] is Status.INTERRUPTED:
            break
    if as_json:
        print_json(answers[0] if len(requests) == 1 else answers)
    return max(statuses)


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
    debug: Debug = False,
) -> int:
    """Find what a gait leaves open: share of single support, roll, heights, foot timing and angles, lean.

    What the preset, the file or --set names stays as it is. An optimiser works on plan and whole-body motion
    alone; nothing is simulated. Where no choice walks, the refusal names the limit and the best it found.
    """
    from validation.cli import tune as output
    from validation.store.folders import check_output_file
    from validation.trial.plan import load_request
    from validation.trial.tune import tune_walk

    if out is not None:
        output.check_toml(out)
        check_output_file(out, force=force)
    narrator = Narrator()
    request = load_request(gait, settings or ())
    result = tune_walk(request, narrator).tuned
    if out is not None:
        output.write_tuned(request.name, result, out, force=force)
    if as_json:
        print_json(output.describe_tuned(request.name, result))
    else:
        output.print_tuned(request.name, result)
    if out is not None:
        narrator.say(f"wrote {out}")
    return Status.PASS


@app.command()
def compare(
    a: Annotated[
        str, typer.Argument(help="Preset, TOML file, or folder of a run.", metavar="[A]")
    ] = "normal",
    b: Annotated[str, typer.Argument(help="What it is compared with.", metavar="[B]")] = "ipm",
    settings: Settings = None,
    steps: Annotated[int | None, typer.Option("--steps", metavar="N", help="Short for gait.steps=N.")] = None,
    uncertainty: Annotated[
        list[Path] | None,
        typer.Option(
            "--uncertainty",
            metavar="FILE",
            help="convergence.json of a gait, from 'ampm convergence': a difference within the numerical "
            "uncertainty of both is no result. Repeatable, one per gait; without, no figure of a walk is "
            "called better.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Keep the report, the numbers and the runs.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    debug: Debug = False,
) -> int:
    """Walk or load two gaits and put them side by side, at the switches of support above all.

    The default says what continuity up to the acceleration buys: the paper's gait beside the plain inverted
    pendulum. No tolerances are judged: 0 means that both walked to the end.
    """
    from validation.study.compare import run as pairs

    extra = [*(settings or ()), *([] if steps is None else [f"gait.steps={steps}"])]
    pair = pairs.compare_pair(
        a, b, extra, uncertainty=uncertainty or (), out=out, force=force, stages=Narrator()
    )
    if as_json:
        print_json(pair.as_dict())
    else:
        pairs.print_pair(pair)
    return max(pairs.status(pair))


@app.command()
def replay(directory: RunDir, debug: Debug = False) -> int:
    """Step MuJoCo again from a run's recorded start with its recorded torques, and compare every bit."""
    from validation.run.replay import replay as step_again

    narrator = Narrator()
    result = step_again(directory, stages=narrator)
    if result.note:
        narrator.say(result.note)
    print_line(str(result))
    return Status.PASS if result.identical else Status.OUT_OF_TOLERANCE


@app.command()
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="Folders of runs, recordings, or a sweep.", metavar="DIR|FILE.rrd...")
    ],
    runs: Annotated[
        str | None,
        typer.Option(
            "--runs", metavar="3,17", help="Runs of a sweep; by default the worst one and the median."
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FILE.rrd", help="Write what would be shown; opens nothing."),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it in a web browser.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier file at --save.")] = False,
    debug: Debug = False,
) -> int:
    """Open recordings in the Rerun viewer, side by side or overlaid, aligned on the phase of the gait.

    One run opens as it is. Of a sweep, the chosen runs stand beside each other. Several runs of one gait, say
    of two revisions, lie over each other in colours of their own; of different gaits they stand beside each
    other.
    """
    from validation.show.viewer import view as open_viewer

    narrator = Narrator()
    status = open_viewer(targets, runs=runs, web=web, save=save, force=force, say=narrator.say)
    if save is not None:
        narrator.say(f"wrote {save}")
    interruption.acknowledge()  # Ctrl-C is how the web server is stopped
    return status


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a run or of a sweep.", metavar="DIR")],
    debug: Debug = False,
) -> int:
    """Write the report.html of a run or a sweep again from its saved files."""
    from validation.study.sweep.store import is_sweep

    narrator = Narrator()
    with narrator.stage("report"):
        if is_sweep(directory):
            from validation.study.sweep.report import write_sweep_report

            path = write_sweep_report(directory)
        else:
            from validation.show.report import write_report

            path = write_report(directory)
    print_line(str(path))
    return Status.PASS


@app.command()
def audit(as_json: Json = False, debug: Debug = False) -> int:
    """Check every equation and claim of the paper, and say where it is wrong and by how much."""
    from validation.paper.audit.command import run as run_audit

    return Status.PASS if run_audit(as_json=as_json) else Status.OUT_OF_TOLERANCE


@app.command()
def figures(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write SVG and PNG into.")],
    steps: Annotated[int, typer.Option("--steps", metavar="N", help="Steps walked for a figure.")] = 12,
    only: Annotated[
        str | None, typer.Option("--only", metavar="8,9", help="Of 4, 5, 7, 8, 9, 10, 11, 12, human.")
    ] = None,
    force: Force = False,
    debug: Debug = False,
) -> int:
    """Draw the paper's figures from data: plan, inverse kinematics and simulation on the same axes."""
    from validation.paper.figures import make_figures

    for path in make_figures(out, only, steps, force=force, stages=Narrator()):
        print_line(str(path))
    return Status.PASS


cli_sweeps.register(app)
app.add_typer(instrument.app)


def _instrument(name: str) -> Any:
    """Load an instrument; only those who ask for one pay for its imports."""
    from validation.measure.instruments import load_instrument

    return load_instrument(name)


def _status(summary: dict[str, Any]) -> Status:
    """Exit status of one finished run."""
    if summary["outcome"] == "interrupted":
        return Status.INTERRUPTED
    if summary["outcome"] != "completed":
        return Status.NOT_COMPLETED
    return Status.PASS if summary["verdict"] == "pass" else Status.OUT_OF_TOLERANCE


def call(arguments: Sequence[str]) -> int:
    """Run one command line, with every error turned into one sentence on stderr.

    Args:
        arguments: without the program's name.

    Returns:
        The exit status.
    """
    arguments = list(arguments)
    command = typer.main.get_command(app)
    try:
        with command.make_context("ampm", arguments) as context:
            status = int(command.invoke(context) or 0)
        interruption.check()
        return status
    except typer.Exit as end:
        return end.exit_code
    except BrokenPipeError:  # the reader has left: nobody to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Status.BROKEN_PIPE
    except (Exception, KeyboardInterrupt) as caught:
        error: BaseException = caught
        if interruption.pending and not isinstance(error, KeyboardInterrupt):
            error = KeyboardInterrupt()  # some extensions make another error of it
            error.__cause__ = caught
            for note in getattr(caught, "__notes__", ()):
                error.add_note(note)
        interruption.finished = interruption.pending
        status, text = explain(error)
        if "--json" in arguments:
            print_json(describe_error(error))
        if "--debug" in arguments:
            traceback.print_exception(error)
        elif status is Status.CRASH:
            kept = keep_traceback(error)
            text += (
                f"; the traceback is in {kept}" if kept else "; run it again with --debug for the traceback"
            )
            text += ", please report it."
        print(f"ampm: {text}", file=sys.stderr)  # noqa: T201
        return status

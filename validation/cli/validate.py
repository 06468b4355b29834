"""``ampm validate``, and the commands on folders of runs: ``replay``, ``report`` and ``view``."""

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import typer
from rich.text import Text

from ampm.exceptions import InputError, RefusedGait
from validation.cli import options
from validation.cli.console import Narrator, print_json, print_line
from validation.cli.errors import describe_error, explain
from validation.cli.options import Status, grouped, option
from validation.progress import interruption
from validation.show.viewer import show_recording, viewer_command
from validation.store.folders import check_new_file, output_file
from validation.table import COLORS, print_tables
from validation.trial.files import RunFile

app = typer.Typer()

EPILOG = (
    "Exit status: 0 pass, 1 out of tolerance, 2 bad input or refused, 3 did not complete (fell, diverged, "
    "infeasible, crashed), 4 crash of ampm itself, 5 stopped from outside (full disk), 130 interrupted."
)


@app.command(rich_help_panel=options.WALK, epilog=EPILOG)
@grouped
def validate(
    gaits: list[str] | None = options.GAITS,
    *,
    walk: options.WalkOptions,
    length: options.Length,
    disturbing: options.Disturbing,
    judging: options.Judging,
    uncertainty: list[Path] | None = options.UNCERTAINTY,
    result: options.Result,
) -> int:
    """Plan, walk, measure and judge gaits: the trial.

    It leaves a folder with a verdict, a recording and a report; of several gaits one each, in --out.

    The controller tracks the plan, so agreement alone proves nothing: the trial tests whether a body with
    real mass distribution, unilateral contact, friction and limited torque can realise the plan, how closely,
    and at what effort.

    If gait or body differ from a preset's, open values (heights, timing, angles of the feet) are found and
    printed; given values stay.
    """
    from ampm.run_file import leaves_open
    from validation.judge.uncertainty import load_uncertainty, matching
    from validation.run import validate as run
    from validation.trial.plan import complete, load_requests

    profile = judging.load()
    requests = load_requests(
        gaits or [None], walk.changes(length.steps), as_is=walk.as_is, sections=length.sections()
    )
    disturbances = disturbing.load()
    if uncertainty and disturbances:
        raise InputError("--uncertainty holds for no walk with --push or --disturbance; leave it out.")
    known = [load_uncertainty(path) for path in uncertainty or ()]
    for request in requests if known else ():  # before any walks
        if not leaves_open(request.run):
            matching(known, request)
    targets = run.targets(requests, result.out, force=result.force)
    narrator = Narrator()
    answers: list[dict[str, Any]] = []
    statuses = [Status.PASS]
    for request, target in zip(requests, targets, strict=True):
        try:
            request = complete(request, narrator) if known else request
            summary = run.validate(
                request,
                target,
                profile,
                force=result.force,
                disturbances=disturbances,
                uncertainty=matching(known, request) if known else None,
                progress=narrator,
            )
        except RefusedGait as error:  # the other gaits may still walk
            narrator.say(f"ampm: {request.name}: {explain(error)[1]}")
            answers.append({"gait": request.name, **describe_error(error)})
            statuses.append(Status.REFUSED)
            continue
        answers.append({**summary, "directory": str(target)})
        statuses.append(status_of(summary))
        if not result.as_json:
            print_trial(summary, target, metrics=judging.metric or ())
        if interruption.pending:  # interrupted during the measurement, which is finished first
            missing = "recording and report, which 'ampm report' draws"
            narrator.say(f"ampm: interrupted; the run is complete in {target} but for {missing}")
            interruption.acknowledge()
            statuses.append(Status.INTERRUPTED)
        if statuses[-1] is Status.INTERRUPTED:
            break
    if result.as_json:
        print_json(answers[0] if len(requests) == 1 else answers)
    return max(statuses)


def status_of(summary: Mapping[str, Any]) -> Status:
    """Exit status of one finished run."""
    if summary["outcome"] != "completed":
        return Status.INTERRUPTED if summary["outcome"] == "interrupted" else Status.NOT_COMPLETED
    statuses = {"pass": Status.PASS, "partial": Status.PARTIAL}
    return statuses.get(summary["verdict"], Status.OUT_OF_TOLERANCE)


@app.command(rich_help_panel=options.CHECK, epilog="Exit status: 0 identical, 1 not, 2 bad input.")
def replay(directory: Path = typer.Argument(..., help="Folder of a run.", metavar="DIR")) -> int:
    """Repeat a run from its recorded torques, to the bit.

    The engine steps again from the recorded start, without the controller. Every bit of states, contacts and
    measured signals is compared.
    """
    from validation.run.replay import replay as step_again

    narrator = Narrator()
    result = step_again(directory, progress=narrator)
    if result.note:
        narrator.say(result.note)
    print_line(str(result))
    return Status.PASS if result.identical else Status.OUT_OF_TOLERANCE


@app.command(rich_help_panel=options.LOOK)
def report(
    directory: Path = typer.Argument(
        ..., help="Folder of a run, a comparison of walks, or a sweep.", metavar="DIR"
    ),
    figures: Path | None = option("--figures", "Write the figures of a paper's page, not the page.", "DIR"),
    form: str = option("--format", "Format of the figures.", "pdf|svg|pgf", default="pdf"),
    width: str = option("--width", "Width of a column; wide figures span two.", "88mm", default="88mm"),
    tables: str | None = option(
        "--tables", "Write the page's tables, too; without --figures print them.", "tex|md|csv"
    ),
    evidence: Path | None = option("--evidence", "Write the evidence of a run, not the page.", "FILE.zip"),
    study: list[Path] | None = option(
        "--study",
        "A study for --evidence: robustness, a comparison of engines, a judged log. Repeatable.",
        "DIR",
    ),
    force: bool = option("--force", "Replace earlier files at --figures or --evidence."),
) -> int:
    """Write the report of a run, a comparison or a sweep again from its files, or its figures for a paper.

    --figures DIR holds every figure as a vector file in one style, captions.txt with their numbers and
    captions, cite.txt and cite.bib. Values of tables have the uncertainty that a convergence study gave
    ('ampm validate --uncertainty'). Tables for LaTeX need the package booktabs, figures in pgf the package
    pgf.

    --evidence has one page and JSON-LD: what was verified and validated, after the factors of ASME V&V 40 and
    NASA-STD-7009, and what was not; inputs, digests and environment. The run is replayed for it.
    """
    shaped = figures is None and (form, width) != ("pdf", "88mm")
    if shaped or (study and not evidence) or (evidence and (figures or tables)):
        raise InputError(
            "--format and --width need --figures, --study needs --evidence; "
            "give --evidence without --figures and --tables."
        )
    if force and not (figures or evidence):
        raise InputError("--force needs --figures or --evidence; the page is always written again.")
    if evidence is not None:
        from validation.study.evidence import write_evidence  # loads the simulator

        print_line(str(write_evidence(directory, evidence, study or (), Narrator(), force=force)))
        return Status.PASS
    from validation.show.paper import FORMATS, TABLES, as_text, parse_width, write_paper
    from validation.study.paper import load_paper, write_page

    for name, value, known in (("--format", form, FORMATS), ("--tables", tables, (None, *TABLES))):
        if value not in known:
            raise InputError(f"{name} {value} is unknown; give one of {', '.join(filter(None, known))}.")
    column = parse_width(width)
    if figures is not None:
        paper = load_paper(directory)
        with Narrator().stage("figures"):
            write_paper(figures, paper, form=form, width=column, table_form=tables, force=force)
        print_line(str(figures))
    elif tables is not None:
        print_line(as_text(load_paper(directory).tables, tables))
    else:
        with Narrator().stage("report"):
            path = write_page(directory)
        print_line(str(path))
    return Status.PASS


@app.command(rich_help_panel=options.LOOK)
def view(
    targets: list[Path] = typer.Argument(
        ..., help="Folders of runs, or one recording to show.", metavar="DIR|FILE.rrd"
    ),
    save: Path | None = option("--save", "Write what would be shown; opens nothing.", "FILE.rrd"),
    web: bool = option("--web", "Show it in a web browser."),
    force: bool = option("--force", "Replace an earlier file at --save."),
) -> int:
    """Open recordings in the Rerun viewer, one or several.

    One run opens unchanged. Several are aligned on the phase of the gait: the bodies stand side by side, and
    the curves lie over each other.
    """
    if save is not None and web:
        raise InputError("--save opens nothing; leave it out, or --web.")
    if force and save is None:
        raise InputError("--force needs --save FILE.rrd; give it, or leave --force out.")
    if save is None and len(targets) == 1 and targets[0].suffix == ".rrd" and targets[0].is_file():
        show_recording(targets[0], web=web)
        return Status.PASS
    if missing := [target for target in targets if not (target / RunFile.SUMMARY).is_file()]:
        what = "is not a run" if missing[0].exists() else "does not exist"
        raise InputError(f"{missing[0]} {what}; give folders, or one .rrd file alone without --save.")
    if save is None:
        viewer_command(targets[0], web=web)  # refuses if there is no display
    else:
        check_new_file(save, ".rrd", force=force)
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        shown = recording_of(targets, Path(folder))
        if save is None:
            show_recording(shown, web=web)
            return Status.PASS
        with output_file(save, force=force) as work:
            shutil.copyfile(shown, work)
    Narrator().wrote(save)
    return Status.PASS


def recording_of(targets: Sequence[Path], folder: Path) -> Path:
    """The recording of one run, or a file in a folder with those of several.

    Raises :class:`InputError` if a file of a run has changed, or a run is given twice.
    """
    from validation.show.rerun.record import write_recording, write_several
    from validation.store.saved import load_saved_run

    runs = [load_saved_run(target) for target in targets]
    if len(runs) == 1 and (targets[0] / RunFile.RECORDING).is_file():
        return targets[0] / RunFile.RECORDING
    with Narrator().stage("recording"):
        if len(runs) == 1:
            return write_recording(runs[0])
        names = [target.resolve().name for target in targets]
        if len(set(names)) < len(names):  # two revisions of one gait
            names = [str(target) for target in targets]
        if len(set(names)) < len(names):
            raise InputError(f"{', '.join(names)}: give every run once.")
        write_several(dict(zip(names, runs, strict=True)), folder / RunFile.RECORDING)
    return folder / RunFile.RECORDING


def print_trial(
    summary: Mapping[str, Any], folder: Path, *, wrote: bool = True, metrics: Sequence[str] = ()
) -> None:
    """Print a trial's ``summary.json`` for a reader, its files, and how a failure is explained."""
    from validation.show.cost_table import cost_table
    from validation.store.metric_table import metric_table, walk_title

    print_tables([metric_table(summary), cost_table(summary)])
    fell = status_of(summary) is Status.NOT_COMPLETED and summary["outcome"] != "crashed"  # which says why
    planned = "log" not in summary and "velocity" not in summary  # without a plan no layer is the policy
    failed = wrote and planned and (fell or summary["verdict"] == "fail")
    here, given = quote(str(folder)), "".join(f" --metric {quote(text)}" for text in metrics)
    why = f" ampm explain {here}{given} says why." if failed else ""
    word = f"{walk_title(summary)}: {summary['verdict'].replace('_', ' ').upper()}"
    color = COLORS.get(summary["verdict"], "yellow")
    print_line(Text.assemble((word, f"bold {color}"), f"  {summary['reason']}{why}"))
    for file, what in (("recording.rrd", f"ampm view {here}"), ("report.html", "open in a browser")):
        if wrote and (folder / file).is_file():
            print_line(f"  {folder / file}  ({what})")
    print_line()

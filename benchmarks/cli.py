"""Command line of ``python -m benchmarks``."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ampm.exceptions import InputError
from ampm.presets import PRESETS
from ampm.qp import BACKENDS
from validation.cli.console import Narrator
from validation.cli.errors import explain
from validation.cli.options import Status, option
from validation.store.folders import check_output_file, output_file
from validation.store.json import dump_json
from validation.table import Table, print_tables

app = typer.Typer(
    name="benchmarks",
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
Gait = Annotated[str, option("--gait", f"Preset ({', '.join(PRESETS)}) or TOML file.", "GAIT")]


@app.callback(invoke_without_command=True)
def benchmark(
    context: typer.Context,
    gait: Gait = "normal",
    settings: Annotated[
        list[str] | None, option("--set", "Change one parameter; repeatable.", "KEY=VALUE")
    ] = None,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Walking steps of every walk.")] = 30,
    walks: Annotated[
        int, typer.Option("--walks", min=1, help="Equal walks; of every tick the least time counts.")
    ] = 3,
    qp: Annotated[str, option("--qp", "QP solver of the controller.", "osqp|daqp|all")] = "all",
    json_file: Annotated[
        Path | None, option("--json", "Write everything as JSON as well; - for stdout alone.", "FILE")
    ] = None,
    to_document: Annotated[
        bool, option("--markdown", "Put the table into docs/benchmarks.md as well.")
    ] = False,
    force: Annotated[bool, option("--force", "Replace an earlier FILE.")] = False,
) -> int:
    """Time planning, whole-body motion, control and physics of one gait.

    With each solver the same walk is made several times; then its physics is stepped alone. The work is the
    same every time and on one thread, so the least time of each tick counts. The default takes about a
    minute.
    """
    if context.invoked_subcommand is not None:
        return Status.PASS
    # Imported here so that '--help' loads neither simulator nor Pinocchio.
    from benchmarks.run import run_benchmarks
    from benchmarks.table import table, update_document

    solvers = BACKENDS if qp == "all" else (qp,)
    if qp not in (*BACKENDS, "all"):
        raise InputError(f"--qp {qp!r} must be of {', '.join(BACKENDS)}, all; correct it.")
    alone = str(json_file) == "-"
    if json_file is not None and not alone:
        check_output_file(json_file, force=force)
    narrator = Narrator()
    result = run_benchmarks(
        gait, settings or (), steps=steps, walks=walks, solvers=solvers, progress=narrator
    )
    if alone:
        print(dump_json(result))
    else:
        print_tables([table(result)])
        _write(json_file, result, force=force)
    if to_document:
        update_document(result)
        narrator.say("wrote docs/benchmarks.md")
    return Status.PASS


@app.command()
def sweep(
    gait: Gait = "normal",
    steps: Annotated[int, typer.Option("--steps", min=2, help="Walking steps of every run.")] = 30,
    runs: Annotated[int, typer.Option("--runs", help="Runs of every sweep.")] = 64,
    json_file: Annotated[Path | None, option("--json", "Write everything as JSON as well.", "FILE")] = None,
) -> int:
    """Time a sweep with one worker and with two, beside the same runs without a sweep.

    The default takes about fifteen minutes on an idle machine of two cores, and means little on a busy one.
    Exit status 1 if a target is missed.
    """
    from benchmarks.sweeping import is_met, rows, time_sweep  # load dask

    timing = time_sweep(gait, steps, runs, Narrator())
    title = f"{runs} runs of {gait}, {steps} steps each, load {timing['load']:.1f} at the start"
    print_tables([Table(title, ("", ">measured", ">target"), rows(timing))])
    _write(json_file, timing, force=True)
    return Status.PASS if is_met(timing) else Status.OUT_OF_TOLERANCE


@app.command()
def peers(
    only: Annotated[list[str] | None, option("--only", "One task; repeatable.", "TASK")] = None,
    install: Annotated[
        bool, typer.Option("--install/--no-install", help="Make environments that are missing.")
    ] = True,
    json_file: Annotated[Path | None, option("--json", "Write everything as JSON as well.", "FILE")] = None,
    to_document: Annotated[
        bool,
        option("--markdown", "Write docs/data/peers.csv and its overview in docs/benchmarks.md as well."),
    ] = False,
) -> int:
    """Compare with other libraries at the same work.

    Every library that the project's environment lacks gets one of its own in the user's cache. One that
    cannot be installed is listed with the reason.
    """
    from benchmarks.peers.compare import TASKS, compare, print_sections, update_document

    for task in only or ():
        if task not in TASKS:
            raise InputError(f"--only {task!r} must be of {', '.join(TASKS)}; correct it.")
    sections = compare(only or tuple(TASKS), install=install, progress=Narrator())
    print_sections(sections)
    _write(json_file, sections, force=True)
    if to_document:
        update_document(sections)
        Narrator().say("wrote docs/data/peers.csv, docs/benchmarks.md")
    return Status.PASS


@app.command()
def qpset(
    file: Annotated[Path, typer.Argument(help="File to write (npz).", metavar="FILE")],
    force: Annotated[bool, option("--force", "Replace an earlier FILE.")] = False,
) -> int:
    """Record the control QPs of two walks, with reference solutions."""
    from benchmarks.peers.qpset import record_set, save_set

    check_output_file(file, force=force)
    problems = record_set(Narrator())
    with output_file(file, force=force) as work:
        save_set(work, problems)
    Narrator().wrote(file)
    return Status.PASS


@app.command()
def scaling(
    gait: Gait = "normal",
    most: Annotated[int, typer.Option("--most", min=2, help="Walking steps of the longest trial.")] = 1000,
    to_document: Annotated[
        bool, option("--markdown", "Write docs/data/scaling.csv and docs/images/scaling.svg as well.")
    ] = False,
) -> int:
    """Measure how cost grows with steps, degrees of freedom, points of contact, control rate and workers.

    The default takes about ten minutes on an idle machine, and 7 GB of memory.
    """
    from benchmarks.scaling import DATA, PICTURE, Sizes, draw, measure_scaling, table, write_data

    narrator = Narrator()
    sizes = Sizes()
    counts = [count for count in sizes.steps if count < most]
    rows = measure_scaling(gait, sizes._replace(steps=[*counts, most]), narrator)
    print_tables([table(gait, rows)])
    if to_document:
        write_data(rows, DATA)
        draw(rows, PICTURE)
        narrator.say("wrote docs/data/scaling.csv and docs/images/scaling.svg")
    return Status.PASS


def _write(file: Path | None, result: object, *, force: bool) -> None:
    if file is not None:
        with output_file(file, force=force) as work:
            work.write_text(dump_json(result) + "\n", encoding="utf-8")
        Narrator().wrote(file)


def main(arguments: Sequence[str]) -> int:
    """Run one command line; errors become one sentence on stderr.

    Args:
        arguments: without the program's name.

    Returns:
        The exit status, as of the command ``ampm``.
    """
    command = typer.main.get_command(app)
    try:
        with command.make_context("python -m benchmarks", list(arguments)) as context:
            return int(context.command.invoke(context) or 0)
    except typer.Exit as end:
        return end.exit_code
    except (Exception, KeyboardInterrupt) as error:
        status, text = explain(error)
        if status is Status.CRASH:
            raise
        print(f"benchmarks: {text}", file=sys.stderr)
        return status

"""Command line of ``python -m benchmarks``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ampm.run_file import PRESETS
from validation.cli.app import Status, explain
from validation.cli.console import Narrator
from validation.store.folders import check_output_file, output_file
from validation.store.json import dump_json


class Solvers(StrEnum):
    """Choices of ``--qp``."""

    OSQP = "osqp"
    DAQP = "daqp"
    BOTH = "both"


app = typer.Typer(
    name="benchmarks",
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def benchmark(
    gait: Annotated[
        str, typer.Option("--gait", help=f"Preset ({', '.join(PRESETS)}) or TOML file.", metavar="GAIT")
    ] = "normal",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one parameter; repeatable."),
    ] = None,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Walking steps of every walk.")] = 30,
    walks: Annotated[
        int, typer.Option("--walks", min=1, help="Equal walks; of every tick the least time counts.")
    ] = 3,
    qp: Annotated[Solvers, typer.Option("--qp", help="QP solver of the controller.")] = Solvers.BOTH,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write all figures as JSON as well; - for stdout alone."),
    ] = None,
    to_document: Annotated[
        bool, typer.Option("--markdown", help="Put the table into docs/benchmarks.md as well.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier FILE.")] = False,
) -> int:
    """Time planning, whole-body motion, control and physics of one gait.

    With each solver the same walk is made several times plainly, for the times of whole ticks, and several
    times with clocks in the controller, for their parts; then its physics is stepped alone. The work is the
    same every time and on one thread, so that of every tick the least time counts. The default takes about a
    minute.
    """
    # Here, not above: '--help' need not wait for simulator and Pinocchio.
    from benchmarks.run import run_benchmarks
    from benchmarks.table import print_result, update_document

    alone = json_file is not None and str(json_file) == "-"
    if json_file is not None and not alone:
        check_output_file(json_file, force=force)
    solvers = ("osqp", "daqp") if qp is Solvers.BOTH else (qp.value,)
    narrator = Narrator()
    result = run_benchmarks(gait, settings or (), steps=steps, walks=walks, solvers=solvers, stages=narrator)
    text = dump_json(result.as_dict())
    if alone:
        print(text)
    else:
        print_result(result)
    if json_file is not None and not alone:
        with output_file(json_file, force=force) as work:
            work.write_text(text + "\n", encoding="utf-8")
        narrator.say(f"wrote {json_file}")
    if to_document:
        update_document(result)
        narrator.say("wrote docs/benchmarks.md")
    return Status.PASS


def main(arguments: Sequence[str]) -> int:
    """Run one command line; errors become one sentence on stderr.

    Args:
        arguments: without the program's name; if the first is ``sweep``, sweeping is timed.

    Returns:
        The exit status, as of the command ``ampm``.
    """
    if arguments and arguments[0] == "sweep":
        from benchmarks.sweeping import app as sweeping  # loads dask

        return _call(sweeping, "python -m benchmarks sweep", arguments[1:])
    return _call(app, "python -m benchmarks", arguments)


def _call(command: typer.Typer, name: str, arguments: Sequence[str]) -> int:
    try:
        with typer.main.get_command(command).make_context(name, list(arguments)) as context:
            return int(context.command.invoke(context) or 0)
    except typer.Exit as end:
        return end.exit_code
    except (Exception, KeyboardInterrupt) as error:
        status, text = explain(error)
        if status is Status.CRASH:
            raise
        print(f"benchmarks: {text}", file=sys.stderr)
        return status

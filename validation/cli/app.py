"""The console script ``ampm``: all commands; every error becomes one sentence and an exit status.

Results go to stdout, everything else to stderr. Exit status: 0 pass, 1 out of tolerance, 2 bad input or
refused, 3 did not complete, 4 our crash, 130 interrupted. Modules that simulate are imported by the command
that needs them, so that ``ampm --help`` and ``ampm plan`` start fast.
"""

import logging
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress

import typer

import ampm
from validation.cli import body, compare, gaits, logs, studies, validate
from validation.cli.console import print_json, print_line
from validation.cli.errors import describe_error, explain
from validation.cli.options import Status, option
from validation.output import close_output, only_results
from validation.progress import interruption

app = typer.Typer(
    name="ampm",
    help="Plan the gait of the angular-momentum-inducing pendulum, walk it in MuJoCo under torque control, "
    "and measure how far physics and formula agree.",
    epilog=f"{validate.EPILOG} 'ampm judge' also has 6 partial, pass on all that was measured.",
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="rich",
)
for group in (validate, studies, compare, logs, body, gaits):
    for command in group.app.registered_commands:
        # Typer joins the lines of a docstring's first paragraph only.
        paragraphs = str(command.callback.__doc__).split("\n\n")
        command.help = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
        command.callback = only_results()(command.callback)
    app.add_typer(group.app)


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: bool = option("--version", "Print version."),
    debug: bool = option("--debug", "Show the traceback of an error; may stand anywhere."),
) -> None:
    if version:
        print_line(f"ampm {ampm.__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print_line(context.get_help())


def call(arguments: Sequence[str], commands: typer.Typer = app) -> int:
    """Run one command line; every error becomes one sentence on stderr.

    Args:
        arguments: without the program's name.
        commands: of the program, with its name.

    Returns:
        The exit status.
    """
    status = _call(arguments, commands)
    error = close_output()
    if isinstance(error, BrokenPipeError):  # the reader closed the pipe
        return Status.BROKEN_PIPE
    return status if error is None else _tell(error, commands)


def _call(arguments: Sequence[str], commands: typer.Typer) -> int:
    """Run a command as :func:`call` does; its output may not be written to its end yet."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    command = typer.main.get_command(commands)
    if debug:
        logging.basicConfig(level=logging.WARNING)
        logging.getLogger("ampm").setLevel(logging.DEBUG)
    try:
        if wrong := next((text for text in arguments if text.encode(errors="ignore").decode() != text), ""):
            raise ampm.InputError(f"the argument {wrong!r} is not UTF-8; give another name.", value=wrong)
        with command.make_context(commands.info.name, list(arguments)) as context:
            status = int(command.invoke(context) or 0)
        interruption.check()
        return status
    except typer.Exit as end:
        return end.exit_code
    except BrokenPipeError:
        return Status.BROKEN_PIPE
    except SystemExit as end:  # rich makes one of a broken pipe
        if isinstance(end.__context__, BrokenPipeError):
            return Status.BROKEN_PIPE
        raise
    except (Exception, KeyboardInterrupt) as caught:
        error: BaseException = caught
        if interruption.pending and not isinstance(error, KeyboardInterrupt):
            error = KeyboardInterrupt()  # some extensions make another error of it
            error.__cause__ = caught
        if "--json" in arguments:
            with suppress(OSError):
                print_json(describe_error(error))
        if debug or explain(error)[0] is Status.CRASH:
            traceback.print_exception(error)
        return _tell(error, commands)


def _tell(error: BaseException, commands: typer.Typer) -> int:
    """Print an error as one sentence; its exit status."""
    status, text = explain(error)
    with suppress(OSError):
        print(f"{commands.info.name}: {text}", file=sys.stderr)  # noqa: T201
    close_output()
    return status

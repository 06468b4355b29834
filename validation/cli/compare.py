"""``ampm compare``: two gaits side by side.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import (
    Force,
    Json,
    Settings,
    Status,
    Steps,
    Uncertainty,
    answer,
    option,
    with_steps,
)  # fmt: skip
from validation.show.text import print_line, print_table

if TYPE_CHECKING:
    from validation.study.compare.pair import Pair

app = typer.Typer()

_STATUS = {"completed": Status.PASS, "interrupted": Status.INTERRUPTED}


@app.command()
def compare(
    a: Annotated[
        str, typer.Argument(help="Preset, TOML file, or folder of a run.", metavar="[A]")
    ] = "normal",
    b: Annotated[str, typer.Argument(help="What it is compared with.", metavar="[B]")] = "ipm",
    settings: Settings = None,
    steps: Steps = None,
    uncertainty: Uncertainty = None,
    out: Annotated[Path | None, option("--out", "Keep the report, the numbers and the runs.", "DIR")] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Walk or load two gaits and put them side by side, at the switches of support above all.

    The default shows what continuity up to the acceleration buys: the paper's gait beside the plain inverted
    pendulum. No tolerances are judged: 0 means that both walked to the end.
    """
    from validation.study.compare.pair import compare_pair

    extra = with_steps(settings, steps)
    pair = compare_pair(a, b, extra, uncertainty=uncertainty or (), out=out, force=force, stages=Narrator())
    answer(pair, type(pair).as_dict, print_pair, as_json=as_json)
    if out is not None:
        from validation.study.compare.report import write_pair  # loads matplotlib

        write_pair(pair, out)
    return max(_STATUS.get(side.outcome, Status.NOT_COMPLETED) for side in (pair.a, pair.b))


def print_pair(pair: Pair) -> None:
    """Print both sides for a reader."""
    from validation.study.compare.report import facts, known, notes, tables  # loads matplotlib

    columns = ["", f">{pair.a.label}", f">{pair.b.label}"]
    print_table(f"{pair.a.label} and {pair.b.label}", columns, facts(pair))
    if pair.parameters:
        differ = [(key, str(one), str(two)) for key, (one, two) in pair.parameters.items()]
        print_table("parameters that differ", columns, differ)
    for group, rows in tables(pair).items():
        short = [[text.replace("% of body weight", "% of weight") for text in row] for row in rows]
        print_table(group, [*columns, "unit", ">ratio", "better"], short)
    for line in (*notes(pair), known(pair)):
        print_line(line)

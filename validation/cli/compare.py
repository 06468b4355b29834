"""``ampm compare``: two gaits side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator
from validation.cli.options import Force, Json, Settings, Status, Steps, Uncertainty, answer

app = typer.Typer()


@app.command()
def compare(
    a: Annotated[
        str, typer.Argument(help="Preset, TOML file, or folder of a run.", metavar="[A]")
    ] = "normal",
    b: Annotated[str, typer.Argument(help="What it is compared with.", metavar="[B]")] = "ipm",
    settings: Settings = None,
    steps: Steps = None,
    uncertainty: Uncertainty = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Keep the report, the numbers and the runs.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Walk or load two gaits and put them side by side, at the switches of support above all.

    The default shows what continuity up to the acceleration buys: the paper's gait beside the plain inverted
    pendulum. No tolerances are judged: 0 means that both walked to the end.
    """
    from validation.study.compare import run as pairs

    extra = [*(settings or ()), *([] if steps is None else [f"gait.steps={steps}"])]
    pair = pairs.compare_pair(
        a, b, extra, uncertainty=uncertainty or (), out=out, force=force, stages=Narrator()
    )
    answer(pair, pairs.Pair.as_dict, pairs.print_pair, as_json=as_json)
    return max(Status(code) for code in pairs.status(pair))

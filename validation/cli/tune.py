"""``ampm tune``: the values that a gait leaves open.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ampm.exceptions import InputError
from ampm.run_file import dump_run
from validation.cli.console import Narrator
from validation.cli.options import Force, Gait, Json, Settings, Status, answer, option
from validation.show.text import format_value, print_line, print_table
from validation.store.folders import check_output_file, output_file

if TYPE_CHECKING:
    from ampm.tune.tuning import Tuned
    from validation.trial.tune import TunedWalk

app = typer.Typer()


@app.command()
def tune(
    gait: Gait = "normal",
    settings: Settings = None,
    out: Annotated[
        Path | None, option("--out", "Write the complete run, for 'ampm validate'.", "FILE.toml")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Find what a gait leaves open: share of single support, roll, heights, foot timing and angles, lean.

    What the preset, the file or --set names stays as it is. An optimiser works on plan and whole-body motion
    alone; nothing is simulated. Where no choice walks, the refusal names the limit and the best it found.
    """
    from validation.trial.plan import load_request  # here, not above: NumPy and Pinocchio take long to load
    from validation.trial.tune import tune_walk

    if out is not None:
        if out.suffix != ".toml":
            raise InputError(f"{out} must end in .toml; a gait is read from such a file.")
        check_output_file(out, force=force)
    narrator = Narrator()
    walk = tune_walk(load_request(gait, settings or ()), narrator)
    if out is not None:
        margins = "".join(f"# {text}\n" for text in _margins(walk.tuned))
        with output_file(out, force=force) as work:
            head = f"# {walk.request.name}, free choices made: {', '.join(walk.tuned.found)}.\n{margins}"
            work.write_text(head + dump_run(walk.tuned.run), encoding="utf-8")
    answer(walk, describe_tuned, print_tuned, as_json=as_json)
    narrator.wrote(out)
    return Status.PASS


def describe_tuned(walk: TunedWalk) -> dict[str, Any]:
    """A tuned gait as a JSON object."""
    from ampm.tune.gait_limits import LIMITS

    tuned, margins = walk.tuned, {}
    for name, value in tuned.margins.items():
        limit = LIMITS[name]
        facts = {"what": limit.what, "value": value, "unit": limit.unit, "bound": limit.bound}
        margins[name] = facts | {"target": limit.target, "margin": limit.margin(value)}
    return {
        "gait": walk.request.name,
        "found": dict(tuned.found),
        "margins": margins,
        "tried": tuned.tried,
        "parameters": tuned.run.model_dump(),
    }


def print_tuned(walk: TunedWalk) -> None:
    """Print the choices and the tightest margins for a reader."""
    tuned = walk.tuned
    rows = [(key, format_value(value)) for key, value in tuned.found.items()]
    print_table(f"free choices of {walk.request.name}", ("key", ">value"), rows)
    count = "1 choice" if tuned.tried == 1 else f"{tuned.tried} choices"
    print_line(f"{count} tried; smallest margins:")
    for text in _margins(tuned)[:4]:
        print_line(f"  {text}")


def _margins(tuned: Tuned) -> list[str]:
    """Every margin in words, the tightest first."""
    from ampm.tune.gait_limits import LIMITS

    items = sorted(tuned.margins.items(), key=lambda item: LIMITS[item[0]].margin(item[1]))
    return [f"{LIMITS[n].what}: {LIMITS[n].quantity(value, 3)}, {LIMITS[n].rule()}" for n, value in items]

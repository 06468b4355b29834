"""Text and files of ``ampm tune``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.run_file import dump_run
from ampm.tune.gait_limits import LIMITS
from validation.show.text import format_number, print_line, print_table
from validation.store.folders import output_file

if TYPE_CHECKING:
    from ampm.tune.tuning import Tuned
    from validation.trial.tune import TunedWalk


def write_tuned(walk: TunedWalk, path: Path, *, force: bool) -> None:
    """Write the complete run as TOML, with its margins as a comment."""
    tuned = walk.tuned
    lines = [f"# {walk.request.name}, free choices made: {', '.join(tuned.found)}."]
    lines += [f"# {text}" for text in _margin_lines(tuned)]
    with output_file(path, force=force) as work:
        work.write_text("\n".join(lines) + "\n" + dump_run(tuned.run), encoding="utf-8")


def check_toml(path: Path) -> None:
    """Refuse a file that no gait could be read from again."""
    if path.suffix != ".toml":
        raise InputError(f"{path} must end in .toml; a gait is read from such a file.")


def describe_tuned(walk: TunedWalk) -> dict[str, Any]:
    """A tuned gait as a JSON object."""
    tuned = walk.tuned
    return {
        "gait": walk.request.name,
        "found": dict(tuned.found),
        "margins": {
            name: {
                "what": LIMITS[name].what,
                "value": value,
                "unit": LIMITS[name].unit,
                "bound": LIMITS[name].bound,
                "target": LIMITS[name].target,
                "margin": LIMITS[name].margin(value),
            }
            for name, value in tuned.margins.items()
        },
        "tried": tuned.tried,
        "parameters": tuned.run.model_dump(),
    }


def print_tuned(walk: TunedWalk) -> None:
    """Print the choices and the tightest margins for a reader."""
    tuned = walk.tuned
    rows = [
        (key, format_number(value, 5) if isinstance(value, float) else str(value))
        for key, value in tuned.found.items()
    ]
    print_table(f"free choices of {walk.request.name}", (("key", "left"), ("value", "right")), rows)
    count = "1 choice" if tuned.tried == 1 else f"{tuned.tried} choices"
    print_line(f"{count} tried; what is nearest to its limit:")
    for text in _margin_lines(tuned)[:4]:
        print_line(f"  {text}")


def _margin_lines(tuned: Tuned) -> list[str]:
    """Every margin in words, the tightest first."""
    order = sorted(tuned.margins, key=lambda name: LIMITS[name].margin(tuned.margins[name]))
    lines = []
    for name in order:
        limit = LIMITS[name]
        lines.append(f"{limit.what}: {limit.quantity(tuned.margins[name], 3)}, {limit.rule}")
    return lines

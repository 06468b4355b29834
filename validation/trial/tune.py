"""From a gait that names little to a complete run: what ``ampm tune`` and ``ampm validate --tune`` do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import dump_run
from ampm.tune.free_choices import FREE_KEYS, named_keys
from ampm.tune.gait_limits import LIMITS
from ampm.tune.tuning import Tuned, tune
from validation.cli.console import Silent, figure, print_line, print_table
from validation.store.folders import output_file
from validation.trial.planning import Request, make_body, motion_cache, request


def requests(gaits: Sequence[str], settings: Sequence[str]) -> list[Request]:
    """Resolve gaits that are yet to be tuned: their defaults may still be impossible.

    Raises:
        InputError: unknown gait or key, a bad value, or two gaits of one name.
    """
    resolved = [request(gait, settings) for gait in gaits]
    names = [item.name for item in resolved]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{names.count(name)} gaits are named {name!r}; give every gait once, by its own name."
            )
    return resolved


def tune_request(asked: Request, *, stages: Silent) -> Tuned:
    """Make the free choices of a gait; what a preset, a file or a setting names stays as it is.

    Raises:
        InputError: every free choice is named already.
        MathematicalRefusal, BodilyRefusal: no choice walks.
    """
    if set(FREE_KEYS) <= named_keys(asked.run):
        raise InputError(
            f"{asked.name} names every free choice, so there is nothing to tune; leave out what is to be "
            "found, for example gait.com_height."
        )
    with stages.stage(f"{asked.name}: free choices") as stage:
        return tune(asked.run, make_body(asked.run).robot, progress=stage.note, cache=motion_cache())


def write_tuned(asked: Request, tuned: Tuned, path: Path, *, force: bool) -> None:
    """Write the complete run as TOML, with its margins as a comment."""
    lines = [f"# {asked.name}, free choices made: {', '.join(tuned.found)}."]
    lines += [f"# {text}" for text in _margin_lines(tuned)]
    with output_file(path, force=force) as work:
        work.write_text("\n".join(lines) + "\n" + dump_run(tuned.run), encoding="utf-8")


def check_toml(path: Path) -> None:
    """Refuse a file that no gait could be read from again."""
    if path.suffix != ".toml":
        raise InputError(f"{path} must end in .toml; a gait is read from such a file.")


def describe_tuned(asked: Request, tuned: Tuned) -> dict[str, Any]:
    """A tuned gait as a JSON object."""
    return {
        "gait": asked.name,
        "found": dict(tuned.found),
        "margins": {
            name: {
                "what": LIMITS[name].what,
                "value": value,
                "unit": LIMITS[name].unit,
                "bound": LIMITS[name].bound,
                "comfort": LIMITS[name].comfort,
                "margin": LIMITS[name].margin(value),
            }
            for name, value in tuned.margins.items()
        },
        "tried": tuned.tried,
        "parameters": tuned.run.model_dump(),
    }


def print_tuned(asked: Request, tuned: Tuned) -> None:
    """Print the choices and the tightest margins for a reader."""
    rows = [
        (key, figure(value, 5) if isinstance(value, float) else str(value))
        for key, value in tuned.found.items()
    ]
    print_table(f"free choices of {asked.name}", (("key", "left"), ("value", "right")), rows)
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
        unit = "" if limit.unit == "1" else f" {limit.unit}"
        side = "at most" if limit.comfort < limit.bound else "at least"
        lines.append(f"{limit.what}: {tuned.margins[name]:.3g}{unit}, {side} {limit.bound:.3g}{unit}")
    return lines

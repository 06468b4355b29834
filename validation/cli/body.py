"""``ampm body list``, ``new`` and ``check``."""

from dataclasses import asdict
from pathlib import Path
from shlex import quote

import typer

from ampm.exceptions import InputError
from ampm.files import absolute
from validation.cli import options
from validation.cli.console import Narrator, print_json, print_line
from validation.cli.options import JSON, SETTINGS, Status
from validation.table import Table, format_number, format_value, print_tables, short_unit

group = typer.Typer(help="List bodies, describe a new one from its model, and check it.")
app = typer.Typer()
app.add_typer(group, name="body", rich_help_panel=options.BODIES)


@group.command(name="list")
def list_bodies(as_json: bool = JSON) -> int:
    """List the bodies that are known by name, and where their models come from."""
    from ampm.parameters import HUMAN
    from models.source import body_path, known_bodies, read_body_file

    sources = {HUMAN: "models/human.xml, scaled"}
    sources |= {name: read_body_file(body_path(name)).source for name in known_bodies() if name != HUMAN}
    if as_json:
        print_json(sources)
    else:
        print_line("\n".join(f"{name:<16}{source}" for name, source in sources.items()))
    return Status.PASS


@group.command(epilog="Exit status: 0 written, 2 bad input.")
def new(
    model: str = typer.Argument(..., help="URDF or MJCF, or PACKAGE:FILE of a package.", metavar="MODEL"),
    path: Path = typer.Argument(..., help="Description to write, a new file.", metavar="FILE.toml"),
) -> int:
    """Propose the description of a body from its model: root, trunk, feet, knees, sole, joints to lock."""
    from models.propose import propose

    if path.suffix != ".toml":
        raise InputError(f"{path} must end in .toml; name another file.")
    text = propose(model, path.parent)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise InputError(f"{str(path)!r} cannot be written ({error.strerror}); name another file.") from None
    print_line(f"{text}Wrote {path}. Correct its mistakes, then run: ampm body check {quote(str(path))}")
    return Status.PASS


@group.command(epilog="Exit status: 0 it can walk, 2 bad input, or it cannot.")
def check(
    body: str = typer.Argument(..., help="Name or description of a body.", metavar="NAME|FILE.toml"),
    settings: list[str] | None = SETTINGS,
    as_json: bool = JSON,
) -> int:
    """Check a body: its model, its torques, what it can walk.

    The torques are those of the best periodic step found. The body then stands in simulation for a second.
    """
    from validation.run.body_check import check as check_body

    found = check_body(absolute(body), tuple(settings or ()), Narrator())
    status = Status.REFUSED if found.refusal else Status.PASS
    if as_json:
        print_json(asdict(found))
        return status
    facts = [(name, format_number(n), short_unit(unit)) for name, (n, unit) in found.facts.items()]
    tables = [Table(f"body {found.name}", ("quantity", ">value", "unit"), facts, found.notes)]
    if found.torque:
        title = "largest torque as a share of its limit, in the best periodic step found"
        shares = [(name.replace("arms", "arms, head"), f"{n:.2f}") for name, n in found.torque.items()]
        tables.append(Table(title, ("joints", ">share"), shares))
    print_tables(tables)
    if found.refusal:
        print_line(f"  It cannot walk the gait that was tried: {found.refusal}")
    else:
        gait = ", ".join(f"{key} {format_value(value)}" for key, value in found.gait.items())
        print_line(f"  It can walk: {gait}.")
        values = ", ".join(f"{key} {format_value(value)}" for key, value in found.found.items())
        words = " ".join(["--body", quote(found.name), *(f"--set {quote(text)}" for text in settings or ())])
        print_line(f"  Found for it: {values}. 'ampm validate {words}' walks it.")
    return status

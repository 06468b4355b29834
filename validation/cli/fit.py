"""``ampm fit``: constants of the AMPM from a measured walk."""

from pathlib import Path

import typer

from validation.cli import options
from validation.cli.console import Narrator, print_json
from validation.cli.options import COLUMNS, Result, Status, grouped, option, print_result, read_mapping

app = typer.Typer()


@app.command(
    rich_help_panel=options.CHECK,
    epilog="Exit status: 0 fitted, 2 bad input or too few strides, 4 crash of ampm itself, 130 interrupted.",
)
@grouped
def fit(
    log: Path = typer.Argument(..., help="Table of a measured walk, or the folder of a run.", metavar="LOG"),
    *,
    columns: list[str] | None = COLUMNS,
    mass: float | None = option("--mass", "Mass of the body; by default of the mean vertical force.", "KG"),
    com_height: float | None = option(
        "--com-height", "Mean height of the COM over the floor, for a log without COM.", "M"
    ),
    result: Result,
) -> int:
    """Fit the AMPM to a measured walk, and say how much of it the AMPM explains.

    LOG is a table as 'ampm judge' takes it, of steady walking along x, with the COM or its height. 1/a, b, c,
    H and timings have 95 % intervals over the strides. They explain ZMP, ground force and angular momentum of
    other strides, beside pendulums with a resting and with a rolling ZMP (c = 1). The folder holds
    report.html, fit.json, and gait.toml for 'ampm validate', if the closed form has such a gait.

    ampm fit walk.csv --out runs/fit

    ampm fit plates.csv --com-height 0.92 --mass 71
    """
    from validation.run.fit import fit_log

    target = result.folder(f"fit-{log.stem}")
    with Narrator().stage("fit and report"):
        found = fit_log(log, columns=read_mapping(columns or ()), mass=mass, com_height=com_height)
        found.save(target, force=result.force)
    if result.as_json:
        print_json({**found.as_dict(), "directory": str(target)})
    else:
        print_result(found, as_json=False)
        Narrator().wrote(*sorted(target.iterdir()))
    return Status.PASS

"""``ampm plan``, ``ampm motion`` and ``ampm keys``: what is known before anything walks.

Commands import what plans and draws: NumPy, Pinocchio and matplotlib take long to load.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ampm.exceptions import InputError
from ampm.parameters import keys as parameter_keys
from ampm.run_file import PRESETS, key_info
from validation.cli.console import Narrator, print_json
from validation.cli.options import Force, Gait, Gaits, Json, Settings, Status, answer, option
from validation.show.text import format_number, format_value, print_line, print_table
from validation.store.folders import check_folder_of, check_output_file, output_file

if TYPE_CHECKING:
    from ampm.planner.centroidal import CentroidalPlan
    from validation.trial.plan import PlannedWalk, Request

app = typer.Typer()

MOTION_METADATA = "ampm_motion"
"""Schema metadata of a motion's Parquet file: JSON, gait to what the orbit says of itself."""

PICTURES = (".png", ".svg", ".pdf")
_PRESET_LINES = "\n\n".join(f"{name}: {meaning}" for name, meaning in PRESETS.items())
_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


@app.command(epilog=f"Presets.\n\n{_PRESET_LINES}")
def plan(
    gait: Gait = "normal",
    settings: Settings = None,
    no_body: Annotated[
        bool, option("--no-body", "Pure mathematics: no soles, no joints, mean L_y zero.")
    ] = False,
    as_json: Json = False,
    samples: Annotated[
        Path | None, option("--samples", "Write the plan's signals at k / rate.", "FILE.csv|.parquet")
    ] = None,
    rate: Annotated[float, option("--rate", "Samples per second.", "HZ")] = 200.0,
    plot: Annotated[Path | None, option("--plot", "Draw the plan.", "FILE.png")] = None,
) -> int:
    """Plan a gait in closed form: constants, residuals, samples, a picture.

    With a body (the default) the plan is checked against its soles, legs and joints, and the constant of L_y
    is the one that makes the body's motion periodic.
    """
    from ampm.planner.periodic import plan_gait
    from validation.store.tables import check_suffix, plan_table, sample_times, write_columns
    from validation.trial.plan import load_request, plan_walk

    request = load_request(gait, settings or ())
    run = request.run
    for path in (samples, plot):
        if path is not None:
            check_folder_of(path)
    if samples is not None:  # what could not be written is refused before anything is computed
        check_suffix(samples)
        sample_times(plan_gait(run.gait, run.body.mass).duration, rate)
    if plot is not None and plot.suffix not in PICTURES:
        raise InputError(f"{plot} must end in .png, .svg or .pdf; the suffix chooses the format.")
    narrator = Narrator()
    walk = None if no_body else plan_walk(request, narrator)
    planned: CentroidalPlan = plan_gait(run.gait, run.body.mass) if walk is None else walk.plan
    if samples is not None:
        with output_file(samples) as work:
            write_columns(plan_table(planned, sample_times(planned.duration, rate)), work)
    if plot is not None:
        from validation.show.plan import plot_plan

        changed = f" with {', '.join(settings)}" if settings else ""
        with output_file(plot) as work:
            plot_plan(planned, work, title=f"plan of {request.name}{changed}")
    if as_json:
        print_json(describe_plan(request, planned, walk))
    else:
        print_plan(request, planned, walk)
    narrator.wrote(samples, plot)
    return Status.PASS


def describe_plan(request: Request, plan: CentroidalPlan, walk: PlannedWalk | None = None) -> dict[str, Any]:
    """A plan as a JSON object: parameters, derived constants, residuals, and with a body its margins."""
    return {
        "gait": request.name,
        "parameters": request.run.model_dump(),
        **{field.name: getattr(plan.constants, field.name) for field in fields(plan.constants)},
        "step_duration": plan.constants.step_duration,
        "duration": plan.duration,
        "residuals": {
            field.name: getattr(plan.residuals(), field.name) for field in fields(plan.residuals())
        },
        "zmp_margin": None if walk is None else walk.zmp_margin,
        "motion": None if walk is None else walk.motion.report.as_dict(),
    }


def print_plan(request: Request, plan: CentroidalPlan, walk: PlannedWalk | None = None) -> None:
    """Print a plan for a reader."""
    rows = []
    for field in fields(plan.constants):
        unit, meaning = field.metadata["unit"], field.metadata["meaning"]
        value = format_number(getattr(plan.constants, field.name), 6)
        rows.append((field.name, value, "" if unit == "1" else str(unit), meaning))
    print_table(f"plan of {request.name}", ("constant", ">value", "unit", "meaning"), rows)
    print_line(f"largest jump at a switch, relative: {format_number(plan.residuals().largest, 2)}")
    if walk is not None:
        print_line(f"least distance of the ZMP from the edge of the support: {1000 * walk.zmp_margin:.1f} mm")
        print_line(f"least flexion of a knee: {walk.motion.report.knee_minimum.value:.3f} rad")


@app.command()
def motion(
    gaits: Gaits = None,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        option("--out", "Write one step's joints, all gaits in one.", "FILE.parquet|.csv"),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Solve the periodic whole-body motion of one step: what every joint does."""
    from validation.trial.plan import load_requests, plan_walk

    if out is not None:
        check_output_file(out, force=force)
    requests = load_requests(gaits or ["normal"], settings or ())
    narrator = Narrator()
    walks = [plan_walk(request, narrator) for request in requests]
    described = [describe_motion(walk) for walk in walks]
    if out is not None:
        write_motions(walks, out, force=force)
    if as_json:
        print_json(described)
    else:
        for item in described:
            print_motion(item)
    narrator.wrote(out)
    return Status.PASS


def describe_motion(walk: PlannedWalk) -> dict[str, Any]:
    """The report of a motion as a JSON object."""
    step = {"step_duration": walk.motion.step_duration, "step_length": walk.motion.step_length}
    return {"gait": walk.name, **step, **walk.motion.report.as_dict()}


def print_motion(described: dict[str, Any]) -> None:
    """Print the report of a motion, see :func:`describe_motion`."""
    from ampm.body.motion import MOTION_UNITS

    rows = []
    for name, value in described.items():
        if name == "multipliers":
            text = ", ".join(f"{re:.4g}{im:+.2g}i" if im else f"{re:.4g}" for re, im in value[:4])
        elif isinstance(value, dict):
            text = f"{format_number(value['value'], 5)} at {value['time']:.3f} s ({value['where']})"
        else:
            text = format_value(value)
        if name != "gait":
            rows.append((name, text, MOTION_UNITS.get(name, "")))
    print_table(f"motion of {described['gait']}, one step", ("quantity", "value", "unit"), rows)


def write_motions(walks: list[PlannedWalk], path: Path, *, force: bool) -> None:
    """Write one step of every motion into one table, whose column ``gait`` names them."""
    import numpy as np

    from validation.store.tables import check_suffix, write_columns

    check_suffix(path)
    tables = []
    for walk in walks:
        table = walk.motion.table()
        tables.append({"gait": np.full(len(table["time"]), walk.name, dtype=object), **table})
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    reports = json.dumps({walk.name: describe_motion(walk) for walk in walks})
    with output_file(path, force=force) as work:
        write_columns(columns, work, {MOTION_METADATA: reports})


@app.command()
def keys(gait: Gait = "normal", settings: Settings = None, as_json: Json = False) -> int:
    """List every parameter: its value in a gait, unit, bounds and meaning.

    Any of them can be given as --set KEY=VALUE, in a gait's TOML file, and varied by a sweep.
    """
    from validation.trial.plan import load_request

    answer(load_request(gait, settings or ()), describe_keys, print_keys, as_json=as_json)
    return Status.PASS


def describe_keys(request: Request) -> list[dict[str, Any]]:
    """All parameters as JSON objects: key, value in this gait, default, unit, bounds and meaning."""
    values = request.run.model_dump()
    described = []
    for info in map(key_info, parameter_keys()):
        section, name = info.key.split(".")
        limits = [f"{_SIGNS[comparison]} {limit:g}" for comparison, limit in info.bounds.items()]
        described.append(
            {
                "key": info.key,
                "value": values[section][name],
                "default": info.default,
                "unit": "" if info.unit == "1" else info.unit,
                "bounds": ", ".join(limits) or " | ".join(info.options),
                "meaning": info.meaning,
            }
        )
    return described


def print_keys(request: Request) -> None:
    """Print all parameters, section by section."""
    rows: dict[str, list[list[str]]] = {}
    for item in describe_keys(request):
        rows.setdefault(item["key"].partition(".")[0], []).append([str(value) for value in item.values()])
    for section, cells in rows.items():
        columns = ("key", "value", "default", "unit", "bounds", "meaning")
        print_table(f"{section} of {request.name}", columns, cells)

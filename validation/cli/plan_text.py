"""Text and files of ``ampm plan``, ``ampm motion`` and ``ampm keys``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.body.motion import MOTION_UNITS
from ampm.exceptions import InputError
from ampm.parameters import RunParameters, keys
from ampm.planner.centroidal import PlanConstants
from ampm.planner.periodic import plan_gait
from ampm.planner.support import AnyPlan
from ampm.run_file import key_info
from validation.show.text import format_number, print_line, print_table
from validation.store.folders import output_file
from validation.store.tables import check_suffix, plan_table, sample_times, write_columns

if TYPE_CHECKING:
    from validation.trial.plan import PlannedWalk, Request

MOTION_METADATA = "ampm_motion"
"""Schema metadata of a motion's Parquet file: JSON, gait to what the orbit says of itself."""


def describe(request: Request, plan: AnyPlan, walk: PlannedWalk | None = None) -> dict[str, Any]:
    """A plan as a JSON object: parameters, derived constants, residuals, and with a body its margins."""
    constants = plan.constants
    residuals = plan.residuals()
    return {
        "gait": request.name,
        "parameters": request.run.model_dump(),
        **{field.name: getattr(constants, field.name) for field in fields(constants)},
        "step_duration": constants.step_duration,
        "duration": plan.duration,
        "residuals": {field.name: getattr(residuals, field.name) for field in fields(residuals)},
        "zmp_margin": None if walk is None else walk.zmp_margin,
        "motion": None if walk is None else walk.motion.report.as_dict(),
    }


def print_plan(request: Request, plan: AnyPlan, walk: PlannedWalk | None = None) -> None:
    """Print a plan for a reader."""
    described = describe(request, plan, walk)

    def unit(item: Field[Any]) -> str:
        return "" if item.metadata["unit"] == "1" else str(item.metadata["unit"])

    rows = [
        (item.name, format_number(described[item.name], 6), unit(item), item.metadata["meaning"])
        for item in fields(PlanConstants)
    ]
    print_table(
        f"plan of {request.name}",
        (("constant", "left"), ("value", "right"), ("unit", "left"), ("meaning", "left")),
        rows,
    )
    print_line(f"largest jump at a switch, relative: {format_number(plan.residuals().largest, 2)}")
    if walk is not None:
        print_line(f"least distance of the ZMP from the edge of the support: {1000 * walk.zmp_margin:.1f} mm")
        print_line(f"least flexion of a knee: {walk.motion.report.knee_minimum.value:.3f} rad")


def describe_motions(walks: Sequence[PlannedWalk]) -> list[dict[str, Any]]:
    """Motions as JSON objects."""
    return [describe_motion(walk) for walk in walks]


def print_motions(walks: Sequence[PlannedWalk]) -> None:
    """Print motions for a reader."""
    for walk in walks:
        print_motion(walk)


def describe_motion(walk: PlannedWalk) -> dict[str, Any]:
    """The report of a motion as a JSON object."""
    return {
        "gait": walk.name,
        "step_duration": walk.motion.step_duration,
        "step_length": walk.motion.step_length,
        **walk.motion.report.as_dict(),
    }


def print_motion(walk: PlannedWalk) -> None:
    """Print the report of a motion."""
    rows = []
    for name, value in describe_motion(walk).items():
        if name == "gait":
            continue
        if name == "multipliers":
            text = ", ".join(f"{re:.4g}{im:+.2g}i" if im else f"{re:.4g}" for re, im in value[:4])
        elif isinstance(value, dict):
            text = f"{format_number(value['value'], 5)} at {value['time']:.3f} s ({value['where']})"
        else:
            text = format_number(value, 5) if isinstance(value, float) else str(value)
        rows.append((name, text, MOTION_UNITS.get(name, "")))
    columns = (("quantity", "left"), ("value", "left"), ("unit", "left"))
    print_table(f"motion of {walk.name}, one step", columns, rows)


def check_samples(path: Path, run: RunParameters, rate: float) -> None:
    """Refuse a table that could not be written, before anything is computed."""
    check_suffix(path)
    sample_times(plan_gait(run.gait, run.body.mass).duration, rate)


def write_samples(plan: AnyPlan, path: Path, rate: float) -> None:
    """Write a plan's signals at k / rate."""
    columns = plan_table(plan, sample_times(plan.duration, rate))
    with output_file(path) as work:
        write_columns(columns, work)


def check_picture(path: Path) -> None:
    """Refuse a picture that could not be written."""
    if path.suffix not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path} must end in .png, .svg or .pdf; the suffix chooses the format.")


def write_picture(name: str, plan: AnyPlan, path: Path, settings: Sequence[str] = ()) -> None:
    """Draw a plan, under the gait's name and what was changed in it."""
    from validation.show.plan import plot_plan

    with output_file(path) as work:
        plot_plan(plan, work, title=f"plan of {name}" + (f" with {', '.join(settings)}" if settings else ""))


def write_motions(walks: Sequence[PlannedWalk], path: Path, *, force: bool) -> None:
    """Write one step of every motion into one table, whose column ``gait`` tells them apart."""
    check_suffix(path)
    tables = []
    for walk in walks:
        table = walk.motion.table()
        tables.append({"gait": np.full(len(table["time"]), walk.name, dtype=object), **table})
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    reports = json.dumps({walk.name: describe_motion(walk) for walk in walks})
    with output_file(path, force=force) as work:
        write_columns(columns, work, {MOTION_METADATA: reports})


_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def describe_keys(request: Request) -> list[dict[str, Any]]:
    """All parameters as JSON objects: key, value in this gait, default, unit, bounds and meaning."""
    values = request.run.model_dump()
    described = []
    for info in map(key_info, keys()):
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
    columns = [(name, "left") for name in ("key", "value", "default", "unit", "bounds", "meaning")]
    rows: dict[str, list[list[str]]] = {}
    for item in describe_keys(request):
        cells = [str(item[name]).replace("[", "\\[") for name, _ in columns]
        rows.setdefault(item["key"].partition(".")[0], []).append(cells)
    for section, cells_of in rows.items():
        print_table(f"{section} of {request.name}", columns, cells_of)

"""``ampm plan``, ``motion``, ``keys`` and ``tune``: commands that simulate nothing.

Commands import what they run: NumPy, Pinocchio and matplotlib take long to load.
"""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ampm.exceptions import InputError
from ampm.presets import PRESETS
from validation.cli.console import Narrator
from validation.cli.options import (
    AsIs,
    Body,
    Footsteps,
    Force,
    Gait,
    Gaits,
    Json,
    PlannerName,
    Settings,
    Status,
    answer,
    check_picture,
    option,
    with_footsteps,
    with_short,
)
from validation.show.text import format_number, format_value, print_line, print_table
from validation.store.folders import check_folder_of, check_output_file, output_file

if TYPE_CHECKING:
    from ampm.planner.centroidal import CentroidalPlan
    from ampm.tune.tuning import Tuned
    from validation.trial.plan import PlannedWalk, Request

app = typer.Typer()

MOTION_METADATA = "ampm_motion"
"""Schema metadata of a motion's Parquet file: JSON, gait to the report of its orbit."""

_PRESET_LINES = "\n\n".join(f"{name}: {meaning}" for name, meaning in PRESETS.items())
_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


@app.command(epilog=f"Presets.\n\n{_PRESET_LINES}")
def plan(
    gait: Gait = None,
    settings: Settings = None,
    as_is: AsIs = False,
    no_body: Annotated[
        bool, option("--no-body", "Closed form alone: no soles, no joints, mean L_y zero; implies --as-is.")
    ] = False,
    planner: PlannerName = None,
    body: Body = None,
    as_json: Json = False,
    samples: Annotated[
        Path | None, option("--samples", "Write the plan's signals at k / rate.", "FILE.csv|.parquet")
    ] = None,
    rate: Annotated[float | None, option("--rate", "Samples per second; 200 if not given.", "HZ")] = None,
    plot: Annotated[Path | None, option("--plot", "Draw the plan.", "FILE.png")] = None,
    footsteps: Footsteps = None,
) -> int:
    """Plan a gait in closed form: constants, residuals, samples, a picture.

    With a body (the default) the plan is checked against its soles, legs and joints, and the constant of L_y
    is the one that makes the body's motion periodic.

    With --footsteps the gait gives height, slopes of the force line and durations of the supports. The first
    two rows of the file are where both feet stand, the one that swings first at the head; then left and right
    land in turn. It is the plan that 'ampm validate' walks, refusals included.
    """
    from ampm.planner.periodic import plan_gait
    from validation.store.tables import plan_table, sample_times, write_columns
    from validation.trial.columns import check_suffix
    from validation.trial.plan import check_formula, load_request, plan_walk

    extra = with_short(settings, body=body, planner=planner)
    request = load_request(gait, extra, as_is=as_is or no_body, sections=with_footsteps(footsteps))
    run = request.run
    if rate is not None and samples is None:
        raise InputError("--rate is that of the samples; give --samples FILE, too, or leave it out.")
    rate = 200.0 if rate is None else rate
    if samples is not None:  # refuse paths that cannot be written before computing
        check_folder_of(samples)
        check_suffix(samples)
        check_formula(request)
        count = len(run.footsteps) or run.gait.steps
        sample_times(count * run.gait.step_length / run.gait.switching_velocity, rate)
    if plot is not None:
        check_picture(plot)
    if no_body and (run.gait.planner != "ampm" or run.footsteps):
        raise InputError("another planner, or footsteps, need a body; leave out --no-body.")
    narrator = Narrator()
    walk = None if no_body else plan_walk(request, narrator)
    planned: CentroidalPlan = plan_gait(run.gait, run.body.mass) if walk is None else walk.plan
    sole = walk.plan.feet.sole if walk is not None and run.footsteps else None
    request = request if walk is None else walk.request
    if samples is not None:
        with output_file(samples) as work:
            write_columns(plan_table(planned, sample_times(planned.duration, rate)), work)
    if plot is not None:
        from validation.show.plan import plot_plan

        title = f"plan of {request.title}" + ("" if footsteps is None else f" over {footsteps.name}")
        plot_plan(planned, plot, title=title, sole=sole)
    answer(
        planned,
        lambda planned: describe_plan(request, planned, walk),
        lambda planned: print_plan(request, planned, walk),
        as_json=as_json,
    )
    narrator.wrote(samples, plot)
    return Status.PASS


def describe_plan(request: Request, plan: CentroidalPlan, walk: PlannedWalk | None = None) -> dict[str, Any]:
    """A plan as a JSON object: parameters, derived constants, residuals, and with a body its margins."""
    return {
        "gait": request.name,
        "parameters": request.run.model_dump(),
        **asdict(plan.constants),
        "step_duration": plan.constants.step_duration,
        "duration": plan.duration,
        "residuals": plan.residuals(),
        "zmp_margin": None if walk is None else walk.zmp_margin,
        "motion": None if walk is None else walk.plan.posture.report(),
    }


def print_plan(request: Request, plan: CentroidalPlan, walk: PlannedWalk | None = None) -> None:
    """Print a plan for a reader."""
    rows = []
    for field in fields(plan.constants):
        unit, meaning = field.metadata["unit"], field.metadata["meaning"]
        value = format_number(getattr(plan.constants, field.name), 6)
        rows.append((field.name, value, "" if unit == "1" else str(unit), meaning))
    print_table(f"plan of {request.title}", ("constant", ">value", "unit", "meaning"), rows)
    print_line(f"{plan.contacts.steps} steps in {plan.duration:.2f} s")
    print_line(f"largest jump at a switch, relative: {format_number(plan.residuals().largest, 2)}")
    if walk is not None:
        print_line(f"planned ZMP margin, to the edge of the planned support: {1000 * walk.zmp_margin:.1f} mm")
    if walk is not None and walk.plan.posture.report():
        report = walk.motion.report
        print_line(f"least flexion of a knee: {report.knee_minimum.value:.3f} rad")
        closest = report.clearance
        print_line(f"closest parts of the body: {1000 * closest.value:.1f} mm ({closest.where})")


@app.command()
def motion(
    gaits: Gaits = None,
    settings: Settings = None,
    as_is: AsIs = False,
    out: Annotated[
        Path | None, option("--out", "Write one step's joints, all gaits in one.", "FILE.parquet|.csv")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Solve the periodic whole-body motion of one step: the motion of every joint."""
    from validation.trial.columns import check_suffix
    from validation.trial.plan import load_requests, plan_walk

    if out is not None:
        check_suffix(out)
        check_output_file(out, force=force)
    requests = load_requests(gaits or [None], settings or (), as_is=as_is)
    narrator = Narrator()
    walks = [plan_walk(request, narrator) for request in requests]
    if out is not None:
        write_motions(walks, out, force=force)
    answer([describe_motion(walk) for walk in walks], list, print_motions, as_json=as_json)
    narrator.wrote(out)
    return Status.PASS


def describe_motion(walk: PlannedWalk) -> dict[str, Any]:
    """The report of a motion as a JSON object."""
    step = {"step_duration": walk.motion.step_duration, "step_length": walk.motion.step_length}
    return {"gait": walk.name, **step, **walk.motion.report.as_dict()}


def print_motions(motions: list[dict[str, Any]]) -> None:
    """Print the reports of motions, see :func:`describe_motion`."""
    from ampm.body.motion import MOTION_UNITS

    for described in motions:
        rows = []
        for name, value in described.items():
            if name == "multipliers":
                text = ", ".join(f"{re:.4g}{im:+.2g}i" if im else f"{re:.4g}" for re, im in value[:4])
            elif isinstance(value, dict):
                text = f"{format_number(value['value'], 5)} at {value['time']:.3f} s ({value['where']})"
            else:
                text = format_value(value)
            rows.append((name, text, MOTION_UNITS.get(name, "")))
        # The first row is the gait.
        print_table(f"motion of {described['gait']}, one step", ("quantity", "value", "unit"), rows[1:])


def write_motions(walks: list[PlannedWalk], path: Path, *, force: bool) -> None:
    """Write one step of every motion into one table, whose column ``gait`` names them."""
    import numpy as np

    from validation.store.tables import write_columns

    tables = []
    for walk in walks:
        table = walk.motion.table()
        tables.append({"gait": np.full(len(table["time"]), walk.name, dtype=object), **table})
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    reports = json.dumps({walk.name: describe_motion(walk) for walk in walks})
    with output_file(path, force=force) as work:
        write_columns(columns, work, {MOTION_METADATA: reports})


@app.command()
def keys(gait: Gait = None, settings: Settings = None, as_json: Json = False) -> int:
    """List every parameter: its value in a gait, unit, bounds and meaning.

    Any of them can be given as --set KEY=VALUE, in a gait's TOML file, and varied by a sweep.
    """
    from validation.trial.plan import load_request

    answer(load_request(gait, settings or ()), describe_keys, print_keys, as_json=as_json)
    return Status.PASS


def describe_keys(request: Request) -> list[dict[str, Any]]:
    """All parameters as JSON objects: key, value in this gait, default, unit, bounds and meaning."""
    from ampm.parameters import keys
    from ampm.run_file import key_info

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
    described = describe_keys(request)
    for section in dict.fromkeys(item["key"].partition(".")[0] for item in described):
        own = [item for item in described if item["key"].startswith(f"{section}.")]
        rows = [[str(value) for value in item.values()] for item in own]
        print_table(f"{section} of {request.name}", list(own[0]), rows)


@app.command()
def tune(
    gait: Gait = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, option("--out", "Write the complete run, for 'ampm validate'.", "FILE.toml")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Find what a gait leaves open: share of single support, roll, heights, foot timing and angles, lean.

    Values that the file or --set gives are kept, and so are step, speed, c_s, c_y and body of a preset.
    Commands that plan a changed gait do the same; this one also shows the margins. An optimiser evaluates
    plan and whole-body motion; nothing is simulated. If no choice can be walked, the refusal names the limit
    and the best value found.
    """
    from ampm.run_file import dump_run
    from validation.trial.plan import load_request, tune_walk

    if out is not None:
        if out.suffix != ".toml":
            raise InputError(f"{out} must end in .toml; a gait is read from such a file.")
        check_output_file(out, force=force)
    narrator = Narrator()
    walk, tuned = tune_walk(load_request(gait, settings or ()), narrator)
    if out is not None:
        margins = "".join(f"# {text}\n" for text in _margins(tuned))
        with output_file(out, force=force) as work:
            head = f"# {walk.name}, found: {', '.join(tuned.found)}.\n{margins}"
            work.write_text(head + dump_run(walk.run), encoding="utf-8")
    answer(
        tuned,
        lambda tuned: describe_tuned(walk.name, tuned),
        lambda tuned: print_tuned(walk.name, tuned),
        as_json=as_json,
    )
    narrator.wrote(out)
    return Status.PASS


def describe_tuned(name: str, tuned: Tuned) -> dict[str, Any]:
    """A tuned gait as a JSON object."""
    from ampm.tune.gait_limits import LIMITS

    margins = {}
    for key, value in tuned.margins.items():
        limit = LIMITS[key]
        facts = {"what": limit.what, "value": value, "unit": limit.unit, "bound": limit.bound}
        margins[key] = facts | {"target": limit.target, "margin": limit.margin(value)}
    return {
        "gait": name,
        "found": dict(tuned.found),
        "margins": margins,
        "tried": tuned.tried,
        "parameters": tuned.run.model_dump(),
    }


def print_tuned(name: str, tuned: Tuned) -> None:
    """Print the choices and the tightest margins for a reader."""
    rows = [(key, format_value(value)) for key, value in tuned.found.items()]
    print_table(f"found for {name}", ("key", ">value"), rows)
    count = "1 choice" if tuned.tried == 1 else f"{tuned.tried} choices"
    print_line(f"{count} tried; smallest margins:")
    for text in _margins(tuned)[:4]:
        print_line(f"  {text}")


def _margins(tuned: Tuned) -> list[str]:
    """Every margin as text, the tightest first."""
    from ampm.tune.gait_limits import LIMITS

    items = sorted(tuned.margins.items(), key=lambda item: LIMITS[item[0]].margin(item[1]))
    return [f"{LIMITS[n].what}: {LIMITS[n].quantity(value, 3)}, {LIMITS[n].rule()}" for n, value in items]

"""``ampm plan`` and ``ampm keys``: commands that simulate nothing."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ampm.exceptions import InputError
from ampm.presets import PRESETS
from validation.cli import options
from validation.cli.console import Narrator, print_json, print_line
from validation.cli.options import Status, grouped, option
from validation.store.folders import check_new_file, output_file
from validation.table import Table, format_number, format_value, print_tables, short_unit

if TYPE_CHECKING:
    from ampm.planner.centroidal import CentroidalPlan
    from ampm.tune.tuning import Tuned
    from validation.trial.plan import PlannedWalk, Request

app = typer.Typer()

RATE = 200.0
"""Usual samples of a plan per second."""

_PRESET_LINES = "\n\n".join(f"{name}: {meaning}" for name, meaning in PRESETS.items())


@dataclass(frozen=True)
class Files:
    """What a plan is written into."""

    save: Path | None = option("--save", "Write the complete gait, with the values found.", "FILE.toml")
    force: bool = option("--force", "Replace earlier files.")
    samples: Path | None = option("--samples", "Write the plan's signals.", "FILE.csv|.parquet")
    rate: float = option("--rate", "Samples per second.", "HZ", default=RATE)
    motion: Path | None = option(
        "--motion", "Write the joints over one step of the whole-body motion.", "FILE.csv|.parquet"
    )
    plot: Path | None = option("--plot", "Draw the plan.", "FILE.png")

    def check(self) -> None:
        """Raise InputError for files that must not be written, before anything is computed."""
        if self.rate != RATE and self.samples is None:
            raise InputError("--rate needs --samples FILE; give it, too, or leave --rate out.")
        named = [path.resolve() for path in (self.save, self.samples, self.motion, self.plot) if path]
        if len(set(named)) < len(named):
            raise InputError(f"{' and '.join(map(str, named))}: give every file its own name.")
        for table in filter(None, (self.samples, self.motion)):
            check_new_file(table, ".csv", ".parquet", force=self.force)
        if self.plot is not None:
            check_new_file(self.plot, ".png", ".svg", ".pdf", force=self.force)
        if self.save is not None:
            check_new_file(self.save, ".toml", force=self.force)


@app.command(rich_help_panel=options.BODIES, epilog=f"Presets.\n\n{_PRESET_LINES}")
@grouped
def plan(
    gait: str | None = options.GAIT,
    *,
    walk: options.WalkOptions,
    no_body: bool = option("--no-body", "Closed form, no soles or joints, mean L_y 0; implies --as-is."),
    length: options.Length,
    as_json: bool = options.JSON,
    files: Files,
) -> int:
    """Plan a gait without walking it: constants, motion, picture.

    This is the plan that 'ampm validate' walks, refusals included. It is checked against soles, legs and
    joints of the body, and the constant of L_y makes the body's motion periodic. If gait or body differ from
    a preset's, open values are found and printed with the tightest margins; given values stay.

    With --footsteps the gait gives height, slopes of the force line and durations of the supports. The first
    two rows of the file say where both feet stand; the foot of row 1 swings first. Then left and right land
    in turn.
    """
    from ampm.parameters import NO_PLAN
    from ampm.planner.closed_form import LIPM
    from ampm.planner.periodic import plan_gait
    from ampm.planner.table import plan_table, sample_times
    from ampm.run_file import dump_run
    from validation.store.tables import write_columns
    from validation.trial.plan import plan_walk

    files.check()
    request = walk.request(gait, length.steps, as_is=walk.as_is or no_body, sections=length.sections())
    run = request.run
    commanded = any(key.startswith("command.") for key in request.changed)
    if no_body and (run.gait.planner not in ("ampm", LIPM) or run.footsteps or commanded):
        raise InputError("another planner, footsteps or a command need a body; leave out --no-body.")
    if files.motion is not None and (no_body or run.footsteps):
        raise InputError("--motion is of a periodic gait of a body; leave out --no-body and footsteps.")
    narrator = Narrator()
    walked = None if no_body else plan_walk(request, narrator)
    planned: CentroidalPlan = plan_gait(run.gait, run.body.mass) if walked is None else walked.plan
    times = None if files.samples is None else sample_times(planned.duration, files.rate)
    margin = tuned = posture = None
    if walked is not None:
        request, tuned, posture = walked.request, walked.tuned, walked.plan.posture
        margin = walked.plan.least_zmp_margin()
    if files.save is not None:
        notes = [request.title, *(() if tuned is None else _margins(tuned))]
        with output_file(files.save, force=files.force) as work:
            lines = "".join(f"# {note}\n" for note in notes)
            work.write_text(lines + dump_run(request.run), encoding="utf-8")
    if files.samples is not None and times is not None:
        with narrator.stage("samples"), output_file(files.samples) as work:
            write_columns(plan_table(planned, times), work)
    if files.motion is not None and walked is not None:
        with output_file(files.motion) as work:
            write_columns(walked.motion.table(), work)
    if files.plot is not None:
        from validation.show.plan import plot_plan

        title = f"plan of {request.title}" + (f" over {length.footsteps.name}" if length.footsteps else "")
        plot_plan(planned, files.plot, title=title)
    if as_json:
        described = {
            "gait": request.name,
            "parameters": request.run.model_dump(),
            **asdict(planned.constants),
            "step_duration": planned.constants.step_duration,
            "duration": planned.duration,
            "residuals": planned.residuals(),
            "zmp_margin": None if margin is None else margin[0],
            "motion": None if posture is None else posture.report(),
            "found": None if tuned is None else dict(tuned.values),
            "margins": None if tuned is None else dict(tuned.margins),
        }
        print_json(described)
    elif run.gait.planner == NO_PLAN:
        print_line("planner none has no plan: the trial starts with the body standing.")
    else:
        print_tables(plan_tables(request, planned, walked, margin))
    narrator.wrote(files.save, files.samples, files.motion, files.plot)
    return Status.PASS


def plan_tables(
    request: Request, plan: CentroidalPlan, walk: PlannedWalk | None, margin: tuple[float, float] | None
) -> list[Table]:
    """A plan for a reader: constants, and the values found."""
    from ampm.body.limits import CLEARANCE, KNEE_MINIMUM, ROLL_TOLERANCE

    rows = []
    for field in fields(plan.constants):
        unit, meaning = field.metadata["unit"], field.metadata["meaning"]
        value = format_number(getattr(plan.constants, field.name), 6)
        rows.append((field.name, value, short_unit(unit), meaning))
    notes = [
        f"{plan.contacts.steps} step{'s' * (plan.contacts.steps != 1)} in {plan.duration:.2f} s",
        f"largest jump at a switch, relative: {format_number(max(plan.residuals().values()), 2)}",
    ]
    if request.run.footsteps:
        notes.append("the constants are those of the gait's equal steps; footsteps differ in length and time")
    report = {} if walk is None else walk.plan.posture.report()
    if margin is not None:
        millimetres = round(1000 * margin[0], 1) + 0.0  # without a sign of zero
        when = f"{margin[1]:.3f} s, {plan.sample(margin[1]).phase_name[0].replace('_', ' ')}"
        rolls = ": a heel rises as the ZMP reaches the ball" if abs(margin[0]) < ROLL_TOLERANCE else ""
        notes.append(
            f"planned ZMP margin, to the edge of the planned support: {millimetres:.1f} mm ({when}{rolls})"
        )
    if report:
        knee, clearance = report["knee_minimum"], report["clearance"]
        distance = f"{1000 * clearance['value']:.1f} mm ({clearance['where']})"
        notes.append(f"least flexion of a knee: {knee['value']:.3f} rad, at least {KNEE_MINIMUM:g} rad")
        notes.append(f"least distance of two parts of the body: {distance}, at least {1000 * CLEARANCE:g} mm")
    tables = [Table(f"plan of {request.title}", ("constant", ">value", "unit", "meaning"), rows, notes)]
    if walk is not None and walk.tuned is not None:
        from ampm.run_file import key_info

        values = walk.tuned.values.items()
        found = [(key, format_value(value), short_unit(key_info(key).unit)) for key, value in values]
        notes = ["tightest margins:", *(f"  {text}" for text in _margins(walk.tuned)[:4])]
        tables.append(Table(f"found for {request.name}", ("key", ">value", "unit"), found, notes))
    return tables


def _margins(tuned: Tuned) -> list[str]:
    """Every margin as text, the tightest first, but for those of knees and distances.

    Of these two the search has values on its coarse grid, and of distances only up to its target. The motion
    of the plan has better ones.
    """
    from ampm.body.limits import LIMITS

    own = [item for item in tuned.margins.items() if item[0] not in ("knee", "gap")]
    items = sorted(own, key=lambda item: LIMITS[item[0]].margin(item[1]))
    return [f"{LIMITS[n].what}: {LIMITS[n].quantity(value, 3)}, {LIMITS[n].rule()}" for n, value in items]


@app.command(rich_help_panel=options.BODIES)
def keys(
    words: list[str] | None = typer.Argument(None, help="Sections and words; all if none.", metavar="WORD"),
    gait: str | None = option("--gait", "Show the values of a preset or TOML file; normal if none.", "GAIT"),
    settings: list[str] | None = options.SETTINGS,
    as_json: bool = options.JSON,
) -> int:
    """List parameters: all, a section's, or those with a word.

    A WORD that names a section keeps the keys of this section. Any other WORD, and planner, keeps the keys
    that have it in their name or meaning. Several words narrow the list: 'ampm keys controller swing'.

    Every key is shown with its value in a gait, unit, bounds and meaning, and its default where the value is
    another one. Each can be given as --set KEY=VALUE or in a gait's TOML file; a sweep varies most.
    """
    from ampm.run_file import find_keys
    from validation.trial.plan import load_request

    request = load_request(gait, settings or (), walked=False)
    found = [
        {
            "key": info.key,
            "value": request.run.value(info.key),
            "default": info.default,
            "unit": short_unit(info.unit),
            "bounds": info.range,
            "meaning": info.meaning,
        }
        for info in find_keys(*words or ())
    ]
    if as_json:
        print_json(found)
        return Status.PASS
    for section, items in groupby(found, lambda item: item["key"].partition(".")[0]):
        rows = []
        for item in items:
            default = "" if item["value"] == item["default"] else f"default {item['default']}"
            more = "; ".join(filter(None, [item["bounds"], default]))
            meaning = item["meaning"] + (f" [{more}]" if more else "")
            rows.append((item["key"], str(item["value"]), item["unit"], meaning))
        print_tables([Table(f"{section} of {request.name}", ("key", ">value", "unit", "meaning"), rows)])
    return Status.PASS

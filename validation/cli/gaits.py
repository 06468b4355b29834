"""``ampm plan`` and ``ampm keys``: commands that simulate nothing."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

    @property
    def paths(self) -> tuple[Path | None, ...]:
        """All files, None for one that was not asked for."""
        return self.save, self.samples, self.motion, self.plot

    def check(self) -> None:
        """Raise InputError for files that must not be written, before anything is computed."""
        if self.rate != RATE and self.samples is None:
            raise InputError("--rate needs --samples FILE; give it, too, or leave --rate out.")
        named = [path.resolve() for path in self.paths if path]
        if len(set(named)) < len(named):
            raise InputError(f"{' and '.join(map(str, named))}: give every file its own name.")
        table, picture = (".csv", ".parquet"), (".png", ".svg", ".pdf")
        for path, suffixes in zip(self.paths, ((".toml",), table, table, picture), strict=True):
            if path is not None:
                check_new_file(path, *suffixes, force=self.force)

    def write(
        self, request: Request, plan: CentroidalPlan, planned: PlannedWalk | None, narrator: Narrator
    ) -> None:
        """Write the files of a plan; without a body there is no planned walk."""
        from ampm.planner.table import plan_table, sample_times
        from ampm.run_file import dump_run
        from validation.store.record import write_columns

        if self.samples is not None:
            times = sample_times(plan.duration, self.rate)  # refuses a rate before anything is written
            with narrator.stage("samples"), output_file(self.samples, force=self.force) as work:
                write_columns(plan_table(plan, times), work)
        if self.motion is not None and planned is not None:
            with output_file(self.motion, force=self.force) as work:
                write_columns(planned.motion.table(), work)
        if self.save is not None:
            notes = [request.title, *(_margins(planned.tuned) if planned and planned.tuned else ())]
            text = "".join(f"# {note}\n" for note in notes) + dump_run(request.run)
            with output_file(self.save, force=self.force) as work:
                work.write_text(text, encoding="utf-8")


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
    planned = None if no_body else plan_walk(request, narrator)
    request = request if planned is None else planned.request
    found: CentroidalPlan = plan_gait(run.gait, run.body.mass) if planned is None else planned.plan
    files.write(request, found, planned, narrator)
    if files.plot is not None:
        from validation.show.plan import plot_plan

        title = f"plan of {request.title}" + (f" over {length.footsteps.name}" if length.footsteps else "")
        plot_plan(found, files.plot, title=title)
    if as_json:
        print_json(plan_values(request, found, planned))
    elif run.gait.planner == NO_PLAN:
        print_line("planner none has no plan: the trial starts with the body standing.")
    else:
        print_tables(plan_tables(request, found, planned))
    narrator.wrote(*files.paths)
    return Status.PASS


def plan_values(request: Request, plan: CentroidalPlan, planned: PlannedWalk | None) -> dict[str, Any]:
    """A plan in SI units, for ``--json``; None is what a plan without a body, or without a search, lacks."""
    tuned = None if planned is None else planned.tuned
    return {
        "gait": request.name,
        "parameters": request.run.model_dump(),
        **asdict(plan.constants),
        "step_duration": plan.constants.step_duration,
        "duration": plan.duration,
        "residuals": plan.residuals(),
        "zmp_margin": None if planned is None else planned.plan.least_zmp_margin()[0],
        "motion": None if planned is None else planned.plan.posture.report(),
        "found": None if tuned is None else dict(tuned.values),
        "margins": None if tuned is None else dict(tuned.margins),
    }


def plan_tables(request: Request, plan: CentroidalPlan, planned: PlannedWalk | None) -> list[Table]:
    """A plan for a reader: constants, and the values found."""
    from ampm.body.limits import CLEARANCE, KNEE_MINIMUM, ROLL_TOLERANCE

    constants = vars(plan.constants)
    rows = [
        (f.name, format_number(constants[f.name], 6), short_unit(f.metadata["unit"]), f.metadata["meaning"])
        for f in fields(plan.constants)
    ]
    notes = [
        f"{plan.contacts.steps} step{'s' * (plan.contacts.steps != 1)} in {plan.duration:.2f} s",
        f"largest jump at a switch, relative: {format_number(max(plan.residuals().values()), 2)}",
    ]
    if request.run.footsteps:
        notes.append("the constants are those of the gait's equal steps; footsteps differ in length and time")
    if planned is not None:
        margin, when = planned.plan.least_zmp_margin()
        millimetres = round(1000 * margin, 1) + 0.0  # without a sign of zero
        phase = plan.sample(when).phase_name[0].replace("_", " ")
        rolls = ": a heel rises as the ZMP reaches the ball" if abs(margin) < ROLL_TOLERANCE else ""
        notes.append(
            f"planned ZMP margin, to the edge of the planned support: {millimetres:.1f} mm "
            f"({when:.3f} s, {phase}{rolls})"
        )
        if report := planned.plan.posture.report():
            knee, clearance = report["knee_minimum"], report["clearance"]
            distance = f"{1000 * clearance['value']:.1f} mm ({clearance['where']})"
            notes += [
                f"least flexion of a knee: {knee['value']:.3f} rad, at least {KNEE_MINIMUM:g} rad",
                f"least distance of two parts of the body: {distance}, at least {1000 * CLEARANCE:g} mm",
            ]
    tables = [Table(f"plan of {request.title}", ("constant", ">value", "unit", "meaning"), rows, notes)]
    if planned is not None and planned.tuned is not None:
        from ampm.run_file import key_info

        values = planned.tuned.values.items()
        found = [(key, format_value(value), short_unit(key_info(key).unit)) for key, value in values]
        notes = ["tightest margins:", *(f"  {text}" for text in _margins(planned.tuned)[:4])]
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

    A WORD that names a section lists the keys of this section. Any other WORD, and planner, lists the keys
    that have it in their name or meaning. Several words narrow the list: 'ampm keys controller swing'.

    Every key is shown with its value in a gait, unit, bounds and meaning, and with its default if that
    differs. Each can be given as --set KEY=VALUE or in a gait's TOML file; a sweep varies most.
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

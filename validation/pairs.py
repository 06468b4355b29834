"""Two gaits side by side: what continuity at the switches buys, and where it buys nothing.

Both sides are walked (or loaded) and asked the same questions about the instants at which support changes:
what does the plan demand there, what do the joints of the whole-body motion have to do as its grid is
refined, what does the measured ground force do, how far is the ZMP off, how fast do torques change, how much
feedback is needed. Figures of the whole run stand beside them, so that a gain at the switches is seen against
the rest.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.gait import GaitPlan, plan_gait
from ampm.motion import WholeBodyMotion
from ampm.orbit import solve_motion
from ampm.robot import Robot
from validation.console import Silent, figure, json_ready, print_line, print_table
from validation.folders import RUN_FILES, check_run_folder, output_file
from validation.planning import Request, make_body, motion_cache, request
from validation.run import Options, validate
from validation.saved import SavedRun, load_saved_run

Array = NDArray[np.float64]

WINDOW = 0.05
"""Half-width of the window about a switch [s]."""
ACROSS = 0.02
"""Interval on either side of a switch over which the ground force is averaged for its change [s]."""
GRIDS = (0.004, 0.002, 0.001)
"""Largest steps of the inverse kinematics' grid on which the jump of joint accelerations is looked at [s]."""
EVEN = 1.25
"""Ratio of two figures within which neither side is called better."""
REPORT, NUMBERS, PICTURE = "report.html", "comparison.json", "switches.svg"
_OWN = (REPORT, NUMBERS, PICTURE)


@dataclass(frozen=True)
class Joints:
    """What the joints of the periodic motion do at a switch, on finer and finer grids.

    Attributes:
        grid: largest step of each grid, descending, shape (n,) [s].
        jump: largest change of a joint's acceleration over the grid interval that ends at a switch, shape
            (n,) [rad/s^2].
        limit: what the two finest grids say is left without a grid [rad/s^2]: a jump that stays is the
            motion's, one that vanishes was the grid's.
        joint: the joint with the largest limit.
    """

    grid: tuple[float, ...]
    jump: tuple[float, ...]
    limit: float
    joint: str


@dataclass(frozen=True)
class Side:
    """One of the two gaits, walked.

    Attributes:
        label: how tables call it.
        saved: its run.
        plan: in closed form.
        joints: of its motion.
        completed: whether it walked to the end.
        outcome: name of the outcome.
    """

    label: str
    saved: SavedRun
    plan: GaitPlan
    joints: Joints
    completed: bool
    outcome: str


@dataclass(frozen=True)
class Row:
    """One figure of both sides; smaller is better.

    Attributes:
        group: heading that it stands under.
        name: key in JSON.
        label: in words.
        unit: of both values, as shown.
        a: of the first side, NaN if it has none.
        b: of the second side.
        least: values below it are noise and count as it when the two are compared.
    """

    group: str
    name: str
    label: str
    unit: str
    a: float
    b: float
    least: float

    @property
    def ratio(self) -> float:
        """Second over first value, both at least ``least``."""
        return max(self.b, self.least) / max(self.a, self.least)

    @property
    def better(self) -> str:
        """``a``, ``b``, or ``even`` where they differ by less than :data:`EVEN`; empty if one is missing."""
        if not np.isfinite(self.ratio):
            return ""
        return "a" if self.ratio > EVEN else "b" if self.ratio < 1.0 / EVEN else "even"


@dataclass(frozen=True)
class Pair:
    """Both sides and all figures.

    Attributes:
        a: first side.
        b: second side.
        rows: figures, group by group.
        window: half-width of the window about a switch [s].
    """

    a: Side
    b: Side
    rows: tuple[Row, ...]
    window: float

    def won(self, better: str) -> dict[str, list[str]]:
        """Group to the labels of its figures in which one side is better, or neither is."""
        groups: dict[str, list[str]] = {}
        for row in self.rows:
            if row.better == better:
                groups.setdefault(row.group, []).append(row.label)
        return groups

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        sides = {
            key: {
                "name": side.label,
                "outcome": side.outcome,
                "steps_completed": side.saved.record.outcome.steps_completed,
                "model": side.plan.parameters.model,
                "step_length": side.plan.parameters.step_length,
                "switching_velocity": side.plan.parameters.switching_velocity,
                "mean_velocity": side.plan.constants.mean_velocity,
                "single_support_duration": side.plan.constants.single_support_duration,
                "double_support_duration": side.plan.constants.double_support_duration,
                "joint_acceleration_jump": {
                    "grid": side.joints.grid,
                    "jump": side.joints.jump,
                    "limit": side.joints.limit,
                    "joint": side.joints.joint,
                },
            }
            for key, side in (("a", self.a), ("b", self.b))
        }
        figures = {
            row.name: {
                "group": row.group,
                "label": row.label,
                "unit": row.unit,
                "a": row.a,
                "b": row.b,
                "ratio": row.ratio,
                "better": row.better,
            }
            for row in self.rows
        }
        return dict(json_ready({**sides, "window": self.window, "figures": figures}))


# ------------------------------------------------------------------------------------------------- getting


def compare_pair(
    a: str,
    b: str,
    settings: Sequence[str] = (),
    *,
    out: Path | None = None,
    force: bool = False,
    stages: Silent | None = None,
) -> Pair:
    """Walk or load two gaits, compare them, and write the comparison if it is to be kept.

    Args:
        a: preset, TOML file, or folder of a run.
        b: likewise.
        settings: ``key=value`` texts for the gaits that are to be walked.
        out: folder for the report, the numbers, a picture, and the runs that were made; None keeps nothing.
        force: replace an earlier comparison in ``out``.
        stages: where to report progress.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: a gait or folder cannot be used.
    """
    stages = stages or Silent()
    sources = [_source(text, settings) for text in (a, b)]
    if settings and all(isinstance(source, Path) for source in sources):
        raise InputError(
            "both sides are runs that are already walked: --set has nothing to change; leave it out."
        )
    labels = _labels(sources)
    for label, source in zip(labels, sources, strict=True):
        if isinstance(source, Request):  # refuse bad mathematics before anything walks
            plan_gait(source.run.gait, mass=source.run.body.mass)
        elif not (source / "summary.json").is_file():
            raise InputError(
                f"{label} is no folder of a finished run; give a preset, a TOML file or a run's folder."
            )
    folders = _folders(out, labels, sources, force=force)
    with _place(out) as place:
        sides = []
        for label, source, folder in zip(labels, sources, folders, strict=True):
            if isinstance(source, Request):
                target = folder or place / label
                options = Options(force=force, recording=out is not None)
                trial = validate(source, target, options, stages=stages)
                if (
                    trial.summary["outcome"] == "interrupted"
                ):  # whoever stops one walk does not want the other
                    raise KeyboardInterrupt
                source = target
            sides.append(_side(label, source, stages))
        pair = pair_of(*sides)
    if out is not None:
        write_pair(pair, out)
    return pair


def _source(text: str, settings: Sequence[str]) -> Request | Path:
    """A gait to walk, or the folder of a run."""
    if Path(text).is_dir():
        return Path(text)
    return request(text, settings)


def _labels(sources: Sequence[Request | Path]) -> list[str]:
    """Names for tables; two of one name are told apart by a number."""
    names = [s.name if isinstance(s, Request) else s.resolve().name for s in sources]
    if names[0] == names[1]:
        if all(isinstance(source, Request) for source in sources):
            raise InputError(
                f"both gaits are named {names[0]!r}; give two different ones, or folders of runs."
            )
        names = [f"{name}-{number}" for number, name in enumerate(names, start=1)]
    return names


def _folders(
    out: Path | None, labels: Sequence[str], sources: Sequence[Request | Path], *, force: bool
) -> list[Path | None]:
    """Where each run that is to be made goes; refuses what must not be written.

    Raises:
        InputError: ``out`` is a file, holds something else, or holds a comparison and ``force`` is off.
    """
    if out is None:
        return [None, None]
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file, not a folder; give another folder.")
    entries = {entry.name for entry in out.iterdir()} if out.is_dir() else set()
    if entries and not force:
        raise InputError(
            f"--out {out} exists and is not empty; give another folder, or --force to replace it."
        )
    if entries & RUN_FILES - {REPORT} or (entries and not entries & set(_OWN)):
        raise InputError(
            f"--out {out} holds no comparison, so --force does not replace it; give another folder."
        )
    folders = [
        out / name if isinstance(s, Request) else None for name, s in zip(labels, sources, strict=True)
    ]
    for folder in folders:
        if folder is not None:
            check_run_folder(folder, force=force)
    return folders


@contextmanager
def _place(out: Path | None) -> Iterator[Path]:
    """Folder for runs: ``out``, or one that vanishes."""
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="ampm-compare-") as folder:
        yield Path(folder)


def _side(label: str, folder: Path, stages: Silent) -> Side:
    """Load a run and solve its motion on all grids."""
    saved = load_saved_run(folder)
    if not len(saved.signals):
        raise InputError(f"{label} ended before its first instant; there is nothing to compare.")
    run = saved.parameters
    with stages.stage(f"{label}: motion on {len(GRIDS)} grids") as stage:
        body = make_body(run)
        sole = body.model.description.sole
        plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=sole)
        motions = []
        for step in GRIDS:
            finer = run.replace({"solver.ik_time_step": step})
            motions.append(solve_motion(plan, finer, body.robot, progress=stage.note, cache=motion_cache()))
        joints = joint_jumps(motions, body.robot, GRIDS)
    outcome = saved.record.outcome
    return Side(label, saved, plan, joints, outcome.completed, str(outcome.name))


# ------------------------------------------------------------------------------------------------ figuring


def joint_jumps(motions: Sequence[WholeBodyMotion], robot: Robot, grids: Sequence[float]) -> Joints:
    """Change of joint accelerations over the grid interval that ends at a switch, and what is left of it.

    Args:
        motions: of one gait, on finer and finer grids.
        robot: the body.
        grids: the largest step of each, only reported [s].
    """
    steps, changes = [], []
    for motion in motions:
        a, time = motion.acceleration[:, 6:], motion.time
        switch = int(np.searchsorted(time, motion.double_support_start - 1e-9))
        # The step begins with a switch too: the interval before it is the step's last one, mirrored.
        changes.append(np.stack([a[switch] - a[switch - 1], a[0] - robot.mirror_joints(a[-2])]))
        steps.append(np.array([time[switch] - time[switch - 1], time[-1] - time[-2]])[:, None])
    # A continuous acceleration changes in proportion to the step; what is left at none is a jump.
    h, finer = steps[-2:]
    limit = np.abs((changes[-1] * h - changes[-2] * finer) / (h - finer))
    joint = int(limit.max(axis=0).argmax())
    return Joints(
        grid=tuple(grids),
        jump=tuple(float(np.abs(change).max()) for change in changes),
        limit=float(limit.max()),
        joint=robot.joint_names[joint],
    )


def pair_of(a: Side, b: Side, *, window: float = WINDOW) -> Pair:
    """All figures of two walked sides."""
    figures_a, figures_b = _figures(a, window), _figures(b, window)
    rows = tuple(
        Row(group, name, label, unit, figures_a[name], figures_b[name], least)
        for group, name, label, unit, least in _catalogue(window)
    )
    return Pair(a, b, rows, window)


def _catalogue(window: float) -> Iterator[tuple[str, str, str, str, float]]:
    """Group, name, label, unit, and what is noise, of every figure in its order."""
    near = f"{1e3 * window:g} ms"
    group = "jump at a switch: the plan"
    yield group, "plan_acceleration", "COM acceleration", "m/s²", 1e-9
    yield group, "plan_force", "horizontal force", "% of body weight", 1e-9
    yield group, "plan_zmp", "ZMP", "mm", 1e-9
    yield group, "plan_moment", "moment about the COM", "N m", 1e-9
    group = "jump at a switch: joint accelerations of the whole-body motion"
    for step in GRIDS:
        yield group, f"joint_{1e3 * step:g}ms", f"on a grid of {1e3 * step:g} ms", "rad/s²", 1.0
    yield group, "joint_limit", "without a grid (extrapolated)", "rad/s²", 1.0
    group = f"measured ground force, within {near} of a switch (median over switches)"
    change = f"COM acceleration, mean of {1e3 * ACROSS:g} ms after less before"
    yield group, "planned_change", f"{change}: planned", "m/s²", 0.01
    yield group, "measured_change", f"{change}: measured", "m/s²", 0.01
    yield group, "force_rate", "fastest change of the horizontal force", "body weights/s", 0.1
    yield group, "vertical_force", "largest error of the vertical force", "% of body weight", 0.1
    group = "ZMP error"
    for axis in "xy":
        yield group, f"zmp_{axis}_near", f"{axis}, RMSE within {near} of a switch", "mm", 0.05
        yield group, f"zmp_{axis}_far", f"{axis}, RMSE elsewhere", "mm", 0.05
        yield group, f"zmp_{axis}_maximum", f"{axis}, largest", "mm", 0.5
    group = "torque rates"
    yield group, "torque_rate_peak", f"fastest joint within {near} (median over switches)", "N m/ms", 0.1
    yield group, "torque_rate_near", f"RMS of all joints within {near}", "N m/ms", 0.01
    yield group, "torque_rate_far", "RMS of all joints elsewhere", "N m/ms", 0.01
    yield group, "torque", "largest torque, of the motor's limit", "%", 1.0
    group = "feedback: command minus plan"
    yield group, "effort_zmp_near", f"ZMP, RMS within {near}", "mm", 0.05
    yield group, "effort_zmp_far", "ZMP, RMS elsewhere", "mm", 0.05
    yield group, "effort_force_near", f"horizontal force, RMS within {near}", "% of body weight", 0.01
    group = "the whole run"
    for axis in "xyz":
        yield group, f"force_{axis}", f"force {axis}, RMSE", "% of body weight", 0.01
    for axis in "xy":
        yield group, f"momentum_{axis}", f"angular momentum {axis}, RMSE", "N m s", 0.005
    yield group, "slip", "longest slip of a stance foot", "mm", 0.5
    yield group, "friction", "friction used by a loaded foot", "1", 0.05
    yield group, "transport", "mechanical cost of transport", "1", 0.01
    yield group, "unsolved", "unsolved QPs", "ticks", 1.0


def _figures(side: Side, window: float) -> dict[str, float]:
    """Every figure of one side, in the units of the catalogue."""
    saved, plan, summary = side.saved, side.plan, side.saved.summary
    signals, record = saved.signals, saved.record
    time = signals.time
    weight, mass = record.mass * record.gravity, record.mass
    residuals = plan.residuals()
    jump = residuals.acceleration * plan.gravity
    values = {
        "plan_acceleration": jump,
        "plan_force": 100.0 * jump / plan.gravity,
        "plan_zmp": 1e3 * residuals.zmp * plan.parameters.com_height,
        "plan_moment": residuals.moment * plan.weight * plan.parameters.com_height,
        "joint_limit": side.joints.limit,
        **{f"joint_{1e3 * h:g}ms": j for h, j in zip(side.joints.grid, side.joints.jump, strict=True)},
    }

    after_first = time >= plan.constants.step_duration - 1e-9
    switches = plan.switch_times
    switches = switches[(switches >= plan.constants.step_duration - 1e-9) & (switches < time[-1] - window)]
    distance = np.abs(time[:, None] - switches).min(axis=1, initial=np.inf)
    near, far = after_first & (distance <= window), after_first & (distance > window)
    about = [np.abs(time - switch) <= window for switch in switches]

    def median_of_peaks(series: Array) -> float:
        return float(np.median([np.nanmax(series[rows]) for rows in about])) if about else np.nan

    measured, planned = signals.vector("measured_force"), signals.vector("plan_force")
    dt = record.time_step

    def change(force: Array) -> float:
        steps = []
        for switch in switches:
            before = (time >= switch - ACROSS - 1e-9) & (time < switch - 1e-9)
            after = (time >= switch - 1e-9) & (time < switch + ACROSS - 1e-9)
            steps.append(np.linalg.norm(force[after, :2].mean(axis=0) - force[before, :2].mean(axis=0)))
        return float(np.median(steps)) / mass if steps else np.nan

    values["planned_change"], values["measured_change"] = change(planned), change(measured)
    rate = np.linalg.norm(np.diff(measured[:, :2], axis=0, append=measured[-1:, :2]), axis=1) / dt
    values["force_rate"] = median_of_peaks(rate) / weight
    values["vertical_force"] = 100.0 * median_of_peaks(np.abs(measured[:, 2] - planned[:, 2])) / weight

    error = 1e3 * (signals.vector("measured_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    for column, axis in enumerate("xy"):
        values[f"zmp_{axis}_near"] = _rms(error[near, column])
        values[f"zmp_{axis}_far"] = _rms(error[far, column])
        values[f"zmp_{axis}_maximum"] = _largest(error[after_first, column])

    torque_rate = np.abs(np.diff(record.torque, axis=0, append=record.torque[-1:])) / dt / 1e3
    values["torque_rate_peak"] = median_of_peaks(torque_rate.max(axis=1))
    values["torque_rate_near"] = _rms(torque_rate[near])
    values["torque_rate_far"] = _rms(torque_rate[far])
    values["torque"] = 100.0 * _number(summary["margins"]["torque"]["value"])

    effort = 1e3 * (signals.vector("command_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    values["effort_zmp_near"] = _rms(effort[near]) * np.sqrt(2.0)
    values["effort_zmp_far"] = _rms(effort[far]) * np.sqrt(2.0)
    push = 100.0 * (signals.vector("command_force", "xy") - signals.vector("plan_force", "xy")) / weight
    values["effort_force_near"] = _rms(push[near]) * np.sqrt(2.0)

    metrics = summary["metrics"]
    for axis in "xyz":
        values[f"force_{axis}"] = 100.0 * _number(metrics[f"force_{axis}_rmse"]["value"]) / weight
    for axis in "xy":
        values[f"momentum_{axis}"] = _number(metrics[f"angular_momentum_{axis}_rmse"]["value"])
    values["slip"] = 1e3 * _number(summary["margins"]["slip"]["value"])
    values["friction"] = _number(summary["margins"]["friction"]["value"])
    values["transport"] = _number(summary["energy"]["cost_of_transport"])
    values["unsolved"] = float(np.count_nonzero(record.qp_status == 2))
    return {name: float(value) for name, value in values.items()}


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else float("nan")


def _largest(values: Array) -> float:
    return float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else float("nan")


# ------------------------------------------------------------------------------------------------- telling


def write_pair(pair: Pair, out: Path) -> None:
    """Write report, numbers and picture into a folder."""
    from validation.pair_report import draw_file, render

    with output_file(out / NUMBERS) as work:
        text = json.dumps(pair.as_dict(), indent=2, allow_nan=False)
        work.write_text(text + "\n", encoding="utf-8")
    with output_file(out / PICTURE) as work:
        draw_file(pair, work)
    with output_file(out / REPORT) as work:
        work.write_text(render(pair), encoding="utf-8")


def facts(pair: Pair) -> list[tuple[str, str, str]]:
    """What both gaits are: name of the fact, first side, second side."""

    def both(label: str, tell: Any) -> tuple[str, str, str]:
        return label, tell(pair.a), tell(pair.b)

    return [
        both("outcome", lambda s: f"{s.outcome}, {s.saved.record.outcome.steps_completed} steps"),
        both("model", lambda s: s.plan.parameters.model),
        both("step length", lambda s: f"{s.plan.parameters.step_length:g} m"),
        both("speed at a switch", lambda s: f"{s.plan.parameters.switching_velocity:g} m/s"),
        both("mean speed", lambda s: f"{s.plan.constants.mean_velocity:.3f} m/s"),
        both("single support", lambda s: f"{s.plan.constants.single_support_duration:.3f} s"),
        both("double support", lambda s: f"{s.plan.constants.double_support_duration:.3f} s"),
        both("joint that jumps most", lambda s: s.joints.joint.replace("_", " ")),
    ]


def print_pair(pair: Pair) -> None:
    """Print both sides for a reader."""
    a, b = pair.a.label, pair.b.label
    columns = [("", "left"), (a, "right"), (b, "right")]
    print_table(f"{a} and {b}", columns, facts(pair))
    columns += [("unit", "left"), ("ratio", "right"), ("better", "left")]
    for group in dict.fromkeys(row.group for row in pair.rows):
        rows = [row for row in pair.rows if row.group == group]
        cells = [
            (
                row.label,
                shown(row.a),
                shown(row.b),
                "" if row.unit == "1" else row.unit.replace("% of body weight", "% of weight"),
                _ratio(row),
                {"a": a, "b": b, "even": "=", "": ""}[row.better],
            )
            for row in rows
        ]
        print_table(group, columns, cells)
    for better, words in (
        ("a", f"{a} is better in"),
        ("even", "no difference in"),
        ("b", f"{b} is better in"),
    ):
        count = sum(row.better == better for row in pair.rows)
        print_line(f"{words} {count} of {len(pair.rows)} figures")


def shown(value: float) -> str:
    """A figure for a table: rounding errors are 0."""
    return "0" if abs(value) < 1e-9 else figure(value, 3)


def _ratio(row: Row) -> str:
    if not row.better:
        return ""
    return "> 1000" if row.ratio > 1000.0 else "< 0.001" if row.ratio < 1e-3 else figure(row.ratio, 3)


def status(pair: Pair) -> tuple[int, int]:
    """Exit status of both sides: 0 completed, 3 did not complete, 130 interrupted."""
    codes = {"completed": 0, "interrupted": 130}
    return codes.get(pair.a.outcome, 3), codes.get(pair.b.outcome, 3)

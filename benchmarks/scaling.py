"""How cost grows with the steps of a walk, degrees of freedom, points of contact, control rate and workers.

A trial of every length runs in a process of its own. Ticks are those of one short walk: the controller gets
its states, contacts and references again, of a body with more hinges or with more points under each foot.
"""

import csv
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from ampm.body.robot import Robot
from ampm.control.controller import TrackingController
from ampm.parameters import RunParameters
from ampm.reference import Reference, reference_type
from ampm.walk import State, Touch
from benchmarks.clock import least
from benchmarks.recording import run_alone
from benchmarks.sweeping import bare_runs
from validation.progress import Progress
from validation.show.style import into_file
from validation.table import Table
from validation.trial.plan import Request, load_request, plan_walk
from validation.trial.simulate import simulate

DOCS = Path(__file__).resolve().parents[1] / "docs"
DATA, PICTURE = DOCS / "data" / "scaling.csv", DOCS / "images" / "scaling.svg"
TIME_STEPS = (0.0005, 0.002)
"""Of the physics [s]; the default's first."""
TITLES = {
    "time": "Steps: time",
    "memory": "Steps: memory",
    "disk": "Steps: disk",
    "hinges": "Degrees of freedom",
    "points": "Points of contact",
    "rate": "Control rate",
    "workers": "Workers",
}
"""Panels in their order."""
LOGARITHMIC = ("time", "memory", "disk", "points")
MEMORY, DISK = 1000.0, 200.0
"""Targets for a thousand steps [MB]."""

STAGES = ("planning", "simulation", "measurement", "recording", "report")
"""Of a trial, each timed."""

_ROUNDS = 5  # equal passes over the ticks, of which the least times count
_SHORT = 4  # walking steps of which ticks are timed


class Sizes(NamedTuple):
    """What is measured.

    Attributes:
        steps: walking steps of the trials.
        hinges: added to the body.
        points: per foot.
        rates: of the control [Hz].
        workers: processes that walk at the same time.
        runs: of every worker.
    """

    steps: Sequence[int] = (10, 30, 100, 300, 1000)
    hinges: Sequence[int] = (0, 10, 20, 40, 80)
    points: Sequence[int] = (6, 12, 24, 48)
    rates: Sequence[int] = (250, 500, 1000, 2000)
    workers: Sequence[int] = (1, 2, 4)
    runs: int = 4


class Row(NamedTuple):
    """One measured number.

    Attributes:
        panel: what is shown over what.
        series: line of the panel.
        x: of the panel, in ``x_unit``.
        x_unit: quantity and unit.
        y: in ``y_unit``.
        y_unit: quantity and unit.
    """

    panel: str
    series: str
    x: float
    x_unit: str
    y: float
    y_unit: str


class Tick(NamedTuple):
    """Arguments of a control tick."""

    state: State
    touch: Touch
    reference: Reference


def measure_scaling(gait: str, sizes: Sizes, progress: Progress) -> list[Row]:
    """Measure everything.

    Args:
        gait: preset or TOML file.
        sizes: what to measure.
        progress: where to report stages.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the gait cannot be planned.
    """
    return [
        *_over_steps(gait, sizes.steps, progress),
        *_over_hinges_and_points(gait, sizes, progress),
        *_over_rates(gait, sizes.rates, progress),
        *_over_workers(gait, sizes, progress),
    ]


def _over_steps(gait: str, counts: Sequence[int], progress: Progress) -> Iterator[Row]:
    """Time, memory and disk of whole trials."""
    for time_step in TIME_STEPS:
        for steps in counts:
            run = _changed(gait, f"gait.steps={steps}", f"simulation.time_step={time_step}")
            with progress.stage(f"{steps} steps at {1e3 * time_step:g} ms"):
                cost = run_alone(run)
            series, at = f"time step {1e3 * time_step:g} ms", (float(steps), "walking steps")
            seconds = sum(cost[part] for part in STAGES)
            yield Row("time", series, *at, seconds, "time of a trial [s]")
            yield Row("memory", series, *at, cost["memory_peak"], "memory peak [MB]")
            yield Row("disk", series, *at, cost["folder"] / 1e6, "disk [MB]")


def _over_hinges_and_points(gait: str, sizes: Sizes, progress: Progress) -> Iterator[Row]:
    """Time of a control tick."""
    run = _changed(gait, f"gait.steps={_SHORT}")
    with progress.stage("control ticks"):
        robot, ticks = _ticks_of(run)
        for count in sizes.hinges:
            body = with_hinges(robot, count)
            changed = [_longer(tick, count) for tick in ticks]
            yield from _tick_rows("hinges", float(body.nv), "degrees of freedom", body, run, changed)
        for count in sizes.points:
            body, of = with_points(robot, count)
            changed = [_spread(tick, of) for tick in ticks]
            yield from _tick_rows("points", float(count), "points of contact per foot", body, run, changed)


def _tick_rows(
    panel: str, x: float, x_unit: str, body: Robot, run: RunParameters, ticks: Sequence[Tick]
) -> Iterator[Row]:
    """Median and tail of the times of some ticks."""
    spans = _time_ticks(body, run, ticks)
    for name, share in (("median", 50), ("99th percentile", 99)):
        yield Row(panel, name, x, x_unit, 1e6 * float(np.percentile(spans, share)), "control tick [µs]")


def _over_rates(gait: str, rates: Sequence[int], progress: Progress) -> Iterator[Row]:
    """Speed of the closed loop."""
    for rate in rates:
        planned = plan_walk(
            Request(gait, _changed(gait, f"gait.steps={_SHORT}", f"controller.frequency={rate}"))
        )
        with progress.stage(f"control at {rate} Hz"):
            spans = []
            for _ in range(3):
                start = time.perf_counter()
                record = simulate(planned.plan, planned.run, planned.body.model)
                spans.append(time.perf_counter() - start)
        speed = float(record.time[-1]) / min(spans)
        yield Row("rate", "closed loop", float(rate), "control rate [Hz]", speed, "times real time [1]")


def _over_workers(gait: str, sizes: Sizes, progress: Progress) -> Iterator[Row]:
    """Runs in processes at the same time, nothing else in them."""
    request = Request(gait, _changed(gait, f"gait.steps={_SHORT}"))
    for workers in sizes.workers:
        with progress.stage(f"{workers} workers"):
            seconds = bare_runs([[request] * sizes.runs] * workers)
        at = float(workers), "workers"
        yield Row("workers", "walk and verdict", *at, 60.0 * workers / seconds, "runs per minute [1/min]")


# ------------------------------------------------------------------------------------------- ticks


def _ticks_of(run: RunParameters) -> tuple[Robot, list[Tick]]:
    """Body and ticks of a walk."""
    planned, ticks = plan_walk(Request("scaling", run)), []

    class Listener(TrackingController):
        def update(self, state: State, touch: Touch, reference: Reference) -> Any:
            sensed = touch._replace(contact=touch.contact.copy(), normal_force=touch.normal_force.copy())
            ticks.append(Tick(state._replace(q=state.q.copy(), v=state.v.copy()), sensed, reference))
            return super().update(state, touch, reference)

    simulate(planned.plan, planned.run, planned.body.model, controller=Listener)
    return planned.body.robot, ticks


def with_hinges(robot: Robot, count: int) -> Robot:
    """The body with a chain of light links at its trunk, ``count`` hinges long."""
    model = robot.model.copy()
    parent = model.frames[robot.trunk_frame].parentJoint
    for i in range(count):
        kind = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())[i % 3]
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.02]))
        effort, speed, reach = (np.full(1, value) for value in (100.0, 100.0, 3.0))
        parent = model.addJoint(parent, kind, place, f"added_{i}", effort, speed, -reach, reach)
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1e-3, 0.01), pin.SE3.Identity())
    return Robot(model, robot.description, robot.shapes)


def with_points(robot: Robot, count: int) -> tuple[Robot, np.ndarray]:
    """The body with ``count`` points under each foot, evenly along heel, ball and tip.

    Returns:
        The body, and for each of its points the nearest one of ``robot``.
    """
    model, body = robot.model.copy(), Robot(robot.model, robot.description, robot.shapes)
    frames, foot, group, nearest = [], [], [], []
    for first in range(0, len(robot.point_frames), 2):  # both ends of a line
        ends = [model.frames[robot.point_frames[first + i]] for i in (0, 1)]
        for i, share in enumerate(np.linspace(0.0, 1.0, count // 3)):
            place = ends[0].placement.copy()
            place.translation = (1.0 - share) * place.translation + share * ends[1].placement.translation
            frame = pin.Frame(f"point_{first}_{i}", ends[0].parentJoint, 0, place, pin.FrameType.OP_FRAME)
            frames.append(model.addFrame(frame))
            foot.append(robot.point_foot[first])
            group.append(robot.point_group[first])
            nearest.append(first + round(share))
    body.model, body.data = model, model.createData()
    body.point_frames, body.point_foot, body.point_group = tuple(frames), np.array(foot), np.array(group)
    return body, np.array(nearest)


def _longer(tick: Tick, count: int) -> Tick:
    """The tick with ``count`` more hinges, at rest."""

    def more(array: np.ndarray) -> np.ndarray:
        return np.concatenate([array, np.zeros(count)])

    state = tick.state._replace(q=more(tick.state.q), v=more(tick.state.v))
    shorter, row = tick.reference.row, np.zeros((), reference_type(len(state.q), len(state.v)))
    for name in shorter.dtype.names:
        row[name] = more(shorter[name]) if name in ("q", "v", "acceleration") else shorter[name]
    return Tick(state, tick.touch, Reference(row))


def _spread(tick: Tick, of: np.ndarray) -> Tick:
    """The tick with the contact of each point's nearest one, and the force shared among them."""
    share = np.bincount(of)[of]
    force = tick.touch.normal_force[of] / share
    return tick._replace(touch=tick.touch._replace(contact=tick.touch.contact[of], normal_force=force))


def _time_ticks(robot: Robot, run: RunParameters, ticks: Sequence[Tick]) -> np.ndarray:
    """Least time of each tick [s]."""

    def once() -> list[float]:
        controller, spans = TrackingController(robot, run), []
        for tick in ticks:
            start = time.perf_counter()
            controller.update(*tick)
            spans.append(time.perf_counter() - start)
        return spans

    once()  # compiles
    return least([once() for _ in range(_ROUNDS)])


# ----------------------------------------------------------------------------------------- results


def write_data(rows: Sequence[Row], path: Path) -> None:
    """Write the rows as CSV."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Row._fields)
        writer.writerows([*row[:2], f"{row.x:g}", row.x_unit, f"{row.y:.4g}", row.y_unit] for row in rows)


@into_file
def draw(rows: Sequence[Row]) -> Figure:
    """Draw all panels."""
    figure = Figure(figsize=(9.4, 5.2), layout="constrained")
    axes = figure.subplots(2, 4).ravel()
    for axis, (panel, title) in zip(axes, TITLES.items(), strict=False):
        _draw_panel(axis, [row for row in rows if row.panel == panel], title, log=panel in LOGARITHMIC)
    for axis, target in ((axes[1], MEMORY), (axes[2], DISK)):
        axis.axhline(target, color="#888888", linewidth=0.8, linestyle=":")
    axes[-1].set_visible(False)
    return figure


def _draw_panel(axis: Axes, rows: Sequence[Row], title: str, *, log: bool) -> None:
    colors = ("#1f6fb2", "#d9730d")
    for color, series in zip(colors, dict.fromkeys(row.series for row in rows), strict=False):
        x, y = zip(*((row.x, row.y) for row in rows if row.series == series), strict=True)
        axis.plot(x, y, marker="o", markersize=3, linewidth=1.2, color=color, label=series)
    axis.set(title=title, xlabel=rows[0].x_unit, ylabel=rows[0].y_unit)
    if log:
        axis.set(xscale="log", yscale="log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    else:
        axis.set_ylim(bottom=0.0)
    axis.set_xticks([], minor=True)
    axis.set_xticks(sorted({row.x for row in rows}))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.tick_params("x", labelsize=7)
    axis.legend(fontsize=7)


def table(gait: str, rows: Sequence[Row]) -> Table:
    """The measurements of a gait."""
    cells = [(row.series, f"{row.x:g} {row.x_unit}", row.y_unit, f"{row.y:.4g}") for row in rows]
    return Table(f"scaling of {gait}", ("", "at", "", ">measured"), cells)


# ------------------------------------------------------------------------------------------ helpers


def _changed(gait: str, *settings: str) -> RunParameters:
    return load_request(gait, settings, as_is=True).run

"""The recording: a run folder drawn as a Rerun file with its own blueprint.

World frame, SI units. 3D data are float32 at about 100 pictures a second. Curves are float64, with one sample
every 2 ms at most and both sides of every switch, so that a small time step does not make the file large.
``signals.parquet`` has every step.

Several runs are put into one recording under prefixes (``a/world/...``), because a viewer's panel shows
entities of one recording only: bodies stand side by side, curves lie over each other.

There are two timelines: ``sim_time`` counts seconds, ``gait_phase`` walking steps: 3.4 is within the fourth.
On the latter a single support takes the first :data:`SINGLE_SUPPORT` of a step and a double support the rest,
whatever their durations, so that touch-downs and lift-offs of different gaits coincide. A second on it is a
step: Rerun has no timeline without a unit.
"""

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ampm.exceptions import InputError
from ampm.geometry import Array, convex_hull
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.show.curves import CURVES, DIFFERENCES, VELOCITIES
from validation.show.rerun import views
from validation.show.rerun.body import segment_entity, segment_poses, segment_shapes
from validation.show.rerun.views import COMMAND, FAINT, LEFT, MEASURED, PLAN, RIGHT, Color
from validation.store.folders import write_whole
from validation.store.saved import SavedRun, keep_digest_of_recording, load_saved_run, run_events
from validation.store.signals import Signals, changes
from validation.trial.files import RunFile
from validation.trial.record import support_height

_PICTURE_RATE = 100.0  # pictures of the body per second [Hz]
_CURVE_STEP = 0.002  # least time between samples of a curve [s]; both sides of every switch are added
MOST_PICTURES, MOST_SAMPLES = 3_000, 15_000
"""Pictures and samples of a curve in a recording: of a longer walk they are farther apart."""
SINGLE_SUPPORT = 0.8
"""Share of a step on ``gait_phase`` that a single support takes; about that of a walk."""
FORCE_SCALE = 1.0 / 500.0
"""Length of a force arrow [m/N]: the weight of a person reaches from the floor past the COM, to show whether
the line of the force meets it."""
SERIES = {"plan": PLAN, "command": COMMAND, "measured": MEASURED}
_AXES: dict[str, Color] = {"x": (255, 99, 99, 255), "y": (120, 220, 120, 255), "z": (110, 160, 255, 255)}
_FEET = {"left": LEFT, "right": RIGHT}

Lines = Mapping[str, Color]
"""Name to colour of the columns of an entity."""
Curves = tuple[Array, Mapping[str, tuple[Array, Lines]]]
"""Times, shape (N,) [s]; entity to values, shape (N, k), and name and colour of every column."""
_HIDDEN = ("command", "first_plan")  # curves that are not shown beside those of other runs
_SHARES = {"plan": 0.5, "motion": 0.5, "y": 0.65, "z": 0.4}
"""Brightness of curves in the colour of their run; of others it is 1."""


def write_recording(run: str | Path | SavedRun) -> Path:
    """Write ``recording.rrd`` into the folder of a finished run, or of a run read from it; returns its path.

    An earlier recording is replaced. Raises :class:`InputError` if it is not a run folder.
    """
    saved = run if isinstance(run, SavedRun) else load_saved_run(run)
    path, curves = saved.directory / RunFile.RECORDING, _curves(saved)
    blueprint = views.run_blueprint(_ranges([curves]))
    with _open_stream("ampm", {saved.title: saved}, path, blueprint) as stream:
        _Log(stream, saved).everything(curves)
    keep_digest_of_recording(saved.directory)
    return path


def write_several(runs: Mapping[str, SavedRun], path: Path) -> None:
    """Write one recording of runs, by their names, over an existing one; raises InputError of too many."""
    most = len(views.RUN_COLORS)
    if len(runs) > most:
        raise InputError(f"{len(runs)} recordings are too many for one view; give {most} at most.")
    curves = [_curves(saved) for saved in runs.values()]
    names = {f"/{letter}": name for letter, name in zip(ascii_lowercase, runs, strict=False)}
    blueprint = views.several_blueprint(names, _ranges(curves))
    with _open_stream("ampm-beside", runs, path, blueprint) as stream:
        for (at, name), drawn, color in zip(names.items(), curves, views.RUN_COLORS, strict=False):
            _Log(stream, runs[name], at, name, color).everything(drawn)


def _ranges(runs: Sequence[Curves]) -> views.Ranges:
    """Ends of the vertical axes of all curves, together for all runs."""
    found: dict[str, list[Array]] = {}
    for _, curves in runs:
        for entity, (values, _) in curves.items():
            found.setdefault(entity, []).append(values.ravel())
    return {entity: views.axis_range(np.concatenate(parts)) for entity, parts in found.items()}


@contextmanager
def _open_stream(
    kind: str, runs: Mapping[str, SavedRun], path: Path, blueprint: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """A stream into a file, with the runs' names and a key of their signals: equal runs give equal files."""
    key = "-".join(saved.summary["files"][RunFile.SIGNALS][:16] for saved in runs.values())
    # The SDK logs every file that it saves.
    logging.getLogger("rerun").setLevel(logging.ERROR)
    # Chunks end where they are full or the file does, never by the clock.
    whole = rr.ChunkBatcherConfig.NEVER()
    stream = rr.RecordingStream(kind, recording_id=key, send_properties=False, batcher_config=whole)
    # In memory first: where the disk is full, the SDK's own file never ends its flush.
    memory = stream.memory_recording()
    stream.send_recording_name(", ".join(runs))
    stream.send_blueprint(blueprint)  # active: the browser would show its own layout
    yield stream
    stream.flush()
    write_whole(path, memory.drain_as_bytes())


class _Log:
    """A recording stream: column-wise data of one run on both timelines; N pictures at ``times`` [s].

    Beside other runs it has a prefix of its entities, such as ``/a``, a name, and a colour of its curves.
    """

    def __init__(
        self, stream: rr.RecordingStream, saved: SavedRun, at: str = "", name: str = "", color: Color = PLAN
    ) -> None:
        self.stream, self.saved, self.record = stream, saved, saved.record
        self.at, self.name, self.color = at, name, color
        self.pace = _gait_phase(saved.signals, saved.record.outcome.time)
        least = max(1.0 / _PICTURE_RATE, saved.record.outcome.time / MOST_PICTURES)
        if saved.is_log:
            self.states = np.zeros(0, np.intp)
            rows = np.arange(0, len(saved.signals), _stride(saved.record.time_step, least))
        else:  # of which the folder has state and signals; the signals have no row at the end
            states = saved.record.state_rows[:-1]
            steps, drawn, rows = np.intersect1d(states, saved.signal_steps, return_indices=True)
            part = slice(None, None, _stride(steps[1:2].sum() * saved.record.time_step, least))
            self.states, rows = drawn[part], rows[part]
        self.signals = saved.signals.take(rows)
        self.times = saved.signals.time[rows]

    def everything(self, curves: Curves) -> None:
        """Verdict, body, floor, curves, phases and events."""
        self.stream.log(self.at or "/", rr.ViewCoordinates.FLU, static=True)
        verdict = rr.TextDocument(verdict_markdown(self.saved), media_type=rr.MediaType.MARKDOWN)
        self.static("verdict", verdict)
        if not self.saved.is_log:
            self.body(self.saved.model())
        if len(self.times):
            self.ground(self.saved.plan())
            for entity, (values, lines) in curves[1].items():
                self.series(entity, curves[0], values, lines)
            self.lanes()
        events = sorted(run_events(self.saved), key=lambda event: event[0])
        instants, levels, texts = zip(*events, strict=True)
        words = rr.TextLog.columns(text=[plain_text(text) for text in texts], level=levels)
        self.columns("events", np.array(instants), words)

    def static(self, entity: str, *archetypes: Any) -> None:
        for archetype in archetypes:
            self.stream.log(f"{self.at}/{entity}", archetype, static=True)

    def columns(self, entity: str, times: Array, columns: Iterable[Any]) -> None:
        # Rounded: the SDK cuts seconds off to nanoseconds, and 2.05 s would become 2.049999999 s.
        indexes = [
            rr.TimeColumn(name, duration=np.round(1e9 * np.asarray(at)).astype("timedelta64[ns]"))
            for name, at in ((views.TIMELINE, times), (views.PHASE, np.interp(times, *self.pace)))
        ]
        self.stream.send_columns(f"{self.at}/{entity}", indexes=indexes, columns=columns)

    def shapes(self, entity: str, kind: Any, color: Color, radius: float, **parts: Array) -> None:
        """Send one shape per picture; none where it is not defined."""
        self.static(entity, kind.from_fields(colors=[color], radii=[radius]))
        there = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts.values()])
        shown = kind.columns(**{name: part[there] for name, part in parts.items()})
        self.columns(entity, self.times, shown.partition(there.astype(int)))

    def arrow(self, entity: str, origin: Array, force: Array, color: Color, radius: float) -> None:
        """Send one force [N] per picture."""
        self.shapes(entity, rr.Arrows3D, color, radius, origins=origin, vectors=force * FORCE_SCALE)

    def series(self, entity: str, times: Array, values: Array, lines: Lines) -> None:
        """Send ``values`` (N, k) as one wide entity, a third of the size of k narrow ones; NaN is a gap."""
        names, colors, shown = list(lines), list(lines.values()), [True] * len(lines)
        # The plan is a broad line below the others, to stay visible where they agree.
        widths = [4.0 if name == "plan" and not self.name else 1.5 for name in names]
        if self.name:  # beside other runs
            red, green, blue, _ = self.color
            shares = [_SHARES.get(name, 1.0) for name in names]
            colors = [(round(k * red), round(k * green), round(k * blue), 255) for k in shares]
            shown = [name not in _HIDDEN for name in names]
            names = [f"{self.name} {name}" for name in names]
        self.static(entity, rr.SeriesLines(names=names, colors=colors, widths=widths, visible_series=shown))
        self.columns(entity, times, rr.Scalars.columns(scalars=np.ascontiguousarray(values)))

    def body(self, model: mujoco.MjModel) -> None:
        """Segments of the model, moved by forward kinematics of the recorded q."""
        for entity, parts in segment_shapes(model).items():
            self.static(entity, *parts)
        position, quaternion = segment_poses(model, self.record.q[self.states])
        for body in range(1, model.nbody):
            poses = rr.Transform3D.columns(translation=position[:, body], quaternion=quaternion[:, body])
            self.columns(segment_entity(model, body), self.times, poses)

    def ground(self, plan: StepPlan | None) -> None:
        """Soles, support polygon, ZMPs, forces and COM."""
        signals, times = self.signals, self.times
        # The views follow this frame, so that the body stays in view and the floor moves.
        # A periodic gait sways about its line; other walks may turn.
        follow = signals.vector("measured_com" if self.saved.is_free else "plan_com")
        turns = self.saved.is_free or self.saved.from_rest
        follow = (follow - (0.0, 0.0, follow[0, 2])) * (1.0, turns, not self.saved.is_free)
        self.columns("world/follow", times, rr.Transform3D.columns(translation=follow))
        floor = np.zeros(len(times)) if self.saved.is_log else self.soles()
        zmp = {kind: _on_floor(signals.vector(f"{kind}_zmp", "xy"), floor) for kind in SERIES}
        # Concentric from above: the smaller ones are higher.
        sizes = (0.016, 0.01), (0.011, 0.03), (0.007, 0.05)
        for (kind, color), (size, lift) in zip(SERIES.items(), sizes, strict=True):
            place = zmp[kind] + (0.0, 0.0, lift)
            self.shapes(f"world/floor/zmp/{kind}", rr.Points3D, color, size, positions=place)
        # The plan's arrow is thin and a third longer, to stay visible where both agree.
        for kind, scale, width, size, lift in (
            ("plan", 1.33, 0.006, 0.004, 0.0),
            ("measured", 1.0, 0.013, 0.002, 0.002),
        ):
            color, path = SERIES[kind], signals.vector(f"{kind}_com")
            force = scale * signals.vector(f"{kind}_force")
            self.arrow(f"world/force/{kind}", zmp[kind], force, color, width)
            # From above everything is drawn on the floor: nearer objects would hide the ZMP.
            shadow, rise = _on_floor(path[:, :2], floor), np.array([0.0, 0.0, lift])
            self.shapes(f"world/com/{kind}", rr.Points3D, color, 0.03, positions=path)
            self.shapes(f"world/floor/com/{kind}", rr.Points3D, color, 0.007, positions=shadow)
            self.static(f"world/com/{kind}/trail", _line(path, color, size))
            self.static(f"world/floor/com/{kind}/trail", _line(shadow + rise, color, 0.4 * size))
            self.static(f"world/floor/zmp/{kind}/trail", _line(zmp[kind] + rise, color, size))
        if plan is not None:
            steps, slope = plan.contacts.footsteps, plan.contacts.slope
            prints = [_on_floor(footprint(plan.feet.sole, step), step.position[2] - 0.001) for step in steps]
            for outline in prints:
                outline[:, 2] += outline[:, :2] @ slope
            self.static("world/plan/footprints", rr.LineStrips3D(prints, colors=[FAINT], radii=0.002))
            if "first_plan_zmp_x" not in signals:  # the polygon is that of the first plan
                self.polygon(plan)
        elif measured := [outline for _, outline in self.saved.footprints()]:
            self.static("world/feet/footprints", rr.LineStrips3D(measured, colors=[FAINT], radii=0.002))

    def soles(self) -> Array:
        """Soles, their points and forces, and pushes; height of the floor under the feet, shape (N,) [m]."""
        record, times = self.record, self.times
        force, point = record.point_force[self.states], record.point_position[self.states]
        floor = support_height(record.floor, point[:, :, 2], force[:, :, 2])
        for foot, (name, color) in enumerate(_FEET.items()):
            mine = np.flatnonzero(record.point_foot == foot)
            sole, contact = f"world/feet/{name}/sole", f"world/feet/{name}/contact"
            self.static(sole, rr.LineStrips3D.from_fields(colors=[color], radii=[0.004]))
            # Along the left edge, back along the right one.
            around = mine[[*range(0, len(mine), 2), *range(len(mine) - 1, 0, -2), 0]]
            self.columns(sole, times, rr.LineStrips3D.columns(strips=point[:, around].astype(np.float32)))
            # The area of a point's disc is its share of the load.
            load = force[:, mine, 2]
            radius = 0.028 * np.sqrt(np.clip(load, 0.0, None) / (record.mass * record.gravity))
            self.static(contact, rr.Points3D.from_fields(colors=[color]))
            discs = rr.Points3D.columns(positions=point[:, mine].reshape(-1, 3), radii=radius.ravel())
            self.columns(contact, times, discs.partition(np.full(len(times), len(mine))))
            total = load.sum(axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                centre = np.einsum("np,npd->nd", load, point[:, mine]) / total[:, None]
            centre[total < 1.0] = np.nan
            origin = _on_floor(centre[:, :2], floor)
            self.arrow(f"world/force/{name}", origin, force[:, mine].sum(axis=1), color, 0.005)
        steps = record.state_rows[self.states]
        for k, segment in enumerate(record.external_segments):
            push, place = record.external_force[steps, k], record.external_position[steps, k]
            push[~push.any(axis=1)] = np.nan
            entity = f"world/force/push/{rr.escape_entity_path_part(segment)}"
            self.arrow(entity, place, push, _AXES["x"], 0.01)
        return floor

    def polygon(self, plan: StepPlan) -> None:
        """Support polygon of the points planned in contact: sent when it changes."""
        times = np.minimum(self.times, plan.duration)
        points, contact = plan.points_in_contact(times)
        change = changes(contact)
        rows = zip(points[change], contact[change], plan.sample(times[change]).floor.tolist(), strict=True)
        polygons = [_on_floor(convex_hull(mine[here]), height) for mine, here, height in rows]
        strips = [np.vstack([polygon, polygon[:1]]).astype(np.float32) for polygon in polygons]
        self.static("world/plan/polygon", rr.LineStrips3D.from_fields(colors=[PLAN], radii=[0.004]))
        self.columns("world/plan/polygon", self.times[change], rr.LineStrips3D.columns(strips=strips))

    def lanes(self) -> None:
        """Phase of the plan and contact of the feet."""
        signals = self.saved.signals
        stances = ["both feet" if stance == "both" else f"{stance} foot" for stance in signals["stance"]]
        planned = "planned" if np.isfinite(signals["plan_com_x"]).any() else "measured"
        lanes = {f"{planned}_stance": np.array(stances, dtype=object)}
        for foot in _FEET:
            lanes[f"{foot}_foot_on_the_floor"] = np.where(signals[f"{foot}_contact"], foot, "")
        feet = {"left foot": LEFT, "right foot": RIGHT, **_FEET}
        colors: dict[str, Color] = {"both feet": (*FAINT[:3], 255), **feet}
        style = rr.StateConfiguration(values=list(colors), colors=list(colors.values()))
        for name, states in lanes.items():
            self.static(f"phase/{name}", style)
            change = changes(states)
            begun = [str(state) for state in states[change]]
            self.columns(f"phase/{name}", signals.time[change], rr.StateChange.columns(state=begun))


def _gait_phase(signals: Signals, end: float) -> tuple[Array, Array]:
    """Times at which the planned phases begin, and their places on ``gait_phase``; last of all the end."""
    begun = signals.switches()
    if not len(begun):
        return np.zeros(1), np.zeros(1)
    starts, both = signals.time[begun], signals["phase"][begun] == "double_support"
    phases = np.maximum(np.cumsum(~both) - 1.0, 0.0) + np.where(both, SINGLE_SUPPORT, 0.0)
    # The last phase may be incomplete: it has the rate of its kind.
    length = np.diff(starts)[both[:-1] == both[-1]]
    left = max(end, float(signals.time[-1])) - starts[-1]
    usual = float(np.median(length)) if len(length) else max(left, 1e-9)
    share = 1.0 - SINGLE_SUPPORT if both[-1] else SINGLE_SUPPORT
    return np.append(starts, starts[-1] + left), np.append(phases, phases[-1] + share * left / usual)


def _stride(step: float, least: float) -> int:
    """Number of rows that are ``step`` apart [s] in at least this time [s]."""
    return max(1, math.ceil(least / step * (1.0 - 1e-9))) if step > 0.0 else 1


def verdict_markdown(saved: SavedRun) -> str:
    """The verdict and its metrics as Markdown, for the recording's first panel."""
    summary, verdict = saved.summary, saved.summary["verdict"].replace("_", " ")
    parts = [
        f"# {saved.title}: {verdict} ({'log' if saved.is_log else saved.record.outcome.name})",
        summary["reason"],
        saved.table().markdown(),
        "Curves: one sample every 2 ms at most, and both sides of every switch of phase or contact. "
        f"Every time step ({1e3 * saved.record.time_step:g} ms) is in `signals.parquet`.",
    ]
    return plain_text("\n\n".join(parts) + "\n")


def plain_text(text: str) -> str:
    """Text with characters of the viewer's font only: some versions end at the first missing glyph."""
    for sign, words in (("∞", "inf"), ("≥", ">="), ("−", "-"), ("–", "-")):
        text = text.replace(sign, words)
    return text.encode("latin-1", errors="replace").decode("latin-1")


def _on_floor(xy: Array, floor: Array | float) -> Array:
    """Points (N, 2) on a floor of a height [m], lifted slightly above its lines."""
    return np.column_stack([xy, np.full(len(xy), 0.002) + floor])


def _line(path: Array, color: Color, radius: float) -> rr.LineStrips3D:
    path = path[np.isfinite(path).all(axis=1)]
    return rr.LineStrips3D([path[::2]], colors=[(*color[:3], 110)], radii=radius)


def _curves(saved: SavedRun) -> Curves:
    """Plan, command and measurement, and their differences."""
    if not len(saved.signals):
        return np.zeros(0), {}
    # Rows evenly spread, before and at every switch, and the last.
    every = saved.signals
    new = np.concatenate([every.switches()[1:], *(changes(every[f"{foot}_contact"])[1:] for foot in _FEET)])
    least = max(_CURVE_STEP, saved.record.outcome.time / MOST_SAMPLES)
    even = np.arange(0, len(every), _stride(float(every.time[1:2].sum()), least))
    rows = np.unique(np.concatenate([even, new, new - 1, [len(every) - 1]]))
    signals, weight = every.take(rows), saved.record.mass * saved.record.gravity

    series = SERIES | ({"first_plan": FAINT} if "first_plan_zmp_x" in signals else {})
    yaw = {"motion": PLAN, "measured": MEASURED}
    found: dict[str, tuple[Array, Lines]] = {}
    for column, curve in CURVES.items():
        lines = yaw if curve.reference == "motion" else series
        found[f"signals/{column}"] = np.column_stack([curve.values(signals, kind) for kind in lines]), lines
    for column in VELOCITIES if saved.is_free else ():
        both = {kind: SERIES[kind] for kind in ("command", "measured")}
        found[f"signals/{column}"] = np.column_stack([signals[f"{kind}_{column}"] for kind in both]), both
    for entity, gap in DIFFERENCES.items():
        found[entity] = gap.values(every, weight)[rows], {axis: _AXES[axis] for axis in gap.axes}
    feet = np.column_stack([signals["left_force_z"], signals["right_force_z"], signals["plan_force_z"]])
    found["signals/foot_force_z"] = feet, {**_FEET, "plan": PLAN}
    if not saved.is_log:
        use = np.abs(saved.record.torque_at(saved.signal_steps[rows])) / saved.record.torque_limit
        found["effort/torque"] = 100 * use.max(axis=1)[:, None], {"torque": MEASURED}
    known: dict[str, tuple[Array, Lines]] = {}  # without columns that have no value, as of a missing plan
    for entity, (values, colors) in found.items():
        there = np.flatnonzero(np.isfinite(values).any(axis=0))
        if len(there):
            names = list(colors)
            known[entity] = values[:, there], {names[k]: colors[names[k]] for k in there}
    return signals.time, known

"""The recording: a run folder drawn as a Rerun file with its own blueprint.

World frame, SI units, timeline ``sim_time``. What is drawn in 3D is float32 and about 100 pictures a second;
the curves are float64, one sample every 2 ms at most, and both sides of every switch: a screen shows no more,
and a small time step would only make the file large. ``signals.parquet`` has every step.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ampm.geometry import convex_hull
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.show.rerun.views import (
    COMMAND,
    FAINT,
    LEFT,
    MEASURED,
    PLAN,
    RIGHT,
    TIMELINE,
    Color,
    plain_text,
    run_blueprint,
    verdict_markdown,
)
from validation.store.saved import RECORDING_FILE as RECORDING_FILE
from validation.store.saved import SavedRun, load_saved_run, run_events

Array = NDArray[np.float64]

PICTURE_RATE = 100.0
"""Pictures of the body per second [Hz]: beyond what an eye or a screen follows."""

CURVE_STEP = 0.002
"""Least time between samples of a curve [s]; both sides of every switch come on top."""

FORCE_SCALE = 1.0 / 500.0
"""Length of a force arrow [m/N]: the weight of a person reaches from the floor past the COM, so that one sees
whether the line of the force meets it."""

_GEOM = mujoco.mjtGeom
_SHAPES: dict[int, Any] = {
    int(_GEOM.mjGEOM_CAPSULE): rr.Capsules3D,
    int(_GEOM.mjGEOM_CYLINDER): rr.Cylinders3D,
    int(_GEOM.mjGEOM_BOX): rr.Boxes3D,
    int(_GEOM.mjGEOM_ELLIPSOID): rr.Ellipsoids3D,
    int(_GEOM.mjGEOM_SPHERE): rr.Ellipsoids3D,
}
"""How a kind of MuJoCo's geoms is drawn."""

_LEAST_SHAPE = 0.005
"""Radius from which a shape of the body is drawn [m]."""

SERIES = {"plan": PLAN, "command": COMMAND, "measured": MEASURED}
_AXES: dict[str, Color] = {"x": (255, 99, 99, 255), "y": (120, 220, 120, 255), "z": (110, 160, 255, 255)}
_FEET = {"left": LEFT, "right": RIGHT}


class _Log:
    """One recording stream with the project's conventions: columns only, one timeline."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self.stream = stream

    def static(self, entity: str, *archetypes: Any) -> None:
        for archetype in archetypes:
            self.stream.log(entity, archetype, static=True)

    def columns(self, entity: str, times: Array, columns: Iterable[Any]) -> None:
        # Rounded: the SDK cuts seconds off to nanoseconds, and 2.05 s would become 2.049999999 s.
        nanoseconds = np.round(1e9 * np.asarray(times)).astype("timedelta64[ns]")
        index = rr.TimeColumn(TIMELINE, duration=nanoseconds)
        self.stream.send_columns(entity, indexes=[index], columns=columns)

    def shapes(
        self, entity: str, times: Array, kind: Any, color: Color, radius: float, **parts: Array
    ) -> None:
        """Send one shape per picture; none where it is not defined."""
        self.static(entity, kind.from_fields(colors=[color], radii=[radius]))
        there = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts.values()])
        shown = kind.columns(**{name: part[there] for name, part in parts.items()})
        self.columns(entity, times, shown.partition(there.astype(int)))

    def series(self, entity: str, times: Array, values: Array, lines: Mapping[str, Color]) -> None:
        """Send ``values`` (N, k) as one wide entity: a third of the size of k narrow ones.

        Args:
            entity: name.
            times: shape (N,) [s].
            values: a gap is a NaN, which the plots leave out.
            lines: name and colour of every column.
        """
        # The plan is drawn broad beneath the others, or it would be hidden where they agree.
        widths = [4.0 if name == "plan" else 1.5 for name in lines]
        self.static(entity, rr.SeriesLines(names=list(lines), colors=list(lines.values()), widths=widths))
        self.columns(entity, times, rr.Scalars.columns(scalars=np.ascontiguousarray(values)))


def write_recording(run: str | Path | SavedRun) -> Path:
    """Write ``recording.rrd`` into a run folder from what the folder holds.

    Args:
        run: folder of a finished run, or what was read from it; an existing recording in it is replaced.

    Returns:
        Path of the recording.

    Raises:
        InputError: the folder is no run folder.
    """
    saved = run if isinstance(run, SavedRun) else load_saved_run(run)
    path = saved.directory / RECORDING_FILE
    # The SDK announces on its own logger what it saves; a library keeps quiet.
    logging.getLogger("rerun").setLevel(logging.ERROR)
    # A fixed id: two identical runs give identical recordings (`rerun rrd compare`).
    stream = rr.RecordingStream("ampm", recording_id="ampm-run", send_properties=False)
    stream.save(str(path), default_blueprint=run_blueprint())
    try:
        log = _Log(stream)
        plan = saved.plan()
        frames = _frames(saved)
        log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log.static("verdict", rr.TextDocument(verdict_markdown(saved), media_type=rr.MediaType.MARKDOWN))
        _log_body(log, saved, frames)
        _log_ground(log, saved, frames, plan)
        _log_series(log, saved)
        _log_states(log, saved)
        _log_events(log, saved)
    finally:
        # Without the footer that this writes the file does not verify.
        stream.flush()
        stream.disconnect()
    return path


def _frames(saved: SavedRun) -> NDArray[np.intp]:
    """Rows of the signals of which a picture is drawn."""
    return np.arange(0, len(saved.signals), _stride(saved, 1.0 / PICTURE_RATE))


def _stride(saved: SavedRun, least: float) -> int:
    """Rows of the signals in a time that is at least this [s]."""
    return max(1, math.ceil(least / saved.record.time_step * (1.0 - 1e-9)))


def _curve_rows(saved: SavedRun) -> NDArray[np.intp]:
    """Rows of the signals that the curves have: evenly spread, before and at every switch, and the last."""
    signals = saved.signals
    rows = len(signals)
    kept = np.zeros(rows, dtype=bool)
    kept[:: _stride(saved, CURVE_STEP)] = True
    kept[-1:] = True
    changes = [signals.switches()[1:]]
    for foot in ("left", "right"):
        contact = signals[f"{foot}_contact"]
        changes.append(np.flatnonzero(contact[1:] != contact[:-1]) + 1)
    change = np.concatenate(changes)
    kept[change] = kept[change - 1] = True
    return np.flatnonzero(kept)


# ----------------------------------------------------------------------------------------------- body


def _log_body(log: _Log, saved: SavedRun, frames: NDArray[np.intp]) -> None:
    """Segments as they are in the model, moved by forward kinematics of the recorded q.

    Shapes of one kind are one entity: every further one costs a short recording more than the motion in it.
    The millimetre spheres of the soles are left out: the contact points are drawn where they act.
    """
    model = mujoco.MjModel.from_xml_string(saved.model_xml)
    data = mujoco.MjData(model)
    drawn = np.flatnonzero((model.geom_bodyid > 0) & (model.geom_rbound > _LEAST_SHAPE))
    position = np.empty((len(frames), len(drawn), 3))
    rotation = np.empty((len(frames), len(drawn), 9))
    for row, qpos in enumerate(saved.record.q[frames]):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        position[row], rotation[row] = data.geom_xpos[drawn], data.geom_xmat[drawn]
    times = saved.record.time[frames]
    for kind in np.unique(model.geom_type[drawn]).tolist():
        mine = np.flatnonzero(model.geom_type[drawn] == kind)
        size = model.geom_size[drawn[mine]]
        color = [_shape_color(model.geom_rgba[geom]) for geom in drawn[mine]]
        place = position[:, mine]
        style: dict[str, Any] = {"colors": color, "fill_mode": rr.components.FillMode.Solid}
        shape: Any = _SHAPES.get(kind)
        if shape is None:
            continue  # planes and meshes: the floor is the grid
        if shape in (rr.Capsules3D, rr.Cylinders3D):
            style |= {"lengths": 2 * size[:, 1], "radii": size[:, 0]}
        else:
            style["half_sizes"] = np.repeat(size[:, :1], 3, axis=1) if kind == _GEOM.mjGEOM_SPHERE else size
        if shape is rr.Capsules3D:
            # MuJoCo centres a capsule, Rerun starts it at its lower hemisphere's centre.
            place = place - rotation[:, mine][..., 2::3] * size[:, 1:2]
        entity = f"world/body/{mujoco.mjtGeom(kind).name.removeprefix('mjGEOM_').lower()}"
        log.static(entity, shape.from_fields(**style))
        if not len(frames):
            continue
        turned = Rotation.from_matrix(rotation[:, mine].reshape(-1, 3, 3)).as_quat()
        at = "translations" if shape is rr.Capsules3D else "centers"
        poses = shape.columns(**{at: place.reshape(-1, 3)}, quaternions=turned)
        log.columns(entity, times, poses.partition(np.full(len(frames), len(mine))))


def _shape_color(rgba: Array) -> Color:
    """Colour of the model, lightened for a dark ground; clear, so that force and COM show within the body."""
    r, g, b = (round(255 * (0.7 * float(c) + 0.3)) for c in rgba[:3])
    return (r, g, b, 90)


# --------------------------------------------------------------------------------------------- ground


def _log_ground(log: _Log, saved: SavedRun, frames: NDArray[np.intp], plan: StepPlan | None) -> None:
    """Soles, contact points, support polygon, ZMPs, forces and COM."""
    if not len(frames):
        return
    record, signals = saved.record, saved.signals
    times = signals.time[frames]

    def dot(entity: str, position: Array, color: Color, radius: float) -> None:
        log.shapes(entity, times, rr.Points3D, color, radius, positions=position)

    def arrow(entity: str, origin: Array, force: Array, color: Color, radius: float) -> None:
        log.shapes(entity, times, rr.Arrows3D, color, radius, origins=origin, vectors=force * FORCE_SCALE)

    # The views stand on this frame, so the body walks on the spot and the floor passes by.
    com = signals.vector("plan_com")[frames]
    follow = np.column_stack([com[:, 0], np.zeros((len(frames), 2))])
    log.columns("world/follow", times, rr.Transform3D.columns(translation=follow))

    point, force = record.point_position[frames], record.point_force[frames]
    load = force[..., 2]
    for foot, (name, color) in enumerate(_FEET.items()):
        mine = np.flatnonzero(record.point_foot == foot)
        sole = f"world/feet/{name}/sole"
        log.static(sole, rr.LineStrips3D.from_fields(colors=[color], radii=[0.004]))
        outline = point[:, mine[[0, 2, 4, 5, 3, 1, 0]]].astype(np.float32)
        log.columns(sole, times, rr.LineStrips3D.columns(strips=outline))
        # The area of a point's disc is its share of the load; an unloaded one vanishes.
        radius = 0.028 * np.sqrt(np.clip(load[:, mine], 0.0, None) / (record.mass * record.gravity))
        log.static(f"world/feet/{name}/contact", rr.Points3D.from_fields(colors=[color]))
        discs = rr.Points3D.columns(positions=point[:, mine].reshape(-1, 3), radii=radius.ravel())
        log.columns(f"world/feet/{name}/contact", times, discs.partition(np.full(len(frames), len(mine))))
        total = load[:, mine].sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            centre = np.einsum("np,npd->nd", load[:, mine], point[:, mine]) / total[:, None]
        centre[total < 1.0] = np.nan
        arrow(f"world/force/{name}", _on_floor(centre[:, :2]), force[:, mine].sum(axis=1), color, 0.005)

    zmp = {kind: _on_floor(signals.vector(f"{kind}_zmp", "xy")[frames]) for kind in SERIES}
    # Concentric from above: the smaller ones lie higher.
    for (kind, color), size, lift in zip(
        SERIES.items(), (0.016, 0.011, 0.007), (0.01, 0.03, 0.05), strict=True
    ):
        dot(f"world/floor/zmp/{kind}", zmp[kind] + (0.0, 0.0, lift), color, size)
    # The plan's arrow is thin and a third longer: it goes on where the measured one ends, if the two agree.
    for kind, scale, size in (("plan", 1.33, 0.006), ("measured", 1.0, 0.013)):
        wanted = scale * signals.vector(f"{kind}_force")[frames]
        arrow(f"world/force/{kind}", zmp[kind], wanted, SERIES[kind], size)
    for kind, size, lift in (("plan", 0.004, 0.0), ("measured", 0.002, 0.002)):
        color, path = SERIES[kind], signals.vector(f"{kind}_com")[frames]
        # From above everything lies on the floor: nearer things would hide and outgrow the ZMP.
        shadow, rise = _on_floor(path[:, :2]), np.array([0.0, 0.0, lift])
        dot(f"world/com/{kind}", path, color, 0.03)
        dot(f"world/floor/com/{kind}", shadow, color, 0.007)
        log.static(f"world/com/{kind}/trail", _line(path, color, size))
        log.static(f"world/floor/com/{kind}/trail", _line(shadow + rise, color, 0.4 * size))
        log.static(f"world/floor/zmp/{kind}/trail", _line(zmp[kind] + rise, color, size))

    if plan is not None:
        log.static("world/plan/footprints", _footprints(plan))
        _log_polygon(log, plan, times)


def _on_floor(xy: Array) -> Array:
    """Lift (N, 2) floor points a hair so that they are not hidden by the floor's lines."""
    return np.column_stack([xy, np.full(len(xy), 0.002)])


def _line(path: Array, color: Color, radius: float) -> rr.LineStrips3D:
    path = path[np.isfinite(path).all(axis=1)]
    return rr.LineStrips3D([path[::2]], colors=[(*color[:3], 110)], radii=radius)


def _log_polygon(log: _Log, plan: StepPlan, times: Array) -> None:
    """Support polygon of the points planned in contact: sent when it changes, it stands still in between."""
    within = np.minimum(times, plan.duration)
    feet = plan.feet.sample(within)
    contact = np.concatenate([foot.contact for foot in feet], axis=1)
    change = np.flatnonzero(np.r_[True, (contact[1:] != contact[:-1]).any(axis=1)])
    points = np.concatenate([foot.sole_points[change, :, :2] for foot in feet], axis=1)
    loaded = contact[change].repeat(2, axis=1)
    polygons = [_on_floor(convex_hull(mine[here])) for mine, here in zip(points, loaded, strict=True)]
    entity = "world/plan/polygon"
    log.static(entity, rr.LineStrips3D.from_fields(colors=[PLAN], radii=[0.004]))
    strips = [np.vstack([polygon, polygon[:1]]).astype(np.float32) for polygon in polygons]
    log.columns(entity, times[change], rr.LineStrips3D.columns(strips=strips))


def _footprints(plan: StepPlan) -> rr.LineStrips3D:
    """Outlines of all planned footsteps."""
    steps = plan.contacts.footsteps
    outlines = [_on_floor(footprint(plan.feet.sole, step)) - np.array([0.0, 0.0, 0.001]) for step in steps]
    return rr.LineStrips3D(outlines, colors=[FAINT] * len(steps), radii=0.002)


# ------------------------------------------------------------------------------------------ time series


def _log_series(log: _Log, saved: SavedRun) -> None:
    """Plan, command and measurement, and what lies between them."""
    if not len(saved.signals):
        return
    rows = _curve_rows(saved)
    signals = saved.signals.take(rows)
    times = signals.time
    weight = saved.record.mass * saved.record.gravity

    def three(name: str) -> Array:
        return np.column_stack([signals[f"{kind}_{name}"] for kind in SERIES])

    def gap(measured: str, planned: str, axes: str, scale: float = 1.0) -> Array:
        return scale * (signals.vector(measured, axes) - signals.vector(planned, axes))

    # Metres walked would flatten every curve: x is drawn about the planned COM.
    com_x = signals["plan_com_x"][:, None]
    log.series("signals/zmp_x", times, 1e3 * (three("zmp_x") - com_x), SERIES)
    log.series("signals/zmp_y", times, 1e3 * three("zmp_y"), SERIES)
    log.series("signals/com_x", times, three("com_x") - com_x, SERIES)
    for name in (
        "force_x",
        "force_y",
        "force_z",
        "angular_momentum_x",
        "angular_momentum_y",
        "com_y",
        "com_z",
    ):
        log.series(f"signals/{name}", times, three(name), SERIES)
    yaw = [signals[f"{kind}_angular_momentum_z"] for kind in ("motion", "measured")]
    lines = {"motion": PLAN, "measured": MEASURED}
    log.series("signals/angular_momentum_z", times, np.column_stack(yaw), lines)
    xy = {axis: _AXES[axis] for axis in "xy"}
    errors = {
        "residual/zmp": gap("measured_zmp", "plan_zmp", "xy", 1e3),
        "residual/force": gap("measured_force", "plan_force", "xyz", 100.0 / weight),
        "residual/angular_momentum": gap("measured_angular_momentum", "plan_angular_momentum", "xy"),
        "residual/com": gap("measured_com", "plan_com", "xyz", 1e3),
        "feedback/zmp": gap("command_zmp", "plan_zmp", "xy", 1e3),
        "selfcheck/zmp": gap("measured_zmp_momentum", "measured_zmp", "xy", 1e3),
    }
    for entity, error in errors.items():
        log.series(entity, times, error, xy if error.shape[1] == 2 else _AXES)
    feet = np.column_stack([signals["left_force_z"], signals["right_force_z"], signals["plan_force_z"]])
    log.series("signals/foot_force_z", times, feet, {**_FEET, "plan, both": PLAN})
    torque = saved.record.torque
    if len(torque) == len(saved.signals):
        use = np.abs(torque[rows]) / saved.record.torque_limit
        log.series("effort/torque", times, 100 * use.max(axis=1)[:, None], {"busiest motor": MEASURED})


def _log_states(log: _Log, saved: SavedRun) -> None:
    """Phase of the plan and contact of the feet as lanes."""
    signals = saved.signals
    if not len(signals):
        return
    stances = ["both feet" if stance == "both" else f"{stance} foot" for stance in signals["stance"]]
    lanes = {"planned stance": np.array(stances, dtype=object)}
    for foot in _FEET:
        lanes[f"{foot} foot on the floor"] = np.where(signals[f"{foot}_contact"], foot, "")
    feet = {"left foot": LEFT, "right foot": RIGHT, **_FEET}
    colors: dict[str, Color] = {"both feet": (*FAINT[:3], 255), **feet}
    for name, states in lanes.items():
        entity = "phase/" + name.replace(" ", "_")
        log.static(entity, rr.StateConfiguration(values=list(colors), colors=list(colors.values())))
        change = np.flatnonzero(np.r_[True, states[1:] != states[:-1]])
        begun = [str(state) for state in states[change]]
        log.columns(entity, signals.time[change], rr.StateChange.columns(state=begun))


def _log_events(log: _Log, saved: SavedRun) -> None:
    """Write events as text: footfalls, the largest error, unsolved QPs, how it ended."""
    times, levels, texts = zip(*sorted(run_events(saved), key=lambda event: event[0]), strict=True)
    words = rr.TextLog.columns(text=[plain_text(text) for text in texts], level=levels)
    log.columns("events", np.array(times), words)

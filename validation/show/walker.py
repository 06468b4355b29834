"""Pictures of the walking body from the side, from saved joint angles, forces and ZMPs."""

from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ampm.geometry import Array, rotations
from ampm.planner.support import StepPlan
from validation.store.saved import SavedRun
from validation.store.signals import Signals
from validation.trial.outcome import OutcomeName
from validation.trial.record import support_height

INSTANTS = 6
"""Pictures of a walk."""
LAST = 1.0
"""Of a walk that was lost its end is shown [s]."""
FLOOR_MARKS = 0.2
"""Distance of the marks on the floor [m]."""
_PIXELS = 200.0  # of a picture, per metre
_MARGIN = 0.06  # around everything that is drawn [m]
_BEYOND = 1.25  # length of the arrow of the weight, over the height of the COM: it passes the COM
_SMALLEST = 0.005  # radius from which a shape of the body is drawn [m]
_WHOLE = 1e3  # radius from which a part of the floor is not drawn: it is the plane [m]
_OUTLINE = rotations(np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False))[..., 0]
_GEOM = mujoco.mjtGeom


class Instant(NamedTuple):
    """One picture.

    Attributes:
        svg: markup.
        time: [s].
        phase: planned phase in words.
    """

    svg: Markup
    time: float
    phase: str


class _Pose(NamedTuple):
    """What one picture shows, in its plane: forward [m], upward [m].

    Attributes:
        shapes: side and corners (n, 2) of every shape, the farthest first.
        zmp: planned and measured.
        com: measured.
        force: planned and measured, as long as they are drawn.
        marks: places of the marks on the floor, and its height.
    """

    shapes: list[tuple[str, Array]]
    zmp: tuple[Array, Array]
    com: Array
    force: tuple[Array, Array]
    marks: Array


def drawn_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Shapes of a model that are drawn: those of the body but for its sole points, and steps of the floor."""
    steps = (model.geom_type == _GEOM.mjGEOM_BOX) & (model.geom_rbound < _WHOLE)
    return np.flatnonzero(((model.geom_bodyid > 0) | steps) & (model.geom_rbound > _SMALLEST))


def draw_walker(saved: SavedRun, plan: StepPlan | None, stride: slice) -> list[Instant]:
    """Draw the body with ZMP and ground force at a few instants, moved by the recorded joint angles.

    Args:
        saved: the run.
        plan: says where the walk heads; along x without it.
        stride: rows of the signals that are shown; of a walk that was lost its last second.

    Returns:
        Pictures of equal size in order of time; none of a run without states.
    """
    record, signals = saved.record, saved.signals
    steps, states, rows = np.intersect1d(record.state_rows[:-1], saved.signal_steps, return_indices=True)
    if not len(steps):
        return []
    if record.outcome.name not in (OutcomeName.COMPLETED, OutcomeName.INTERRUPTED):
        first = int(np.searchsorted(signals.time, record.outcome.time - LAST))
        stride = slice(first, len(signals))
    chosen = np.unique(np.abs(rows - _rows_shown(signals, stride)[:, None]).argmin(axis=1))
    model = mujoco.MjModel.from_xml_string(saved.model_xml)
    scale = arrow_scale(saved)
    poses = []
    for state, row in zip(states[chosen], rows[chosen], strict=True):
        time = float(signals.time[row])
        heading = 0.0 if plan is None else float(plan.sample([min(time, plan.duration)]).heading[0])
        points, forces = record.point_position[[state], :, 2], record.point_force[[state], :, 2]
        floor = float(support_height(record.metadata, points, forces)[0])
        poses.append(_pose(model, record.q[state], signals, int(row), rotations(heading), floor, scale))
    corners = np.vstack([part for pose in poses for side, part in pose.shapes if side != "step"])
    low, high = corners.min(axis=0) - _MARGIN, corners.max(axis=0) + _MARGIN
    return [
        Instant(_svg(pose, low, high), float(signals.time[row]), _phase(signals, int(row)))
        for pose, row in zip(poses, rows[chosen], strict=True)
    ]


def arrow_scale(saved: SavedRun) -> float:
    """Length of a force's arrow [m/N]: that of the weight passes the COM."""
    weight = saved.record.mass * saved.record.gravity
    return _BEYOND * float(saved.signals["measured_com_z"][0]) / weight


def _rows_shown(signals: Signals, window: slice) -> NDArray[np.intp]:
    """Rows of a window: early and late in a single support, the middle of a double support."""
    begun = [*signals.switches().tolist(), len(signals)]
    phases = [(a, b) for a, b in pairwise(begun) if window.start <= a and b <= window.stop]
    shares = {"single_support": (0.2, 0.75), "double_support": (0.5,)}
    found = [a + share * (b - a) for a, b in phases for share in shares[str(signals["phase"][a])]]
    if len(found) != INSTANTS:  # no complete stride
        found = np.linspace(window.start, window.stop - 1, INSTANTS).tolist()
    return np.round(found).astype(np.intp)


def _phase(signals: Signals, row: int) -> str:
    """The planned phase in words."""
    stance = signals["stance"][row]
    return "double support" if stance == "both" else f"{stance} single support"


def _pose(
    model: mujoco.MjModel, q: Array, signals: Signals, row: int, axes: Array, floor: float, scale: float
) -> _Pose:
    """What is seen of one instant by someone on the right of the body.

    Args:
        model: the body.
        q: its configuration.
        signals: of the run.
        row: of the signals at this instant.
        axes: forward and left, by columns, shape (2, 2).
        floor: height of the floor [m].
        scale: length of the arrows [m/N].
    """
    forward = np.array([*axes[:, 0], 0.0])
    plane = np.stack([forward, [0.0, 0.0, 1.0]])
    com = {kind: signals.vector(f"{kind}_com")[row] for kind in ("plan", "measured")}
    middle = plane @ (com["measured"] * (1.0, 1.0, 0.0))
    data, sides = mujoco.MjData(model), _sides(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    geoms = drawn_geoms(model)
    far_first = geoms[np.argsort(-data.geom_xpos[geoms, :2] @ axes[:, 1])]
    marks = np.arange(np.ceil((middle[0] - 2.0) / FLOOR_MARKS), (middle[0] + 2.0) / FLOOR_MARKS)
    zmp = {kind: np.append(signals.vector(f"{kind}_zmp", "xy")[row], floor) for kind in com}
    force = {kind: scale * signals.vector(f"{kind}_force")[row] for kind in com}
    return _Pose(
        [(sides[geom], outline(model, data, int(geom), plane) - middle) for geom in far_first],
        (plane @ zmp["plan"] - middle, plane @ zmp["measured"] - middle),
        plane @ com["measured"] - middle,
        (plane @ force["plan"], plane @ force["measured"]),
        np.column_stack([FLOOR_MARKS * marks - middle[0], np.full(len(marks), floor)]),
    )


def _sides(model: mujoco.MjModel) -> list[str]:
    """Side of every shape: where it is with all joints at zero."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    off = data.geom_xpos[:, 1] - data.qpos[1]
    beside = 0.01 * model.stat.extent
    sides = np.select(
        [model.geom_bodyid == 0, off > beside, off < -beside], ["step", "left", "right"], "trunk"
    )
    return [str(side) for side in sides]


def outline(model: mujoco.MjModel, data: mujoco.MjData, geom: int, plane: Array) -> Array:
    """Outline of a shape in a plane: its farthest points in many directions.

    Args:
        model: the body.
        data: its pose.
        geom: the shape.
        plane: axes of the plane (2, 3).

    Returns:
        Corners (n, 2) [m].
    """
    centre, turned = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    size, kind = model.geom_size[geom], model.geom_type[geom]
    local = _OUTLINE @ plane @ turned  # the directions in the shape's axes
    if kind == _GEOM.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = model.mesh_vert[first : first + count]
        farthest = points[(local @ points.T).argmax(axis=1)]
    elif kind == _GEOM.mjGEOM_BOX:
        farthest = np.sign(local) * size
    elif kind == _GEOM.mjGEOM_ELLIPSOID:
        farthest = size**2 * local / np.linalg.norm(size * local, axis=1, keepdims=True)
    elif kind == _GEOM.mjGEOM_SPHERE:
        farthest = size[0] * local
    else:  # capsule; a cylinder gets round ends
        farthest = size[0] * local + np.sign(local[:, 2:]) * (0.0, 0.0, size[1])
    return np.asarray((centre + farthest @ turned.T) @ plane.T)


def _svg(pose: _Pose, low: Array, high: Array) -> Markup:
    """One picture, whose colours are the page's."""

    def at(point: Array) -> tuple[str, str]:
        x, y = _PIXELS * (point[0] - low[0]), _PIXELS * (high[1] - point[1])
        return f"{x:.1f}", f"{y:.1f}"

    def line(kind: str, begin: Array, end: Array) -> str:
        (x1, y1), (x2, y2) = at(begin), at(end)
        return f'<line class="{kind}" x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"/>'

    def dot(kind: str, place: Array, radius: float) -> str:
        x, y = at(place)
        return f'<circle class="{kind}" cx="{x}" cy="{y}" r="{radius:g}"/>'

    width, height = _PIXELS * (high - low)
    marks = [line("floor", mark, mark - (0.0, 0.03)) for mark in pose.marks]
    parts = [line("floor", pose.marks[0], pose.marks[-1]), *marks]
    for side, corners in pose.shapes:
        path = " ".join(",".join(at(corner)) for corner in corners)
        parts.append(f'<polygon class="{side}" points="{path}"/>')
    for kind, zmp, force, radius in zip(("plan", "measured"), pose.zmp, pose.force, (7, 3.5), strict=True):
        if np.isfinite([*zmp, *force]).all():
            tip = zmp + force
            along = force / max(float(np.linalg.norm(force)), 1e-9)
            across = np.array([-along[1], along[0]])
            ends = (tip + 0.07 * along, tip + 0.03 * across, tip - 0.03 * across)
            head = " ".join(",".join(at(end)) for end in ends)
            parts += [line(kind, zmp, tip), dot(kind, zmp, radius)]
            parts.append(f'<polygon class="{kind}" points="{head}"/>')
    parts.append(dot("com", pose.com, 5))
    return Markup(f'<svg viewBox="0 0 {width:.0f} {height:.0f}">{"".join(parts)}</svg>')

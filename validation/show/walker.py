"""The walking body from the side, drawn from saved joint angles, forces and ZMPs."""

from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array, rotations
from ampm.planner.support import StepPlan
from validation.show.chart import WIDTH, Chart, new_charts
from validation.show.style import FAINT, INK, LEFT, MEASURED, PLAN, RIGHT
from validation.store.saved import SavedRun
from validation.store.signals import Signals
from validation.trial.outcome import OutcomeName
from validation.trial.record import support_height

INSTANTS = 6
"""Poses of a walk that are drawn."""
_LAST = 1.0  # time before the end of a walk that was lost from which its poses are drawn [s]
_ARROW = 1.25  # length of the weight's arrow, over the height of the COM: it passes the COM
_HEAD = 0.04  # length of an arrow's head [m]
_SMALLEST = 0.005  # radius from which a shape of the body is drawn [m]
_BESIDE, _BELOW = 0.45, 0.15  # half the width of a pose's picture, and its depth below the floor [m]
_WHOLE = 1e3  # radius from which a part of the floor is not drawn: it is the plane [m]
_OUTLINE = rotations(np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False))[..., 0]
_GEOM = mujoco.mjtGeom


def drawn_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Shapes of a model that are drawn: those of the body but for its sole points, and steps of the floor."""
    steps = (model.geom_type == _GEOM.mjGEOM_BOX) & (model.geom_rbound < _WHOLE)
    return np.flatnonzero(((model.geom_bodyid > 0) | steps) & (model.geom_rbound > _SMALLEST))


def draw_walker(saved: SavedRun, plan: StepPlan | None, stride: slice) -> list[Chart]:
    """Draw the body with ZMP and ground force at a few instants, moved by the recorded joint angles.

    Args:
        saved: the run.
        plan: says where the walk heads; along x without it.
        stride: rows of the signals that are shown; a walk that was lost is shown over its last second.

    Returns:
        A chart with one pose beside the other in order of time; none for a run without states.
    """
    record, signals = saved.record, saved.signals
    _, states, rows = np.intersect1d(record.state_rows[:-1], saved.signal_steps, return_indices=True)
    if not len(states):
        return []
    if record.outcome.name not in (OutcomeName.COMPLETED, OutcomeName.INTERRUPTED):
        stride = slice(int(np.searchsorted(signals.time, record.outcome.time - _LAST)), len(signals))
    chosen = np.unique(np.abs(rows - rows_shown(signals, stride)[:, None]).argmin(axis=1))
    model = saved.model()
    (chart,) = charts = new_charts(3.5, width=2 * WIDTH)
    chart.top, chart.height = 8.0, chart.height + chart.top - 8.0  # it has neither title nor legend
    for number, (state, row) in enumerate(zip(states[chosen], rows[chosen], strict=True)):
        time, at = float(signals.time[row]), 2 * _BESIDE * number
        heading = 0.0 if plan is None else float(plan.sample([min(time, plan.duration)]).heading[0])
        points, forces = record.point_position[[state], :, 2], record.point_force[[state], :, 2]
        floor = float(support_height(record.floor, points, forces)[0])
        row_signals, axes = signals.take(np.array([row])), rotations(heading)
        _draw_pose(chart, model, record.q[state], row_signals, axes, floor, at)
        stance = signals["stance"][row]
        chart.xticks[f"{time:.2f} s\n{'double' if stance == 'both' else stance} support"] = at
    chart.xlim, chart.equal = (-_BESIDE, at + _BESIDE), True
    chart.name("", "height [m]", "")
    return charts


def rows_shown(signals: Signals, window: slice) -> NDArray[np.intp]:
    """Rows of a window: early and late in a single support, the middle of a double support."""
    begun = [*signals.switches().tolist(), len(signals)]
    phases = [(a, b) for a, b in pairwise(begun) if window.start <= a and b <= window.stop]
    shares = {"single_support": (0.2, 0.75), "double_support": (0.5,)}
    found = [a + share * (b - a) for a, b in phases for share in shares[str(signals["phase"][a])]]
    if len(found) != INSTANTS:  # no complete stride
        found = np.linspace(window.start, window.stop - 1, INSTANTS).tolist()
    return np.round(found).astype(np.intp)


def _draw_pose(
    chart: Chart, model: mujoco.MjModel, q: Array, signals: Signals, axes: Array, floor: float, at: float
) -> None:
    """Draw one instant as seen from the right of the body, about the COM; forward and upward [m].

    The signals have one row. Axes are forward and left by columns, shape (2, 2), the floor is a height, and
    the COM is drawn at a place of the chart [m].
    """
    plane = np.stack([[*axes[:, 0], 0.0], [0.0, 0.0, 1.0]])
    com = signals.vector("measured_com")[0]
    middle = plane @ (com * (1.0, 1.0, 0.0)) - (at, 0.0)
    data, colors = mujoco.MjData(model), _colors(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    geoms = drawn_geoms(model)
    for geom in geoms[np.argsort(-data.geom_xpos[geoms, :2] @ axes[:, 1])].tolist():  # the farthest first
        corners, edge = outline(model, data, geom, plane) - middle, FAINT
        if not model.geom_bodyid[geom]:  # of the floor what is below this pose
            corners, edge = np.clip(corners, (at - _BESIDE, floor - _BELOW), (at + _BESIDE, np.inf)), ""
        chart.area(corners[:, 0], corners[:, 1], colors[geom], opacity=0.35, edge=edge)
    normal, ends = data.geom("floor").xmat[2::3], at + np.array([-_BESIDE, _BESIDE])
    under = float(np.nan_to_num((plane @ [*signals.vector("measured_zmp", "xy")[0], floor] - middle)[0]))
    chart.line(ends, floor - (ends - under) * (normal[:2] @ axes[:, 0]) / normal[2], FAINT, 0.8)
    weight = float(model.body_mass.sum() * -model.opt.gravity[2])
    scale = _ARROW * com[2] / weight
    for kind, color, width in (("plan", PLAN, 4.0), ("measured", MEASURED, 1.5)):
        zmp = plane @ [*signals.vector(f"{kind}_zmp", "xy")[0], floor] - middle
        tip = zmp + scale * plane @ signals.vector(f"{kind}_force")[0]
        if np.isfinite([*zmp, *tip]).all():
            along = (tip - zmp) / max(float(np.linalg.norm(tip - zmp)), 1e-9)
            back, aside = tip - _HEAD * along, 0.4 * _HEAD * np.array([-along[1], along[0]])
            x, y = np.transpose([zmp, back, tip, back + aside, back - aside])
            chart.line(x[:2], y[:2], color, width)
            chart.area(x[2:], y[2:], color)
            chart.dots(x[:1], y[:1], color, 3 + width)
    x, y = plane @ com - middle
    chart.dots([x], [y], INK, 5.0)


def _colors(model: mujoco.MjModel) -> list[str]:
    """Colour of every shape by the side where it is with all joints at zero."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    off = data.geom_xpos[:, 1] - data.qpos[1]
    beside = 0.01 * model.stat.extent
    is_segment = model.geom_bodyid > 0
    sides = [is_segment & (off > beside), is_segment & (off < -beside)]
    return [str(color) for color in np.select(sides, [LEFT, RIGHT], FAINT)]


def outline(model: mujoco.MjModel, data: mujoco.MjData, geom: int, plane: Array) -> Array:
    """Corners (n, 2) [m] of a shape in a plane with axes (2, 3): its farthest points in many directions."""
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

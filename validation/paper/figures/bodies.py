"""Figures 8, 11 and 12: bodies in motion, posed from the simulated joint angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from ampm.body.robot import Robot
from ampm.geometry import Array
from validation.paper.figures.canvas import (
    FAINT,
    FORCE,
    INK,
    LEFT,
    MEASURED,
    MOTION,
    PLAN,
    RIGHT,
    SHADE,
    TRUNK,
    arrow,
    band_legend,
    curves,
    difference,
    inches,
    legend_above,
    shade,
    zero_line,
)
from validation.paper.figures.walks import Numbers, Walk, Walks, less_plan, of_motion
from validation.trial.plan import PlannedWalk

SIDE, FRONT = (0, 2), (1, 2)
"""Views: world axes drawn to the right and upwards. The side view is from the body's right, the front view
faces the body, so its left is on the right."""

_COLORS = {"left": LEFT, "right": RIGHT, "trunk": TRUNK}
_HAND = 0.055  # of stature
_HEAD_RADIUS = 0.058
_HEAD_OVER_SHOULDERS = 0.112
_WIDTHS = {"thigh": 0.062, "shank": 0.046, "foot": 0.028, "toe": 0.022, "arm": 0.036, "trunk": 0.098,
           "shoulders": 0.05, "hips": 0.062, "neck": 0.04}  # fmt: skip
"""Thickness of the segments, as shares of stature; for the eye only."""
_SLIM = 0.3  # thinner bodies are traces, with an outlined head

_WIDTH = 9.6
_WEIGHT_LENGTH = 0.55
_FRAMES = 9
_LINES = ("-", (0, (4, 2)))  # of the two walks that a figure compares
_STRIP = 2.3  # height of a strip of frames [in]
_LOADED = 0.08
"""Share of the weight from which on a foot's force is drawn: an arrow needs room for its head [1]."""
_SWINGS = (0.1, 0.4, 0.7, 0.8, 0.9, 1.0)
"""Values of c_y whose momentum and swing are given beside Fig. 11."""


class Segment(NamedTuple):
    """A chain of points of one thickness.

    Attributes:
        points: in world, shape (k, 3) [m].
        width: thickness [m].
        side: ``left``, ``right`` or ``trunk``.
    """

    points: Array
    width: float
    side: str


class Pose(NamedTuple):
    """A posed body.

    Attributes:
        segments: what to draw.
        head: centre of the head, shape (3,) [m].
        head_radius: [m].
        com: centre of mass, shape (3,) [m].
    """

    segments: tuple[Segment, ...]
    head: Array
    head_radius: float
    com: Array


def pose(robot: Robot, q: Array) -> Pose:
    """Pose a body by forward kinematics.

    Args:
        robot: the body.
        q: Pinocchio configuration, shape (nq,).
    """
    model, data, body = robot.model, robot.model.createData(), robot.description
    pin.forwardKinematics(model, data, q)
    pin.updateFramePlacements(model, data)
    com = np.array(pin.centerOfMass(model, data, q))

    def joint(name: str) -> Array:
        return np.array(data.oMi[model.getJointId(name)].translation)

    def frame(name: str) -> Array:
        return np.array(data.oMf[model.getFrameId(name)].translation)

    chains: list[tuple[str, str, Sequence[Array]]] = []
    for side, leg, arm in (("left", body.left_leg, body.left_arm), ("right", body.right_leg, body.right_arm)):
        hip, knee, ankle, ball = joint(leg.hip[0]), joint(leg.knee), joint(leg.ankle[0]), joint(leg.toes[0])
        points = [frame(name) for name in leg.sole_points]
        heel, front, tip = (np.mean(points[k : k + 2], axis=0) for k in (0, 2, 4))
        wrist = data.oMi[model.getJointId(arm[-1])]
        hand = wrist.translation - _HAND * body.height * wrist.rotation[:, 2]
        chains += [
            (side, "thigh", [hip, knee]),
            (side, "shank", [knee, ankle]),
            (side, "foot", [ankle, heel, front, ankle]),
            (side, "toe", [ball, tip]),
            (side, "arm", [joint(arm[0]), joint(arm[3]), np.array(wrist.translation), hand]),
        ]
    girdle = [joint(arm[0]) for arm in (body.left_arm, body.right_arm)]
    sockets = [joint(leg.hip[0]) for leg in body.legs]
    shoulders, hips = np.mean(girdle, axis=0), np.mean(sockets, axis=0)
    rotation = np.array(data.oMf[robot.trunk_frame].rotation)
    head = shoulders + _HEAD_OVER_SHOULDERS * body.height * rotation[:, 2]
    chains += [
        ("trunk", "neck", [shoulders, head]),
        ("trunk", "shoulders", girdle),
        ("trunk", "hips", sockets),
        ("trunk", "trunk", [hips, joint(body.waist[0]), joint(body.chest[0]), shoulders]),
    ]
    return Pose(
        segments=tuple(Segment(np.array(c), _WIDTHS[kind] * body.height, side) for side, kind, c in chains),
        head=head,
        head_radius=_HEAD_RADIUS * body.height,
        com=com,
    )


def _draw(
    axis: Axes, body: Pose, view: tuple[int, int], *, points_per_metre: float, shift: float = 0.0,
    alpha: float = 1.0, slim: float = 1.0,
) -> None:  # fmt: skip
    """Draw a body.

    Args:
        axis: axes in metres, equal scales.
        body: the pose.
        view: :data:`SIDE` or :data:`FRONT`.
        points_per_metre: scale of the axes, for the segments' thickness.
        shift: added to the horizontal coordinate [m].
        alpha: opacity.
        slim: factor on the thickness.
    """
    depth, toward_viewer = (1, -1.0) if view == SIDE else (0, 1.0)
    ordered = sorted(body.segments, key=lambda item: toward_viewer * float(item.points[:, depth].mean()))
    for order, segment in enumerate(ordered):
        x, z = segment.points[:, view].T
        width = slim * segment.width * points_per_metre
        # Limbs cross each other; traces are too thin for borders.
        border = () if segment.side == "trunk" or slim < _SLIM else (("white", 1.1),)
        for color, extra in (*border, (_COLORS[segment.side], 0.0)):
            axis.plot(
                x + shift, z, color=color, linewidth=max(width + extra, 0.4), alpha=alpha,
                zorder=3 + 0.02 * order, solid_capstyle="round", solid_joinstyle="round",
            )  # fmt: skip
    fill: dict[str, Any] = {"facecolor": TRUNK, "edgecolor": "none"}
    if slim < _SLIM:
        fill = {"facecolor": "none", "edgecolor": TRUNK, "linewidth": 0.4}
    x, z = body.head[list(view)]
    axis.add_patch(Circle((x + shift, z), body.head_radius, alpha=alpha, zorder=4, **fill))


def figure_8(walks: Walks) -> tuple[Figure, Numbers]:
    """Side view of a gait: bodies at their positions, a stride in frames, and the COM less the plan."""
    walk = walks.walk("normal")
    figure = Figure(figsize=(_WIDTH, 10.25))
    _trace(figure, walk)
    _strip(figure, 5.05, walk, SIDE).set_title("One stride, frame by frame")
    numbers: Numbers = {}
    for component, left in enumerate((0.7, 3.75, 6.8)):
        axis, name = inches(figure, left, 8.35, 2.45, 1.3), "xyz"[component]
        motion, simulated = walk.away("com", component)
        difference(axis, walk.phase / walk.stride, 1e3 * motion, 1e3 * simulated)
        _stride_axis(axis, walk)
        axis.set_title(f"COM less plan, {name}", pad=16)
        if component == 0:
            axis.set_ylabel("[mm]")
            band_legend(axis)
        numbers |= less_plan(f"COM {name}", motion, simulated, "m")
    return figure, numbers


def figure_11(walks: Walks) -> tuple[Figure, dict[str, Any]]:
    """Front view of two gaits that differ in c_y, with trunk roll and angular momentum."""
    pair = [walks.walk("roll-0.1"), walks.walk("roll-0.7")]
    figure = Figure(figsize=(_WIDTH, 10.5))
    labels = [f"$c_y$ = {walk.gait.c_y:g}" for walk in pair]
    for row, walk in enumerate(pair):
        axis = _strip(figure, 0.42 + 2.95 * row, walk, FRONT)
        axis.set_title(f"({'ab'[row]}) {labels[row]}, from the front")
    _compare(figure, 6.9, pair, 0, "roll", labels)
    swings = {f"{value:g}": _swing(walks.plan("normal", (f"gait.c_y={value}",))) for value in _SWINGS}
    return figure, {"gaits": {walk.label: numbers(walk) for walk in pair}, "c_y": swings}


def figure_12(walks: Walks) -> tuple[Figure, dict[str, Any]]:
    """Side view of a gait with a large angular momentum about the lateral axis, beside the normal one."""
    pair = [walks.walk("pitch"), walks.walk("normal")]
    figure, gait = Figure(figsize=(_WIDTH, 7.55)), pair[0].gait
    labels = [f"$c_s$ = {walk.gait.c_s:g}" for walk in pair]
    _strip(figure, 0.42, pair[0], SIDE).set_title(
        f"{labels[0]}, steps of {gait.step_length:g} m, $v_0$ = {gait.switching_velocity:g} m/s"
    )
    _compare(figure, 3.95, pair, 1, "pitch", labels)
    return figure, {walk.label: numbers(walk) for walk in pair}


def _trace(figure: Figure, walk: Walk) -> None:
    """Bodies at true positions, thin but for those that begin a step; COM of plan, motion and simulation."""
    record, strides = walk.trial.record, min(3, len(walk.stride_starts))
    times = walk.stride_starts[0] + walk.stride * np.linspace(0.0, strides, 20 * strides + 1)
    times = times[times <= record.time[-1]]
    bodies = [pose(walk.robot, walk.configuration(walk.row(time))) for time in times]
    centre = 0.5 * float(bodies[0].com[0] + bodies[-1].com[0])
    low, high = centre - 2.45, centre + 2.45
    axis, scale = _floor(figure, 0.42, 3.6, low, high, below=0.16)
    for index, body in enumerate(bodies):
        slim, alpha = (0.1, 0.55) if index % 10 else (0.75, 1.0)
        _draw(axis, body, SIDE, points_per_metre=scale, slim=slim, alpha=alpha)
    at = np.linspace(times[0], times[-1], 400)
    rows = (record.time >= times[0]) & (record.time <= times[-1])
    for com, color, width, zorder, label in (
        (walk.plan.sample(at).com, PLAN, 4.6, 5, "COM, plan"),
        (of_motion(walk.motion.sample(at, walk.robot), walk.robot, walk.plan).com, MOTION, 2.2, 5.5, "IK"),
        (record.com[rows], MEASURED, 0.9, 6, "simulation"),
    ):
        axis.plot(com[:, 0], com[:, 2], color=color, linewidth=width, zorder=zorder, label=label)
    for step in walk.plan.contacts.footsteps:
        if low + 0.2 < step.position[0] < high - 0.2:
            place = (step.position[0], -0.04)
            axis.annotate(step.foot, place, ha="center", va="top", fontsize=7.5, color=_COLORS[step.foot])
    axis.legend(loc="lower right", fontsize=8, ncols=3, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    axis.set_xticks(np.arange(np.ceil(2 * low), 2 * high) / 2)
    axis.spines["bottom"].set_visible(True)
    axis.set_xlabel("x [m]")
    axis.set_title("Simulated gait where it was walked, every tenth of a step")


def _strip(figure: Figure, top: float, walk: Walk, view: tuple[int, int]) -> Axes:
    """A stride as frames beside each other, with the measured force on either foot.

    Bodies are simulated; the motion's are thin lines over them, the plan's COM is a ring around theirs.
    """
    spacing = 1.02 if view == SIDE else 0.92
    record, measured = walk.trial.record, walk.trial.measured
    axis, scale = _floor(figure, top, _STRIP, -0.55 * spacing, (_FRAMES - 0.45) * spacing)
    ring: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": PLAN}
    # Per step: toe off, two instants of the swing, middle of the double support; then the next toe off.
    single, step = walk.double_supports[0]
    instants = [0.004 * single, 0.35 * single, 0.7 * single, 0.5 * (single + step)]
    times = [*instants, *(step + t for t in instants), 2 * step + instants[0]]
    names = ["toe off", "swing", "swing", "double support"]
    for index, at in enumerate(times):
        row = min(walk.row(walk.middle + at), len(measured.time) - 1)
        body = pose(walk.robot, walk.configuration(row))
        shift = index * spacing - (float(body.com[0]) if view == SIDE else 0.0)
        _draw(axis, body, view, shift=shift, points_per_metre=scale)
        for segment in pose(walk.robot, walk.motion.sample(record.time[row], walk.robot).q[0]).segments:
            x, z = segment.points[:, view].T
            axis.plot(x + shift, z, color=MOTION, linewidth=0.8, zorder=5)
        planned = walk.plan.sample(record.time[row]).com[0]
        axis.plot(
            planned[view[0]] + shift, planned[2], "o", markersize=8.5, markeredgewidth=2.2, zorder=5.9, **ring
        )
        com = body.com[view[0]] + shift, body.com[2]
        axis.plot(*com, "o", markersize=5.2, markerfacecolor="white", markeredgecolor=INK,
                  markeredgewidth=0.9, zorder=6)  # fmt: skip
        axis.plot(*com, "o", markersize=1.8, color=INK, zorder=7)
        for foot, force in enumerate(measured.foot_force[row]):
            if force[2] >= _LOADED * measured.weight:
                points = record.point_foot == foot
                load = record.point_force[row][points, 2]
                centre = (load @ record.point_position[row][points]) / load.sum()
                start = np.array([centre[view[0]] + shift, 0.0])
                length = _WEIGHT_LENGTH / measured.weight
                arrow(axis, start, start + force[list(view)] * length, width=1.6, zorder=8)
        axis.text(
            index * spacing, -0.06, f"{100 * at / walk.stride:.0f} %\n{names[index % 4]}", ha="center",
            va="top", fontsize=7.5, color=INK if index % 4 == 3 else FAINT,
        )  # fmt: skip
    for color, width, label in (
        (LEFT, 3.0, "left"),
        (RIGHT, 3.0, "right"),
        (FORCE, 1.6, f"ground force (1 body weight: {_WEIGHT_LENGTH:g} m)"),
        (MOTION, 0.8, "IK"),
    ):
        axis.plot([], [], color=color, linewidth=width, label=label)
    axis.plot([], [], "o", markersize=6, markeredgewidth=2.0, label="COM, plan", **ring)
    axis.legend(
        loc="lower right", fontsize=8, ncols=5, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2,
        columnspacing=1.0, handlelength=1.4, handletextpad=0.4,
    )  # fmt: skip
    # Frames are side by side: a scale replaces the coordinate.
    right, level = (_FRAMES - 0.47) * spacing, axis.get_ylim()[1] - 0.12
    axis.plot([right - 0.5, right], [level, level], color=INK, linewidth=1.2)
    for x in (right - 0.5, right):
        axis.plot([x, x], [level - 0.025, level + 0.025], color=INK, linewidth=0.8)
    axis.text(right - 0.54, level, "0.5 m", ha="right", va="center", fontsize=8)
    return axis


def _floor(
    figure: Figure, top: float, height: float, low: float, high: float, below: float = 0.36
) -> tuple[Axes, float]:
    """Axes with equal scales for bodies on a floor, and their points per metre."""
    width = _WIDTH - 0.8
    axis = inches(figure, 0.6, top, width, height)
    axis.set_xlim(low, high)
    axis.set_ylim(-below, (high - low) * height / width - below)
    axis.grid(False)
    axis.set_xticks([])
    axis.set_yticks([0.0, 0.5, 1.0, 1.5])
    axis.set_ylabel("z [m]")
    for spine in axis.spines.values():
        spine.set_visible(False)
    axis.fill_between([low, high], -0.03, 0.0, color=SHADE, linewidth=0, zorder=0)
    axis.plot([low, high], [0, 0], color=FAINT, linewidth=0.8, zorder=1)
    return axis, 72.0 * width / (high - low)


def _stride_axis(axis: Axes, walk: Walk) -> None:
    shade(axis, [(a / walk.stride, b / walk.stride) for a, b in walk.double_supports])
    axis.set_xlim(0.0, 1.0)
    axis.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100"])
    axis.set_xlabel("share of the stride [%]")


def _compare(
    figure: Figure, top: float, walks: Sequence[Walk], component: int, what: str, labels: Sequence[str]
) -> None:
    """Angle of the trunk and angular momentum of two walks; below, the deviation of the simulation."""
    axes = [
        inches(figure, x, top + y, 3.7, height)
        for x in (0.9, 5.65)
        for y, height in ((0.0, 1.6), (2.1, 0.85))
    ]
    for axis in axes:
        _stride_axis(axis, walks[0])
        zero_line(axis)
    left, left_error, right, right_error = axes
    letter = "xy"[component]
    tolerances = [walk.limit(f"angular_momentum_{letter}_rmse") for walk in walks]
    for walk, label, line, tolerance in zip(walks, labels, _LINES, tolerances, strict=True):
        share, motion, angles = trunk(walk, what)
        curves(left, share, None, motion, angles, label=label, line=line)
        difference(left_error, share, None, angles - motion, line=line)
        share = walk.phase / walk.stride
        planned = walk.plan.sample(walk.stride_starts[0] + walk.phase).angular_momentum[:, component]
        away, errors = walk.away("angular_momentum", component)
        motion, simulated = planned + away, planned + errors
        curves(right, share, planned, motion, simulated, tolerance=tolerance, label=label, line=line)
        note = "" if len(set(tolerances)) == 1 else f", {label}"
        difference(right_error, share, away, errors, tolerance=tolerance, unit="N m s", line=line, note=note)
    left.set_title(f"{what} of the trunk, {'to the right' if what == 'roll' else 'forward'} (no plan has it)")
    right.set_title(f"angular momentum about the COM, $L_{letter}$")
    units = ("[°]", "less IK\n[°]", "[N m s]", "less plan\n[N m s]")
    for axis, unit in zip(axes, units, strict=True):
        axis.set_ylabel(unit)
    for axis in (left, right):
        legend_above(axis, 2)
        axis.set_xlabel("")
        axis.tick_params(labelbottom=False)
    for axis in (left_error, right_error):
        band_legend(axis)


def trunk(walk: Walk, what: str) -> tuple[Array, Array, Array]:
    """Roll or pitch of the trunk over a stride.

    Returns:
        Share of the stride, shape (n,); angle in the motion, (n,), and in the simulation, (strides, n) [°].
    """
    record = walk.trial.record
    rows = np.unique([*range(0, len(record.time), 3), len(record.time) - 1])
    simulated = lean(walk.robot, walk.configuration(rows), what)
    return (
        walk.phase[::4] / walk.stride,
        lean(walk.robot, walk.motion_sample.q[::4], what),
        walk.folded(simulated, record.time[rows])[:, ::4],
    )


def lean(robot: Robot, q: Array, what: str) -> Array:
    """Roll (about +x, to the right positive) or pitch (about +y, forward positive) of the trunk [°].

    Args:
        robot: the body.
        q: Pinocchio configurations, shape (n, nq).
        what: ``roll`` or ``pitch``.
    """
    upwards = robot.trunk_rotations(q)[:, :, 2]
    sideways = -upwards[:, 1] if what == "roll" else upwards[:, 0]
    return np.degrees(np.arctan2(sideways, upwards[:, 2]))


def _swing(planned: PlannedWalk) -> dict[str, float]:
    """Planned momentum about the forward axis and the trunk's roll in the motion, without a walk."""
    robot, plan = planned.body.robot, planned.plan
    stride = np.linspace(0.0, 2.0 * float(plan.constants.step_duration), 200, endpoint=False)
    roll = lean(robot, planned.motion.sample(stride, robot).q, "roll")
    momentum = plan.sample(stride[stride <= plan.duration]).angular_momentum[:, 0]
    return {
        "planned_L_x_peak_Nms": float(np.abs(momentum).max()),
        "trunk_roll_swing_deg": float(np.ptp(roll)),
    }


def numbers(walk: Walk) -> dict[str, float]:
    """Largest trunk angles [°] and momenta [N m s] of a gait in the simulation."""
    _, roll, rolls = trunk(walk, "roll")
    _, pitch, pitches = trunk(walk, "pitch")
    found = {
        "trunk_roll_largest_deg": np.abs(rolls).max(),
        "trunk_pitch_smallest_deg": pitches.min(),
        "trunk_pitch_largest_deg": pitches.max(),
        "trunk_roll_simulation_less_ik_deg": np.abs(rolls - roll).max(),
        "trunk_pitch_simulation_less_ik_deg": np.abs(pitches - pitch).max(),
    }
    for k, axis in enumerate("xy"):
        motion, simulated = walk.away("angular_momentum", k)
        found[f"L_{axis}_ik_less_plan_Nms"] = np.abs(motion).max()
        found[f"L_{axis}_simulation_less_plan_Nms"] = np.abs(simulated).max()
    planned = np.abs(walk.plan.sample(walk.middle + walk.phase).angular_momentum).max(axis=0)
    measured = np.abs(walk.folded(walk.trial.measured.angular_momentum)).max(axis=(0, 1))
    found |= {f"planned_L_{axis}_peak_Nms": peak for axis, peak in zip("xy", planned, strict=True)}
    found |= {f"measured_L_{axis}_peak_Nms": peak for axis, peak in zip("xyz", measured, strict=True)}
    return {name: float(value) for name, value in found.items()}

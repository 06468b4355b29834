"""Bodies drawn as rounded segments, posed by forward kinematics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from ampm.body.robot import Robot
from validation.paper.figures.canvas import INK, LEFT, RIGHT, TRUNK

Array = NDArray[np.float64]

SIDE, FRONT = (0, 2), (1, 2)
"""Views: world axes drawn to the right and upwards. The side view is from the body's right, the front view
faces the body, so its left is on the right."""

_HAND = 0.055  # of stature
_HEAD_RADIUS = 0.058
_HEAD_OVER_SHOULDERS = 0.112
_WIDTHS = {"thigh": 0.062, "shank": 0.046, "foot": 0.028, "toe": 0.022, "arm": 0.036, "trunk": 0.098,
           "shoulders": 0.05, "hips": 0.062, "neck": 0.04}  # fmt: skip
"""Thickness of the segments, as shares of stature; for the eye only."""
_SLIM = 0.3  # thinner bodies are traces, with an outlined head


@dataclass(frozen=True)
class Segment:
    """A chain of points of one thickness.

    Attributes:
        points: in world, shape (k, 3) [m].
        width: thickness [m].
        side: ``left``, ``right`` or ``trunk``.
    """

    points: Array
    width: float
    side: str


@dataclass(frozen=True)
class Pose:
    """A posed body.

    Attributes:
        segments: what to draw.
        head: centre of the head, shape (3,) [m].
        head_radius: [m].
        com: centre of mass, shape (3,) [m].
        trunk_roll: rotation of the trunk about +x, to the right positive [rad].
        trunk_pitch: rotation of the trunk about +y, forward positive [rad].
    """

    segments: tuple[Segment, ...]
    head: Array
    head_radius: float
    com: Array
    trunk_roll: float
    trunk_pitch: float


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

    stature, segments = body.height, []
    girdle = np.array([joint(arm[0]) for arm in (body.left_arm, body.right_arm)])
    shoulders = girdle.mean(axis=0)
    for side, leg, arm in (("left", body.left_leg, body.left_arm), ("right", body.right_leg, body.right_arm)):
        hip, knee, ankle, ball = joint(leg.hip[0]), joint(leg.knee), joint(leg.ankle[0]), joint(leg.toe)
        points = [frame(name) for name in leg.sole_points]
        heel, front, tip = (np.mean(points[k : k + 2], axis=0) for k in (0, 2, 4))
        wrist_joint = model.getJointId(arm[-1])
        wrist = np.array(data.oMi[wrist_joint].translation)
        hand = wrist - _HAND * stature * data.oMi[wrist_joint].rotation[:, 2]
        for chain, kind in (
            ([hip, knee], "thigh"),
            ([knee, ankle], "shank"),
            ([ankle, heel, front, ankle], "foot"),
            ([ball, tip], "toe"),
            ([joint(arm[0]), joint(arm[3]), wrist, hand], "arm"),
        ):
            segments.append(Segment(np.array(chain), _WIDTHS[kind] * stature, side))
    sockets = np.array([joint(leg.hip[0]) for leg in body.legs])
    hips = sockets.mean(axis=0)
    rotation = np.array(data.oMf[robot.trunk_frame].rotation)
    spine = np.array([hips, joint(body.waist[0]), joint(body.chest[0]), shoulders])
    head = shoulders + _HEAD_OVER_SHOULDERS * stature * rotation[:, 2]
    segments += [
        Segment(chain, _WIDTHS[kind] * stature, "trunk")
        for chain, kind in (
            (np.array([shoulders, head]), "neck"),
            (girdle, "shoulders"),
            (sockets, "hips"),
            (spine, "trunk"),
        )
    ]
    return Pose(
        segments=tuple(segments),
        head=head,
        head_radius=_HEAD_RADIUS * stature,
        com=com,
        trunk_roll=float(np.arctan2(-rotation[1, 2], rotation[2, 2])),
        trunk_pitch=float(np.arctan2(rotation[0, 2], rotation[2, 2])),
    )


def draw(
    axis: Axes,
    body: Pose,
    view: tuple[int, int],
    *,
    shift: float = 0.0,
    points_per_metre: float,
    alpha: float = 1.0,
    slim: float = 1.0,
) -> None:
    """Draw a body.

    Args:
        axis: axes in metres, equal scales.
        body: the pose.
        view: :data:`SIDE` or :data:`FRONT`.
        shift: added to the horizontal coordinate [m].
        points_per_metre: scale of the axes, for the segments' thickness.
        alpha: opacity.
        slim: factor on the thickness.
    """
    colors = {"left": LEFT, "right": RIGHT, "trunk": TRUNK}
    depth = 1 if view == SIDE else 0
    toward_viewer = -1.0 if view == SIDE else 1.0

    def nearness(segment: Segment) -> float:
        return toward_viewer * float(segment.points[:, depth].mean())

    for order, segment in enumerate(sorted(body.segments, key=nearness)):
        flat = segment.points[:, view]
        x, z = flat[:, 0] + shift, flat[:, 1]
        width = slim * segment.width * points_per_metre
        # Limbs cross each other; traces are too thin for borders.
        border = () if segment.side == "trunk" or slim < _SLIM else (("white", 1.1),)
        for color, extra in (*border, (colors[segment.side], 0.0)):
            axis.plot(
                x, z, color=color, linewidth=max(width + extra, 0.4), alpha=alpha, zorder=3 + 0.02 * order,
                solid_capstyle="round", solid_joinstyle="round",
            )  # fmt: skip
    centre = (float(body.head[view[0]]) + shift, float(body.head[view[1]]))
    fill: dict[str, Any] = {"facecolor": TRUNK, "edgecolor": "none"}
    if slim < _SLIM:
        fill = {"facecolor": "none", "edgecolor": TRUNK, "linewidth": 0.4}
    axis.add_patch(Circle(centre, body.head_radius, alpha=alpha, zorder=4, **fill))


def outline(axis: Axes, body: Pose, view: tuple[int, int], color: str, *, shift: float = 0.0) -> None:
    """Draw a posed body as thin lines over another one.

    Args:
        axis: axes in metres, equal scales.
        body: the pose.
        view: :data:`SIDE` or :data:`FRONT`.
        color: of the lines.
        shift: added to the horizontal coordinate [m].
    """
    for segment in body.segments:
        flat = segment.points[:, view]
        axis.plot(flat[:, 0] + shift, flat[:, 1], color=color, linewidth=0.8, zorder=5)


def mark_com(axis: Axes, body: Pose, view: tuple[int, int], *, shift: float = 0.0) -> None:
    """The usual sign of a centre of mass."""
    at = (float(body.com[view[0]]) + shift, float(body.com[view[1]]))
    axis.plot(
        *at, "o", markersize=5.2, markerfacecolor="white", markeredgecolor=INK, markeredgewidth=0.9, zorder=6
    )
    axis.plot(*at, "o", markersize=1.8, color=INK, zorder=7)

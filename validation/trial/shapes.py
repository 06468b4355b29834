"""Clearance of a body's parts: arms from legs, from the trunk and from each other, and leg from leg.

Only the soles of the body collide, so parts of the body can penetrate each other. The distances are MuJoCo's,
between the drawn shapes.
"""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.body.robot import Gaps
from ampm.compiled import compiled
from ampm.geometry import Array
from ampm.vectors import Vector, column, dot, minus, plus, put, turned, vector
from validation.trial.coordinates import to_mujoco

REACH = 0.1
"""Largest distance that is computed [m]."""
_SHORT = 0.05  # length of a segment between hinges of one joint, over the height of the body [1]
TRUNK = 0
"""Number of the trunk; limbs are numbered from 1."""


class Shapes:
    """Shapes of a compiled body and the pairs of them that must keep apart; ``only_legs`` those of both legs.

    The trunk is the root, the segment ``trunk``, what lies between them, and all that bears several limbs. A
    limb is a chain of segments from there to a free end, a leg one that has sole points. Left out are pairs
    within one limb or the trunk, of segments that a joint connects, directly or by way of short segments
    between its hinges, of leg and trunk, and of shapes that are drawn into each other: they overlap with all
    joints at 0.
    """

    def __init__(self, model: mujoco.MjModel, trunk: str | None = None, *, only_legs: bool = False) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        own = model.geom_bodyid > 0
        touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        limb = _limbs(model.body_parentid, model.body(trunk).id if trunk else 1)
        leg = np.isin(limb, limb[model.geom_bodyid[own & touches]])
        shapes = np.flatnonzero(own & ~touches)
        pairs = shapes[np.stack(np.triu_indices(len(shapes), 1))]
        segments = model.geom_bodyid[pairs]
        limbs, legs = limb[segments], leg[segments]
        exempt = (limbs[0] == limbs[1]) | (legs.any(axis=0) & (limbs == TRUNK).any(axis=0))
        if only_legs:
            exempt |= ~legs.all(axis=0)
        pairs, segments = pairs[:, ~exempt], segments[:, ~exempt]
        apart = [
            not self._joined(a, b)
            and not self._joined(b, a)
            and mujoco.mj_geomDistance(model, self._data, *pair, REACH, None) >= 0.0
            for pair, (a, b) in zip(pairs.T.tolist(), segments.T.tolist(), strict=True)
        ]
        self._pairs = pairs[:, np.array(apart, dtype=bool)]
        ellipsoid = model.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID
        self.boxes = model.geom_aabb.reshape(-1, 2, 3), ellipsoid, np.ascontiguousarray(self._pairs.T)
        segment = [str(model.body(number).name).replace("_", " ") for number in model.geom_bodyid.tolist()]
        self._names = [f"{segment[a]} and {segment[b]}" for a, b in self._pairs.T.tolist()]

    def _joined(self, upper: int, lower: int) -> bool:
        """Whether a joint connects a segment with one below it."""
        model, anchors = self._model, self._data.xanchor
        parent = int(model.body_parentid[lower])
        while parent > 0 and parent != upper:
            hinges = model.body_jntadr[[parent, lower]]
            way = float(np.linalg.norm(anchors[hinges[0]] - anchors[hinges[1]]))
            if not way < _SHORT * 2.0 * model.stat.center[2]:
                return False
            parent, lower = int(model.body_parentid[parent]), parent
        return parent == upper

    def __len__(self) -> int:
        """Number of pairs of shapes that must keep apart."""
        return int(self._pairs.shape[1])

    def gaps(self, q: Array) -> Gaps:
        """Parts that come closest at Pinocchio configurations (T, nq)."""
        return self.recorded_gaps(to_mujoco(q, np.zeros((len(q), self._model.nv)))[0])

    def tilts(self, qpos: Array, segments: Sequence[str]) -> Array:
        """Angles of M segments from upright at MuJoCo configurations (T, nq), shape (T, M) [rad]."""
        model, data = self._model, self._data
        numbers = [model.body(name).id for name in segments]
        upright = np.empty((len(qpos), len(numbers)))
        for row, configuration in enumerate(qpos):
            data.qpos[:] = configuration
            mujoco.mj_kinematics(model, data)
            upright[row] = data.xmat[numbers, 8]
        return np.arccos(np.clip(upright, -1.0, 1.0))

    def recorded_gaps(self, qpos: ArrayLike) -> Gaps:
        """Parts that come closest at MuJoCo configurations (T, nq)."""
        model, data, pairs = self._model, self._data, self._pairs.T.tolist()
        configurations = np.atleast_2d(np.asarray(qpos, dtype=np.float64))
        distance = np.full(len(configurations), REACH)
        points = np.full((len(configurations), 2, 3), np.nan)
        parts = []
        ends = np.zeros(6)
        for row, configuration in enumerate(configurations):
            data.qpos[:] = configuration
            mujoco.mj_kinematics(model, data)
            bound = least_distances(*self.boxes, data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3))
            close = np.flatnonzero(bound < REACH)
            close = close[np.argsort(bound[close])]
            best, nearest = REACH, -1
            for pair, least in zip(close.tolist(), bound[close].tolist(), strict=True):
                if least >= best:
                    break
                found = mujoco.mj_geomDistance(model, data, *pairs[pair], best, ends)
                if found < best:
                    best, nearest, points[row] = found, pair, ends.reshape(2, 3)
            distance[row] = best
            parts.append("" if nearest < 0 else self._names[nearest])
        return Gaps(distance, tuple(parts), points)


@compiled
def least_distances(
    boxes: Array, ellipsoid: NDArray[np.bool_], pairs: NDArray[np.intp], place: Array, turn: Array
) -> Array:
    """Lower bound of the distance of the shapes of N pairs, on the line between the middles of their boxes.

    Args:
        boxes: middle and half sizes of the box about every shape, in its axes, shape (G, 2, 3) [m].
        ellipsoid: which shapes fill their boxes as ellipsoids, shape (G,).
        pairs: numbers of the shapes, shape (N, 2).
        place: of every shape, in world, shape (G, 3) [m].
        turn: its axes to world, shape (G, 3, 3).

    Returns:
        Negative where the boxes overlap along the line, shape (N,) [m].
    """
    least, middle, size = np.empty(len(pairs)), np.empty((len(boxes), 3)), np.empty(len(boxes))
    for i in range(len(boxes)):
        put(middle[i], plus(vector(place[i]), turned(turn[i], vector(boxes[i, 0]))))
        size[i] = math.sqrt(dot(vector(boxes[i, 1]), vector(boxes[i, 1])))
    for k in range(len(pairs)):
        a, b = pairs[k]
        way = minus(vector(middle[b]), vector(middle[a]))
        length = max(math.sqrt(dot(way, way)), 1e-9)
        least[k] = length - size[a] - size[b]
        if least[k] < REACH:
            reach = _reach(boxes[a, 1], ellipsoid[a], turn[a], way)
            least[k] = length - (reach + _reach(boxes[b, 1], ellipsoid[b], turn[b], way)) / length
    return least


@compiled
def _reach(half: Array, ellipsoid: bool, turn: Array, way: Vector) -> float:
    """How far a shape reaches from the middle of its box along a way, times the way's length."""
    total = 0.0
    for i in range(3):
        part = half[i] * abs(dot(column(turn, i), way))
        total += part * part if ellipsoid else part
    return math.sqrt(total) if ellipsoid else total


def _limbs(parents: NDArray[np.integer], trunk: int) -> NDArray[np.intp]:
    """Limb of each segment, from the parents of all, the world's first, and the number of the trunk."""
    limb = np.full(len(parents), TRUNK)
    children = np.bincount(parents[1:], minlength=len(parents))
    for number, end in enumerate(np.flatnonzero(children == 0).tolist(), 1):
        segment = end
        while segment > 0 and children[segment] <= 1:
            limb[segment] = number
            segment = int(parents[segment])
    while trunk > 0:
        limb[trunk] = TRUNK
        trunk = int(parents[trunk])
    return limb

"""A description file proposed from a model alone: root, trunk, feet, knees, sole and what must be locked."""

import math
import os
from itertools import combinations
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import tomli_w
from scipy.spatial import ConvexHull, QhullError

from ampm.exceptions import InputError
from ampm.geometry import Array
from models.load import LEG_JOINTS, sole_turn
from models.source import MASSLESS, compiled_source, pattern_of, source_path
from models.tree import at_zero, coupled_joints, joints_above, motor_limits, upright_axes

_LATERAL = 0.8  # least share of a hinge's axis along left and right, to bend hip, knee or ankle [1]
_LEVEL = 0.05  # largest angle between parts of one sole, or from the level [rad]
_NO_SOLE = """
# The left foot has no flat shape that is level along y, or its meshes are not found from the model's folder.
# Fill in [body.sole]: heel, front, bottom, heel_half_width, front_half_width [m].
"""
_LOCKED = """
# lock has toes, and joints of no leg that are coupled, no hinges, or lack mass or a torque limit.
# To move one that lacks only the limit, give it in [body.effort] and leave it out of lock.
"""
_BACKWARD = "# As its knees bend, it walks along -x of its model; left and right are seen that way.\n"
_STEEP = 0.7  # largest angle of a sole from the level with all joints at 0 [rad]
_BESIDE, _SPREAD = 0.07, 0.4  # from the middle to a shoulder over the leg [1], and of an arm at rest [rad]
_HEAD = 0.2  # mass of what hangs on the trunk, over the trunk's, if it is no further part of it [1]
_NARROW = 0.05  # least half width of a sole over its length [1]
_MAIN = 1 / 3  # least share of a foot's underside in its sole; of one that is round each part is small [1]
_DIGITS = 6  # of points of a flat part [m]: edges that are turned by rounded angles stay edges
_INSETS = np.linspace(0.0, 0.25, 11)  # of heel and front from the ends of the outline, over its length [1]
_RING = np.array([(np.cos(a), np.sin(a), 0.0) for a in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)])
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def propose(source: str, folder: Path) -> str:
    """Text of a description file.

    Args:
        source: model, as in a description: a file, from the present folder, or PACKAGE:FILE.
        folder: where the description will be.

    Raises:
        InputError: there is no such model, or it has no two legs.
    """
    path, balance = source_path(source, Path()), {}
    try:
        model, _ = compiled_source(path)
    except InputError:
        balance = {"balance_inertia": True}
        model, _ = compiled_source(path, balance=True)
    where = source if ":" in source else Path(os.path.relpath(path, folder)).as_posix()
    proposal = _Proposal(model)
    body = {"source": where} | balance | proposal.keys()
    text = tomli_w.dumps({"body": body}) + ("" if "sole" in body else _NO_SOLE) + _LOCKED * ("lock" in body)
    return text if proposal.axes[0, 0] > -_LATERAL else _BACKWARD + text


class _Proposal:
    """Roles of the segments and joints of a model with all joints at 0."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, at_zero(model)
        self.chains = joints_above(model)
        self.feet = self._ends()
        self.root = int(model.body_rootid[self.feet[0]])
        self.axes = upright_axes(self.data, self.feet)
        left = self.data.xaxis @ self.axes[1]
        chains = [self.chains[end] for end in self.feet]
        legs = [sorted(chain - other) for chain, other in (chains, chains[::-1])]
        bends = [[joint for joint in leg[:LEG_JOINTS] if abs(left[joint]) > _LATERAL] for leg in legs]
        toes = [joint for leg in legs for joint in leg[LEG_JOINTS:]]
        # Behind the bends of hip, knee and ankle, what bends within a range are toes.
        if min(map(len, bends)) > 2 and all(abs(left[toes]) > _LATERAL) and all(model.jnt_limited[toes]):
            self.feet = [int(model.jnt_bodyid[leg[:LEG_JOINTS][-1]]) for leg in legs]
        count, names = len(legs[0]), " and ".join(model.body(end).name for end in self.feet)
        if count < LEG_JOINTS - 1 or min(map(len, bends)) < 2:
            flat = f"a sole flat: that takes {LEG_JOINTS}, or {LEG_JOINTS - 1} without a roll of the ankle"
            lack = f"{count} joints, which cannot hold {flat}" if count < LEG_JOINTS - 1 else "no knee"
            raise InputError(
                f"the model has no legs to walk on: what ends at {names} has {lack}; take another."
            )
        self.knees = [joints[1] for joints in bends]
        self.beside = _BESIDE * math.dist(self.data.xanchor[legs[0][0]], self.data.xpos[self.feet[0]])
        self.legs = self.chains[self.feet[0]] | self.chains[self.feet[1]]
        # A knee bends about the axis to the left by more than it can be stretched.
        if left[self.knees[0]] * model.jnt_range[self.knees[0]].sum() < 0.0:
            self.feet.reverse()
            self.knees.reverse()
            self.axes[:2] *= -1.0

    def _ends(self) -> list[int]:
        """The two ends of equally long chains that are farthest below all other mass, with z or y up."""
        model, data, chains = self.model, self.data, self.chains
        moving = [body for body in range(1, model.nbody) if model.body_jntnum[body] and chains[body]]
        ends = [b for b in moving if not any(chains[b] < chains[other] for other in moving)]
        depth, found = 0.0, list[int]()
        for one, two in combinations(ends, 2):
            own, limbs = model.body_rootid == model.body_rootid[one], chains[one] ^ chains[two]
            heavy = np.flatnonzero(own & (model.body_mass > MASSLESS)).tolist()
            rest = [body for body in heavy if limbs.isdisjoint(chains[body])]
            _, left, up = upright_axes(data, [one, two])
            alike = len(chains[one]) == len(chains[two]) and own[two] and left.any() and max(up[1:]) > 0.0
            below = min(data.xipos[rest] @ up, default=0.0) - float((data.xpos[[one, two]] @ up).mean())
            if alike and below > depth:
                depth, found = below, [one, two]
        if not found:
            raise InputError(
                "the model has no legs to walk on: no two chains of as many joints hang on one segment that "
                "is not the world and end below all else, with z or y up and all joints at 0; take another."
            )
        return found

    def keys(self) -> dict[str, Any]:
        """Keys of the description, without its source."""
        body, joint, locked = self.model.body, self.model.joint, self._locked()
        sole = fit_sole((self._foot_points() - self.data.xpos[self.feet[0]]) @ self.axes.T)
        return {
            "root": body(self.root).name,
            "trunk": body(self._trunk()).name,
            "foot": [body(foot).name for foot in self.feet],
            "knee": [joint(knee).name for knee in self.knees],
            **self._rest(self.legs.union(locked)),
            **({"lock": [pattern_of(joint(number).name) for number in locked]} if locked else {}),
            **({"sole": sole} if sole else {}),
        }

    def _trunk(self) -> int:
        """The last moving segment on the way outwards along most of the mass, without legs and arms."""
        model, here, found = self.model, self.root, self.root
        side = np.abs((self.data.xpos - self.data.xpos[self.root]) @ self.axes[1])
        while True:
            below = np.flatnonzero(model.body_parentid == here)
            below = below[[self.legs.isdisjoint(self.chains[body]) for body in below]]
            mass = model.body_subtreemass[below]
            if not mass.size or not mass.max() > max(0.5 * mass.sum(), _HEAD * model.body_mass[here]):
                return found
            here = int(below[mass.argmax()])
            if side[here] > self.beside:
                return found
            found = here if model.body_jntnum[here] else found

    def _locked(self) -> list[int]:
        """Toes, and joints of no leg that are coupled, no hinges, or without motor or mass."""
        model, coupled, limits = self.model, coupled_joints(self.model), motor_limits(self.model)
        others = np.flatnonzero(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE).tolist()
        return [
            joint
            for joint in others
            if joint not in self.legs
            and (
                model.joint(joint).name in coupled
                or any(self.chains[foot] < self.chains[model.jnt_bodyid[joint]] for foot in self.feet)
                or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE
                or not 0.0 < limits.get(joint, np.inf) < np.inf
                or not model.body_subtreemass[model.jnt_bodyid[joint]] > MASSLESS
            )
        ]

    def _rest(self, others: set[int]) -> dict[str, Any]:
        """The key ``rest``: first hinge, not of ``others``, that spreads an arm of a pair, and its angle."""
        model, places = self.model, (self.data.xanchor - self.data.xpos[self.root]) @ self.axes.T
        for joint, forward in enumerate(self.data.xaxis @ self.axes[0]):
            paired = np.abs(places - places[joint] * (1.0, -1.0, 1.0)).max(axis=1).min() < self.beside
            if joint not in others and paired and places[joint, 1] > self.beside and abs(forward) > _LATERAL:
                angle = math.copysign(_SPREAD, forward)
                low, high = model.jnt_range[joint]
                if not model.jnt_limited[joint] or low < angle < high:
                    return {"rest": {model.joint(joint).name: angle}}
        return {}

    def _foot_points(self) -> Array:
        """Points of the shapes of the left foot and of all that hangs on it, in world, shape (n, 3) [m]."""
        model, data, found = self.model, self.data, [np.empty((0, 3))]
        mine = [body for body, chain in enumerate(self.chains) if self.chains[self.feet[0]] <= chain]
        for geom in np.flatnonzero(np.isin(model.geom_bodyid, mine)).tolist():
            points = _shape_points(model, geom)
            found.append(points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
        return np.concatenate(found)


def fit_sole(points: Array) -> dict[str, float]:
    """Keys of the sole under some points of a foot, (n, 3) from its origin [m]; none without a flat part.

    The outline is the largest trapezoid in the largest flat part that is symmetric about a line along x.
    """
    try:
        hull = ConvexHull(points)
        under = hull.equations[:, 2] < -np.cos(_STEEP)
        corners, normal = points[hull.simplices[under]], hull.equations[under, :3]
        sides = corners[:, 1:] - corners[:, :1]
        area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        alike = normal @ normal.T > np.cos(_LEVEL)
        flat = alike[(alike @ area).argmax()]
        down = area[flat] @ normal[flat]
        pitch = float(np.arctan2(-down[0], -down[2]))
        pitch = pitch if abs(pitch) > _LEVEL else 0.0
        part = np.round(corners[flat].reshape(-1, 3) @ sole_turn(pitch), _DIGITS)
        outline = part[ConvexHull(part[:, :2]).vertices, :2]
    except (QhullError, ValueError):  # too few points, or all in one plane
        return {}
    outline = np.roll(outline, -int(outline[:, 0].argmin()), axis=0)  # counterclockwise from the heel
    front = int(outline[:, 0].argmax())
    x = outline[0, 0] + (outline[front, 0] - outline[0, 0]) * np.linspace(1e-6, 1.0 - 1e-6, 101)
    low = np.interp(x, *outline[: front + 1].T)
    high = np.interp(x, *np.vstack([outline[front:], outline[:1]])[::-1].T)
    middle = float(0.5 * (low + high)[50])
    half = np.maximum(np.minimum(high - middle, middle - low), 0.0)
    length = x[-1] - x[0]
    trapezoids = [(x[0] + a * length, x[-1] - b * length) for a in _INSETS for b in _INSETS]
    halves = [np.interp(ends, x, half) for ends in trapezoids]
    size = [(ends[1] - ends[0]) ** 2 * pair.prod() for ends, pair in zip(trapezoids, halves, strict=True)]
    k = int(np.argmax(size))
    keys = ("heel", "front", "bottom", "heel_half_width", "front_half_width", "middle", "pitch")
    found = (*trapezoids[k], np.median(part[:, 2]), *halves[k], middle, pitch)
    values = {key: round(float(value), 4) for key, value in zip(keys, found, strict=True)}
    values = {key: value for key, value in values.items() if value or key not in ("middle", "pitch")}
    level = abs(down[1]) < _LEVEL * np.linalg.norm(down) and area[flat].sum() > _MAIN * area.sum()
    return values if level and halves[k].min() > _NARROW * length else {}  # else a line or a point


def _shape_points(model: mujoco.MjModel, geom: int) -> Array:
    """Points of one shape in its own axes, shape (n, 3) [m]."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
    size = model.geom_size[geom]
    if kind == "MESH":
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        return np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=np.float64)
    if kind == "BOX":
        return _CORNERS * size
    if kind in ("CAPSULE", "CYLINDER"):
        ends = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
        return np.concatenate([size[0] * _RING + end for end in ends])
    return np.concatenate([np.eye(3), -np.eye(3)]) * (size[0] if kind == "SPHERE" else size)

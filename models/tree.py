"""The segments of a compiled source at joint angles of 0, in axes of the world, and their mirror image.

Left and right are made mirror images, which a periodic motion needs, by the mean of both.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.section import unknown
from models.scene import Findings, Inertial, quaternion
from models.source import DRAWN, MASSLESS, BodyFile, by_pattern

_MIRROR = np.array([1.0, -1.0, 1.0])  # of a vector; of an axis of rotation with the opposite sign
_ALIKE = 0.02  # largest difference of mirrored places over the body's height, and of masses [1]
_UNLIKE = 0.05  # largest angle between an axis and its image [rad]
_FREE, _HINGE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "mesh": 0}
"""Drawn shapes and how many sizes they have."""
_DROPPED = {
    "springs, dampers or dry friction of tendons": (
        "tendon_stiffness",
        "tendon_stiffnesspoly",
        "tendon_damping",
        "tendon_dampingpoly",
        "tendon_frictionloss",
    ),
    "springs or dampers that are not linear": ("jnt_stiffnesspoly", "dof_dampingpoly"),
    "dampers of motors": ("actuator_damping", "actuator_dampingpoly"),
    "segments without their weight (gravcomp)": ("body_gravcomp",),
}
"""Passive forces that no joint has, and the fields of a model that have them."""
_SMALL = 0.5  # extent of what collides over that of what is drawn: less are points that touch the floor [1]
_DIGITS = 5  # of the points of a hull [m]


@dataclass
class Hinge:
    """A hinge at angle 0: anchor from its segment's origin [m], axis, and its own values."""

    name: str
    anchor: Array
    axis: Array
    low: float
    high: float
    effort: float
    speed: float
    armature: float
    damping: float
    stiffness: float
    spring: float
    friction: float


@dataclass
class Segment:
    """A moving segment at angle 0, with what is fixed to it; vectors from its origin in axes of the world."""

    name: str
    parent: int
    place: Array  # from the root's origin
    joints: list[Hinge]
    inertial: Inertial = field(default_factory=lambda: Inertial(0.0, np.zeros(3), np.zeros((3, 3))))
    shapes: list[dict[str, Any]] = field(default_factory=list)


class Tree:
    """The segments of a compiled source."""

    def __init__(self, file: BodyFile, model: mujoco.MjModel, speeds: Mapping[str, float]) -> None:
        self.file, self.model, self.speeds = file, model, speeds
        self._check_source()
        self.efforts = _motor_limits(model)
        root = self.body(file.root, "root")
        self.feet = [self.body(name, "foot") for name in file.sided(file.foot)]
        self.data = mujoco.MjData(model)
        mujoco.mj_resetData(model, self.data)
        self.data.qpos[model.jnt_qposadr[model.jnt_type == _HINGE]] = 0.0
        mujoco.mj_kinematics(model, self.data)
        left, right = self.data.xpos[self.feet]
        distance = math.hypot(*(left - right)[:2])
        if not distance > 0.0:
            raise InputError("both feet are at one place; correct foot and sides in the body's description.")
        x, y = (left - right)[:2] / distance
        self.align = np.array([[y, -x, 0.0], [x, y, 0.0], [0.0, 0.0, 1.0]])  # left foot towards +y
        self.origin = self.data.xpos[root]
        self.segments: list[Segment] = []
        self.of_body: dict[int, int] = {}
        self._read(root, -1)
        for foot in self.feet:
            if foot not in self.of_body:
                raise InputError(
                    f"the foot {model.body(foot).name!r} does not hang on the root {file.root!r}; correct "
                    "root in the body's description.",
                    key="body.root",
                )
        left = self.feet[0]
        self.foot_offset = self._vector(self.data.xpos[left] - self.origin)
        self.foot_offset -= self.segments[self.of_body[left]].place
        self.hinges = [joint for segment in self.segments for joint in segment.joints]
        self.index = {joint.name: i for i, joint in enumerate(self.hinges)}
        self.segment_of = [i for i, segment in enumerate(self.segments) for _ in segment.joints]
        self.pairs = dict(file.pairs) | {right: left for left, right in file.pairs.items()}
        for role, names in (("neutral", file.neutral), ("rest", file.rest), ("pairs", self.pairs)):
            for name in names:
                self.joint(name, role)
        self.findings = self._symmetrise()

    def _check_source(self) -> None:
        """Refuse forces and couplings that a body cannot have, and patterns that match nothing."""
        model = self.model
        for what, fields in _DROPPED.items():
            if any(getattr(model, name).any() for name in fields):
                raise InputError(f"the model has {what}, which a body cannot have; remove them from it.")
        couplings = [k for k in np.flatnonzero(model.eq_active0).tolist() if self._couples(k)]
        if couplings:
            couplings = [k for k in couplings if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT]
            ends = {*model.eq_obj1id[couplings].tolist(), *model.eq_obj2id[couplings].tolist()} - {-1}
            coupled = sorted(model.joint(end).name for end in ends)
            raise InputError(
                f"the model has closed loops or coupled joints ({', '.join(coupled)}); lock these "
                "joints or remove them."
            )
        joints = [model.joint(j).name for j in np.flatnonzero(model.jnt_type != _FREE).tolist()]
        links = [model.body(i).name for i in range(1, model.nbody)]
        for key in (
            "gyration",
            "lock",
            "range",
            "armature",
            "effort",
            "speed",
            "damping",
            "stiffness",
            "friction",
        ):
            what, names = ("link", links) if key == "gyration" else ("joint", joints)
            for pattern in getattr(self.file, key):
                if not any(map(pattern.fullmatch, names)):
                    raise InputError(
                        f"{key} has {pattern.pattern!r}, which matches no {what}; take names of "
                        f"{', '.join(names)}.",
                        key=f"body.{key}",
                    )

    def _couples(self, number: int) -> bool:
        """Whether an equality couples joints that move."""
        model = self.model
        if model.eq_type[number] != mujoco.mjtEq.mjEQ_JOINT:
            return True
        ends = [int(end) for end in (model.eq_obj1id[number], model.eq_obj2id[number]) if end >= 0]
        return not all(self._is_locked(model.joint(end).name) for end in ends)

    def _is_locked(self, joint: str) -> bool:
        return any(pattern.fullmatch(joint) for pattern in self.file.lock)

    def body(self, name: str, role: str) -> int:
        """Number of a segment of the source.

        Raises:
            InputError: there is none of this name.
        """
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if number < 0:
            known = (self.model.body(i).name for i in range(1, self.model.nbody))
            raise unknown(name, known, f"segment for {role}", key=f"body.{role}")
        return int(number)

    def joint(self, name: str, role: str) -> int:
        """Number of a hinge.

        Raises:
            InputError: there is none of this name.
        """
        if name not in self.index:
            raise unknown(name, self.index, f"joint for {role}", key=f"body.{role}")
        return self.index[name]

    def _vector(self, vector: Array) -> Array:
        return np.asarray(self.align @ vector)

    def _read(self, body: int, parent: int) -> None:
        """Add a body and all that hangs on it."""
        joints = self._joints(body)
        if joints or parent < 0:
            place = self._vector(self.data.xpos[body] - self.origin)
            self.segments.append(Segment(self.model.body(body).name, parent, place, joints))
            parent = len(self.segments) - 1
        self.of_body[body] = parent
        self._add_mass(body, self.segments[parent])
        self._add_shapes(body, self.segments[parent])
        for child in np.flatnonzero(self.model.body_parentid == body).tolist():
            if child != body:
                self._read(child, parent)

    def _joints(self, body: int) -> list[Hinge]:
        model, file, hinges = self.model, self.file, []
        first = int(model.body_jntadr[body])
        for j in range(first, first + int(model.body_jntnum[body])):
            name, kind, dof = model.joint(j).name, int(model.jnt_type[j]), int(model.jnt_dofadr[j])
            if (kind == _FREE and not self.segments) or self._is_locked(name):
                continue
            if kind != _HINGE:
                raise InputError(f"the joint {name!r} is no hinge; lock it or take a model of hinges.")
            limits = tuple(model.jnt_range[j]) if model.jnt_limited[j] else (-math.inf, math.inf)
            low, high = by_pattern(file.range, name, limits)
            hinges.append(
                Hinge(
                    name=name,
                    anchor=self._vector(self.data.xanchor[j] - self.data.xpos[body]),
                    axis=self._vector(self.data.xaxis[j]),
                    low=float(low),
                    high=float(high),
                    effort=by_pattern(file.effort, name, self.efforts.get(j, math.inf)),
                    speed=by_pattern(file.speed, name, self.speeds.get(name, math.inf)),
                    armature=by_pattern(file.armature, name, float(model.dof_armature[dof])),
                    damping=by_pattern(file.damping, name, float(model.dof_damping[dof])),
                    stiffness=by_pattern(file.stiffness, name, float(model.jnt_stiffness[j])),
                    spring=float(model.qpos_spring[model.jnt_qposadr[j]]),
                    friction=by_pattern(file.friction, name, float(model.dof_frictionloss[dof])),
                )
            )
        return hinges

    def _add_mass(self, body: int, segment: Segment) -> None:
        mass = float(self.model.body_mass[body])
        if mass > MASSLESS:
            turn = self.align @ self.data.ximat[body].reshape(3, 3)
            com = self._vector(self.data.xipos[body] - self.origin) - segment.place
            inertia = turn @ np.diag(self.model.body_inertia[body]) @ turn.T
            if (radius := by_pattern(self.file.gyration, self.model.body(body).name, 0.0)) > 0.0:
                inertia = mass * radius**2 * np.eye(3)
            segment.inertial = segment.inertial.plus(Inertial(mass, com, inertia))

    def _add_shapes(self, body: int, segment: Segment) -> None:
        """What collides, or what is drawn if that is much larger; meshes as their convex hulls."""
        model = self.model
        kinds = {
            geom: mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            for geom in np.flatnonzero(model.geom_bodyid == body).tolist()
        }
        every = np.array([geom for geom, kind in kinds.items() if kind in _SIZES], dtype=int)
        collide = (model.geom_contype[every] != 0) | (model.geom_conaffinity[every] & ~DRAWN != 0)
        solid, drawn = every[collide], every[~collide]
        for geom in (drawn if self._extent(solid) < _SMALL * self._extent(drawn) else solid).tolist():
            place = self._vector(self.data.geom_xpos[geom] - self.origin) - segment.place
            quat = quaternion(self.align @ self.data.geom_xmat[geom].reshape(3, 3))
            shape: dict[str, Any] = {"type": kinds[geom], "pos": place, "quat": quat}
            if kinds[geom] == "mesh":
                shape["vertex"] = _hull(model, int(model.geom_dataid[geom]))
            else:
                shape["size"] = model.geom_size[geom][: _SIZES[kinds[geom]]]
            segment.shapes.append(shape)

    def _extent(self, geoms: NDArray[np.intp]) -> float:
        """Diagonal of the box of some shapes' centres and radii [m]."""
        if not geoms.size:
            return 0.0
        centre, radius = self.data.geom_xpos[geoms], self.model.geom_rbound[geoms, None]
        return float(np.linalg.norm((centre + radius).max(axis=0) - (centre - radius).min(axis=0)))

    # ------------------------------------------------------------------------------------------- symmetry

    def mirrored(self, name: str) -> str:
        """Name of the mirror image of a hinge; its own if it is in the middle."""
        if name in self.pairs:
            return self.pairs[name]
        pairs = {tuple(map(change, self.file.sides)) for change in (str, str.capitalize, str.upper)}
        for one, other in [pair[::step] for pair in sorted(pairs) for step in (1, -1)]:
            start = name.find(one)
            while start >= 0:
                image = name[:start] + other + name[start + len(one) :]
                if image in self.index:
                    return image
                start = name.find(one, start + 1)
        return name

    def _symmetrise(self) -> Findings:
        """Make left and right mirror images, and say how far they were from it.

        Raises:
            InputError: they are no images at all.
        """
        self.images = [self.index[self.mirrored(joint.name)] for joint in self.hinges]
        near = _ALIKE * float(np.ptp([segment.place[2] for segment in self.segments]))
        self._check_images(near)
        self.signs = np.empty(len(self.images))
        before = [replace(joint) for joint in self.hinges]
        far, angles = [0.0], [0.0]
        for i, (mean, joint) in enumerate(zip(self.hinges, before, strict=True)):
            image = before[self.images[i]]
            axis = -_MIRROR * image.axis
            sign = 1.0 if axis @ joint.axis > 0.0 else -1.0
            axis, anchor = sign * axis, _MIRROR * image.anchor
            far.append(_gap(anchor, joint.anchor))
            angles.append(math.acos(min(1.0, float(axis @ joint.axis))))
            mean.axis = (joint.axis + axis) / np.linalg.norm(joint.axis + axis)
            mean.anchor = 0.5 * (joint.anchor + anchor)
            for name in ("effort", "armature", "damping", "stiffness", "friction"):
                setattr(mean, name, 0.5 * (getattr(joint, name) + getattr(image, name)))
            mean.spring = 0.5 * (joint.spring + sign * image.spring)
            mean.speed = min(joint.speed, image.speed)
            place = self.segments[self.segment_of[i]].place + joint.anchor
            if self.images[i] != i and place[1] < 0.0:  # the ranges are those of the left side
                mean.low, mean.high = sorted((sign * image.low, sign * image.high))
            self.signs[i] = sign
        pairs = [0] * len(self.segments)
        for i, k in enumerate(self.images):
            pairs[self.segment_of[i]] = self.segment_of[k]
        old = [replace(segment) for segment in self.segments]
        total = sum(segment.inertial.mass for segment in old)
        if not total > 0.0:
            raise InputError("the links of the body have no mass; give them masses in its model.")
        coms, masses = [0.0], [0.0]
        for segment, here, pair in zip(self.segments, old, pairs, strict=True):
            other = old[pair]
            if here.parent >= 0 and pairs[here.parent] != other.parent:
                what = "has no mirror image" if here.name == other.name else f"is no image of {other.name!r}"
                raise InputError(
                    f"the segment {here.name!r} {what}; correct sides in the body's description, or lock the "
                    "joints of both sides."
                )
            one, two = here.inertial, other.inertial
            place, com = _MIRROR * other.place, _MIRROR * two.com
            inertia = np.outer(_MIRROR, _MIRROR) * two.inertia
            mass = 0.5 * (one.mass + two.mass)
            far.append(_gap(place, here.place))
            coms.append(mass / total * _gap(com, one.com))
            masses.append(abs(two.mass - one.mass))
            segment.place = 0.5 * (here.place + place)
            segment.inertial = Inertial(mass, 0.5 * (one.com + com), 0.5 * (one.inertia + inertia))
        for value, limit, unit, what in (
            (max(far), near, "m", "places of joints"),
            (max(coms), near, "m", "the COM of one of their segments, as it moves that of the body"),
            (max(masses), _ALIKE * total, "kg", "masses"),
            (max(angles), _UNLIKE, "rad", "axes of joints"),
        ):
            if not value <= limit:
                raise InputError(
                    f"left and right differ by {value:.3g} {unit} in {what}, and may by {limit:.3g} {unit}; "
                    "a periodic walk needs a symmetric body: correct the model, or sides in its description."
                )
        bare = sum(not segment.shapes for segment in self.segments)
        return Findings(max(far), max(coms), max(masses), bare)

    def _check_images(self, near: float) -> None:
        """Refuse hinges off the middle that are their own image, where others are theirs within near [m]."""
        places = [
            self.segments[segment].place + hinge.anchor
            for segment, hinge in zip(self.segment_of, self.hinges, strict=True)
        ]

        def mirrors(one: int, other: int) -> bool:
            along = abs(float(_MIRROR * self.hinges[other].axis @ self.hinges[one].axis))
            return _gap(places[one], _MIRROR * places[other]) <= near and along > math.cos(_UNLIKE)

        alone = [i for i, image in enumerate(self.images) if image == i and not mirrors(i, i)]
        pairs = [
            f'"{self.hinges[i].name}" = "{self.hinges[k].name}"'
            for i in alone
            for k in alone
            if places[i][1] > places[k][1] and mirrors(i, k)
        ]
        if pairs:
            raise InputError(
                f"sides do not tell the mirror images of {2 * len(pairs)} joints; correct sides in the "
                f"body's description, or add pairs = {{ {', '.join(pairs)} }}.",
                key="body.pairs",
            )


def _hull(model: mujoco.MjModel, mesh: int) -> Array:
    """Points of the convex hull of a mesh in its geom's axes, shape (n, 3) [m]."""
    start = int(model.mesh_graphadr[mesh])
    count = int(model.mesh_graph[start])
    points = model.mesh_graph[start + 2 + count : start + 2 + 2 * count] + model.mesh_vertadr[mesh]
    return np.asarray(np.round(model.mesh_vert[points], _DIGITS), dtype=np.float64)


def _gap(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b))


def _motor_limits(model: mujoco.MjModel) -> dict[int, float]:
    """Largest torque of the driven joints by number [N m]; infinite if it is not limited."""
    limits: dict[int, float] = {}
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT):
            gear, most = abs(float(model.actuator_gear[i, 0])), math.inf
            if model.actuator_forcelimited[i]:
                most = float(np.abs(model.actuator_forcerange[i]).min())
            if model.actuator_ctrllimited[i] and not model.actuator_biasprm[i].any():  # a motor
                most = min(
                    most, float(model.actuator_gainprm[i, 0] * np.abs(model.actuator_ctrlrange[i]).min())
                )
            limits[int(model.actuator_trnid[i, 0])] = gear * most
    for j in np.flatnonzero(model.jnt_actfrclimited).tolist():
        limits[j] = min(limits.get(j, math.inf), float(np.abs(model.jnt_actfrcrange[j]).min()))
    return limits

"""The segments of a compiled source at joint angles of 0, in axes of the world."""

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY
from ampm.section import unknown
from models.scene import Inertial, quaternion
from models.segments import Hinge, Segment, symmetrise
from models.source import DRAWN, MASSLESS, BodyFile, by_pattern

_FREE, _HINGE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "mesh": 0}
"""Drawn shapes and how many sizes they have."""
_FORCES_OF_NO_JOINT = (
    "tendon_stiffness",
    "tendon_stiffnesspoly",
    "tendon_damping",
    "tendon_dampingpoly",
    "tendon_frictionloss",
    "tendon_limited",
    "jnt_stiffnesspoly",
    "dof_dampingpoly",
    "actuator_damping",
    "actuator_dampingpoly",
    "body_gravcomp",
    "actuator_dyntype",
    "opt.density",
    "opt.viscosity",
)
"""Fields of a source with forces, limits or delays that a body cannot have."""
_SAME_GRAVITY = 0.05  # most difference of a model's gravity from that of a walk [m/s^2]
_BY_JOINT = ("lock", "range", "armature", "effort", "speed", "damping", "stiffness", "friction")
"""Keys of a description with patterns of joints."""
_SMALL = 0.5  # extent of what collides over that of what is drawn: less are points that touch the floor [1]
_DIGITS = 5  # of the points of a hull [m]


def at_zero(model: mujoco.MjModel) -> mujoco.MjData:
    """Places of a model with all hinges at 0."""
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[model.jnt_type == _HINGE]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def upright_axes(data: mujoco.MjData, feet: Sequence[int]) -> Array:
    """Forward, left and up as rows, shape (3, 3): the feet are under the hips along an axis of the model.

    The data have the places of all segments; ``feet`` are those of the left and the right foot. Without a
    distance between them, forward and left are 0.
    """
    left, right = data.xpos[feet]
    lines = [_line(data.model, foot) for foot in feet]
    shared = sum(one == other for one, other in zip(*lines, strict=False))
    hips = [line[min(shared, len(line) - 1)] for line in lines]
    down = left + right - data.xpos[hips].sum(axis=0)
    axis = int(np.abs(down).argmax())
    up = -math.copysign(1.0, down[axis]) * np.eye(3)[axis]
    across = left - right - ((left - right) @ up) * up
    across /= math.hypot(*across) or 1.0
    return np.stack([np.cross(across, up), across, up])


def _line(model: mujoco.MjModel, body: int) -> list[int]:
    """Segments from the world to a body."""
    return [*_line(model, int(model.body_parentid[body])), body] if body else [0]


class Tree:
    """The segments of a compiled source."""

    def __init__(self, file: BodyFile, model: mujoco.MjModel, speeds: Mapping[str, float]) -> None:
        self.file, self.model, self.speeds = file, model, speeds
        self._check_source()
        self.efforts = motor_limits(model)  # by number of the joint [N m]
        root = self.body(file.root, "root")
        self.feet = [self.body(name, "foot") for name in file.foot]  # bodies of the source
        self.data = at_zero(model)
        self.origin = self.data.xpos[root]  # in the source, as the following
        self.align = upright_axes(self.data, self.feet)  # forward, left and up, the rows
        if not self.align[1].any():
            raise InputError("both feet are at one place; correct foot in the body's description.")
        self.segments: list[Segment] = []  # from the root outwards
        self.of_body: dict[int, Segment] = {}  # that a body of the source is a part of
        self._add_body(root, None)
        for role, name in (("trunk", file.trunk), *(("foot", foot) for foot in file.foot)):
            if self.body(name, role) not in self.of_body:
                raise InputError(
                    f"the {role} {name!r} does not hang on the root {file.root!r}; correct root or {role}.",
                    key="body.root",
                )
        top, masses = int(model.body_rootid[root]), model.body_subtreemass
        if (lost := float(masses[top] - masses[root])) > 1e-6 * masses[top]:
            raise InputError(
                f"the root {file.root!r} hangs on {lost:.3g} kg that would be left out; name "
                f"{model.body(top).name!r} as root, or take them out of the model.",
                key="body.root",
            )
        left = self.feet[0]  # its origin from that of its segment
        self.foot_offset = self._vector(self.data.xpos[left] - self.origin) - self.of_body[left].place
        self.hinges = {joint.name: joint for segment in self.segments for joint in segment.joints}
        for role, names in (("knee", file.knee), ("rest", file.rest)):
            for name in names:
                self.joint(name, role)
        self.findings = symmetrise(self.segments, [pattern.pattern for pattern in file.lock])
        self._check_sides()

    def _check_source(self) -> None:
        """Refuse forces, limits and couplings that a body cannot have, and patterns that match nothing."""
        model = self.model
        if forces := [name for name in _FORCES_OF_NO_JOINT if np.any(attrgetter(name)(model))]:
            raise InputError(f"the model has {', '.join(forces)}, which a body cannot have; remove them.")
        gravity = model.opt.gravity
        if gravity.any() and np.abs(gravity - (0.0, 0.0, -GRAVITY)).max() > _SAME_GRAVITY:
            given = ", ".join(f"{value:g}" for value in gravity)
            raise InputError(
                f"the model has a gravity of ({given}) m/s^2, and every body walks under "
                f"(0, 0, {-GRAVITY:g}); correct or remove it."
            )
        if coupled := sorted(name for name in coupled_joints(model) if not self._is_locked(name)):
            raise InputError(
                f"the model has closed loops or coupled joints ({', '.join(coupled)}); remove the coupling "
                "from it, or lock these joints where they are of no leg."
            )
        joints = [model.joint(j).name for j in np.flatnonzero(model.jnt_type != _FREE).tolist()]
        links = [model.body(i).name for i in range(1, model.nbody)]
        for key in ("gyration", *_BY_JOINT):
            what, names = ("link", links) if key == "gyration" else ("joint", joints)
            for pattern in getattr(self.file, key):
                if not any(map(pattern.fullmatch, names)):
                    raise InputError(
                        f"{key} has {pattern.pattern!r}, which matches no {what}; known: {', '.join(names)}.",
                        key=f"body.{key}",
                    )

    def _check_sides(self) -> None:
        """Refuse patterns for right joints alone, as these get the values of the left ones."""
        for key in _BY_JOINT:
            for pattern in getattr(self.file, key):
                matched = [hinge for name, hinge in self.hinges.items() if pattern.fullmatch(name)]
                if matched and all(hinge.side < 0 for hinge in matched):
                    raise InputError(
                        f"{key} has {pattern.pattern!r}, which matches right joints alone, and these get "
                        f"the values of the left; name the left, such as {matched[0].image.name!r}.",
                        key=f"body.{key}",
                    )

    def _is_locked(self, joint: str) -> bool:
        return any(pattern.fullmatch(joint) for pattern in self.file.lock)

    def body(self, name: str, role: str) -> int:
        """Number of a segment of the source; raises InputError if there is none of this name."""
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if number < 0:
            known = (self.model.body(i).name for i in range(1, self.model.nbody))
            raise unknown(name, known, f"segment for {role}", key=f"body.{role}")
        return int(number)

    def joint(self, name: str, role: str) -> Hinge:
        """A hinge by its name; raises InputError if there is none of this name, or it is locked."""
        if self._is_locked(name):
            raise InputError(f"{role} names the joint {name!r}, which lock welds; leave it out of one.")
        if name not in self.hinges:
            raise unknown(name, self.hinges, f"joint for {role}", key=f"body.{role}")
        return self.hinges[name]

    def _vector(self, vector: Array) -> Array:
        return np.asarray(self.align @ vector)

    def _add_body(self, body: int, parent: Segment | None) -> None:
        """Add a body and all that hangs on it."""
        joints, segment = self._hinges_of(body), parent
        if joints or segment is None:
            place = self._vector(self.data.xpos[body] - self.origin)
            segment = Segment(self.model.body(body).name, parent, place, joints)
            self.segments.append(segment)
        self.of_body[body] = segment
        self._add_mass(body, segment)
        self._add_shapes(body, segment)
        for child in np.flatnonzero(self.model.body_parentid == body).tolist():
            if child != body:
                self._add_body(child, segment)

    def _hinges_of(self, body: int) -> list[Hinge]:
        """Hinges of a body of the source that are not locked, with the values of the description."""
        model, file, hinges = self.model, self.file, []
        first = int(model.body_jntadr[body])
        for j in range(first, first + int(model.body_jntnum[body])):
            name, kind, dof = model.joint(j).name, int(model.jnt_type[j]), int(model.jnt_dofadr[j])
            if not self.segments or self._is_locked(name):  # the root moves freely
                continue
            if kind != _HINGE:
                raise InputError(
                    f"the joint {name!r} is not a hinge; lock it if it is outside the legs, or take another "
                    "model."
                )
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


def _hull(model: mujoco.MjModel, mesh: int) -> Array:
    """Points of the convex hull of a mesh in its geom's axes, shape (n, 3) [m]."""
    start = int(model.mesh_graphadr[mesh])
    count = int(model.mesh_graph[start])
    points = model.mesh_graph[start + 2 + count : start + 2 + 2 * count] + model.mesh_vertadr[mesh]
    return np.asarray(np.round(model.mesh_vert[points], _DIGITS), dtype=np.float64)


def joints_above(model: mujoco.MjModel) -> list[set[int]]:
    """Joints from the root of its tree to each body, without those of the root."""
    lines = [_line(model, body)[2:] for body in range(model.nbody)]
    return [set(np.flatnonzero(np.isin(model.jnt_bodyid, line)).tolist()) for line in lines]


def coupled_joints(model: mujoco.MjModel) -> set[str]:
    """Names of joints that equalities couple, of two segments all between them; else of the equality."""
    names, above = set[str](), joints_above(model)
    for k in np.flatnonzero(model.eq_active0).tolist():
        ends = [end for end in (model.eq_obj1id[k], model.eq_obj2id[k]) if end >= 0]
        kind = mujoco.mjtObj(model.eq_objtype[k])
        if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
            names |= {model.joint(end).name for end in ends}
        elif kind in (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_SITE):
            bodies = ends if kind == mujoco.mjtObj.mjOBJ_BODY else model.site_bodyid[ends]
            names |= {model.joint(joint).name for joint in above[bodies[0]] ^ above[bodies[1]]}
        else:
            names.add(f"equality {model.equality(k).name}".rstrip())
    return names


def motor_limits(model: mujoco.MjModel) -> dict[int, float]:
    """Largest torque of the driven joints by number [N m]; infinite if it is not limited."""
    limits: dict[int, float] = {}
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT):
            gear, most = abs(float(model.actuator_gear[i, 0])), math.inf
            if model.actuator_forcelimited[i]:
                most = float(np.abs(model.actuator_forcerange[i]).min())
            if model.actuator_ctrllimited[i] and not model.actuator_biasprm[i].any():  # a motor
                largest = model.actuator_gainprm[i, 0] * np.abs(model.actuator_ctrlrange[i]).min()
                most = min(most, float(largest))
            joint = int(model.actuator_trnid[i, 0])
            limits[joint] = limits.get(joint, 0.0) + gear * most
    for j in np.flatnonzero(model.jnt_actfrclimited).tolist():
        limits[j] = min(limits.get(j, math.inf), float(np.abs(model.jnt_actfrcrange[j]).min()))
    return limits

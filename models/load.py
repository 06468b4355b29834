"""A body from a description file: its source, written again as the other modules expect it.

Every segment of the result is a moving one, with what is fixed to it; with all joints at 0 its axes are those
of the world, x where the feet point.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from ampm.description import SOLE_POINT_GROUPS, BodyDescription, LegDescription, Passive, SoleGeometry
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import ContactParameters, SimulationParameters
from models import anthropometry as table
from models.scene import (
    BodyModel,
    add,
    add_motors,
    add_root,
    add_segment,
    add_sensors,
    add_sole_points,
    joint_order,
    new_scene,
    to_xml,
)
from models.source import BodyFile, compiled_source, source_path
from models.tree import Findings, Segment, Tree

_COLOUR = (0.45, 0.52, 0.60, 1.0)
_THIN = 0.005  # least half axis of a segment's shape [m]
_TRUNK_FRAME = "trunk_axes"
_SIDES = ("left", "right")
_OURS = frozenset(
    {"root", "imu", "universe", _TRUNK_FRAME, *(f"{side}_sole" for side in _SIDES)}
    | {f"{side}_{group}_{edge}" for side in _SIDES for group in SOLE_POINT_GROUPS for edge in _SIDES}
)
"""Names of joints and frames that are added."""


def load_body(
    file: BodyFile, folder: Path, contact: ContactParameters, simulation: SimulationParameters
) -> tuple[BodyModel, Findings]:
    """Build the body of a description file.

    Args:
        file: contents of the description file.
        folder: where the file lies.
        contact: stiffness and friction of the soles on the floor.
        simulation: ``time_step`` [s] and ``integrator``.

    Raises:
        InputError: the source is missing or cannot be simulated, or the description does not fit it.
    """
    model, speeds = compiled_source(source_path(file.source, folder))
    tree = Tree(file, model, speeds)
    asymmetry = tree.symmetrise()
    bare = tuple(segment.name for segment in tree.segments if not segment.shapes)
    return _Writer(tree).write(contact, simulation), replace(asymmetry, bare=bare)


class _Writer:
    """Writes the MJCF of a tree, and derives its description."""

    def __init__(self, tree: Tree) -> None:
        self.tree, self.file = tree, tree.file
        names = {joint.name for joint in tree.hinges}  # Pinocchio has one set of names for all
        if taken := sorted(names & _OURS):
            raise InputError(f"the model has joints with names of ours: {', '.join(taken)}; rename them.")
        names |= _OURS
        self.names = [f"{s.name}_segment" if s.name in names else s.name for s in tree.segments]
        self.neutral = np.array([self.file.neutral.get(joint.name, 0.0) for joint in tree.hinges])
        # A neutral angle that is given for one side holds for the other.
        for i, k in enumerate(tree.images):
            if tree.hinges[i].name not in self.file.neutral and tree.hinges[k].name in self.file.neutral:
                self.neutral[i] = tree.signs[i] * self.neutral[k]
        self._place()
        self._find_legs()

    def _place(self) -> None:
        """Places and turns of segments, anchors and axes of hinges in the neutral posture."""
        tree = self.tree
        count = len(tree.segments)
        self.turn, self.place = np.empty((count, 3, 3)), np.zeros((count, 3))
        self.anchor, self.axis = np.empty((2, len(tree.hinges), 3))
        k = 0
        for i, segment in enumerate(tree.segments):
            turn, place = np.eye(3), np.zeros(3)
            if i:
                turn = self.turn[segment.parent]
                place = self.place[segment.parent] + turn @ (
                    segment.place - tree.segments[segment.parent].place
                )
            for joint in segment.joints:
                self.anchor[k], self.axis[k] = place + turn @ joint.anchor, turn @ joint.axis
                bend = np.zeros(4)
                mujoco.mju_axisAngle2Quat(bend, joint.axis, self.neutral[k])
                matrix = np.zeros(9)
                mujoco.mju_quat2Mat(matrix, bend)
                turn = turn @ matrix.reshape(3, 3)
                place = self.anchor[k] - turn @ joint.anchor
                k += 1
            self.turn[i], self.place[i] = turn, place

    # ----------------------------------------------------------------------------------------------- roles

    def _path(self, segment: int) -> list[int]:
        """Hinges from the root to a segment."""
        tree, found = self.tree, []
        while segment >= 0:
            found += [k for k, owner in enumerate(tree.segment_of) if owner == segment][::-1]
            segment = tree.segments[segment].parent
        return found[::-1]

    def _find_legs(self) -> None:
        tree, file = self.tree, self.file
        self.feet = [tree.of_body[body] for body in tree.feet]
        paths = [self._path(foot) for foot in self.feet]
        shared = [k for k in paths[0] if k in paths[1]]
        self.legs = [[k for k in path if k not in shared] for path in paths]
        self.knees = [tree.joint(name, "knee") for name in file.sided(file.knee)]
        self.trunk = tree.of_body[tree.body(file.trunk, "trunk")]
        to_trunk = [k for k in self._path(self.trunk) if k not in shared]
        self.trunk_joints = shared + to_trunk
        for side, leg, knee in zip(file.sides, self.legs, self.knees, strict=True):
            if knee not in leg[1:-1]:
                raise InputError(
                    f"the knee {tree.hinges[knee].name!r} is not amid the joints from root to the {side} "
                    "foot; correct knee, foot or sides in the body's description.",
                    key="body.knee",
                )
        if set(self.trunk_joints) & set(self.legs[0] + self.legs[1]):
            raise InputError(
                "the trunk hangs on a leg; correct trunk in the body's description.", key="body.trunk"
            )
        of_none = set(range(len(tree.hinges))) - set(self.trunk_joints) - set(self.legs[0] + self.legs[1])
        self.arms: tuple[list[int], list[int], list[int]] = ([], [], [])
        for k in sorted(of_none):
            if tree.images[k] == k:
                self.arms[2].append(k)
            else:
                self.arms[0 if self.anchor[k, 1] > self.anchor[tree.images[k], 1] else 1].append(k)

    def _is_below(self, segment: int, hinge: int) -> bool:
        """Whether a hinge turns what hangs on a segment."""
        below = self.tree.segments[self.tree.segment_of[hinge]].parent
        while below >= 0 and below != segment:
            below = self.tree.segments[below].parent
        return below == segment

    def _along(self, joints: Sequence[int], axis: int) -> Array:
        """Anchor of the hinge that turns most about an axis of the world, shape (3,) [m]."""
        return np.asarray(self.anchor[max(joints, key=lambda k: abs(self.axis[k, axis]))])

    def _straight(self, knee: int, hip: Array, ankle: Array) -> tuple[float, float]:
        """Angle of the straight knee [rad], and the length of the leg [m]."""
        axis, centre = self.axis[knee], self.anchor[knee]
        upper, lower = hip - centre, ankle - centre
        along = float((upper - lower) @ axis)
        upper, lower = upper - (upper @ axis) * axis, lower - (lower @ axis) * axis
        angle = math.atan2(float(np.cross(lower, -upper) @ axis), float(lower @ -upper))
        length = math.hypot(float(np.linalg.norm(upper) + np.linalg.norm(lower)), along)
        return float(self.neutral[knee]) + angle, length

    def _leg(self, foot: int, points: tuple[str, ...]) -> LegDescription:
        tree, leg, knee = self.tree, self.legs[foot], self.knees[foot]
        before, after = leg[: leg.index(knee)], leg[leg.index(knee) + 1 :]
        straight, _ = self._straight(knee, self._along(before, 1), self._along(after, 1))
        joint, names = tree.hinges[knee], [hinge.name for hinge in tree.hinges]
        sign = 1.0 if joint.high - straight > straight - joint.low else -1.0
        if not sign * self.axis[knee, 1] > 0.0:
            raise InputError(
                f"the knee {joint.name!r} bends forward; exchange sides in the body's description, or "
                "correct the range of the joint.",
                key="body.sides",
            )
        return LegDescription(
            hip=tuple(names[k] for k in before),
            knee=joint.name,
            ankle=tuple(names[k] for k in after),
            toe=None,
            foot_segment=self.names[self.feet[foot]],
            toe_segment=None,
            sole_frame=f"{('left', 'right')[foot]}_sole",
            sole_points=points,
            straight_knee=straight,
            knee_sign=sign,
        )

    # ---------------------------------------------------------------------------------------------- result

    def write(self, contact: ContactParameters, simulation: SimulationParameters) -> BodyModel:
        """MJCF and description."""
        tree, outline, foot = self.tree, self.file.sole, self.feet[0]
        self._check()
        if not outline.heel < outline.front:
            raise InputError(
                f"sole.heel = {outline.heel:g} must be less than sole.front = {outline.front:g}: x is "
                "forward; correct the outline.",
                key="body.sole",
            )
        parts = zip(tree.segments, self.place, self.turn, strict=True)
        mass = sum(segment.mass for segment in tree.segments)
        com_z = sum(part.mass * float((place + turn @ part.com)[2]) for part, place, turn in parts) / mass
        floor = float(self.place[foot, 2]) + outline.bottom
        before, after = self._hip(0), self._ankle(0)
        hip, ankle = self._along(before, 1), self._along(after, 1)
        sole = SoleGeometry(
            heel_x=outline.heel - outline.reference,
            ball_x=outline.front - outline.reference,
            tip_x=outline.front - outline.reference,
            heel_half_width=outline.heel_half_width,
            ball_half_width=outline.front_half_width,
            tip_half_width=outline.front_half_width,
            ankle_x=float(ankle[0] - self.place[foot, 0]) - outline.reference,
            ankle_height=float(ankle[2]) - floor,
        )
        com_height, hip_height = com_z - floor, float(hip[2]) - floor
        if not sole.ankle_height > 0.0:
            raise InputError(
                f"sole.bottom = {outline.bottom:g} is {-sole.ankle_height:g} m over the ankle; measure it "
                "from the foot's origin, z upwards.",
                key="body.sole",
            )
        longest = max(sole.length, 2.0 * sole.half_width, sole.ankle_height)
        if longest > float(hip[2] - ankle[2]):
            raise InputError(
                f"a side of the sole, {longest:g} m, is longer than the leg, {hip[2] - ankle[2]:.4g} m; give "
                "the outline in metres, and the model, too.",
                key="body.sole",
            )
        height = com_height / (table.HIP_HEIGHT + table.COM_OVER_HIP)
        root = new_scene("body", height, contact, simulation)
        # Else MuJoCo's dampers would act as further inertia over a time step, which no controller knows.
        next(root.iter("flag")).set("eulerdamp", "disable")
        bodies: list[Element] = []
        for i, segment in enumerate(tree.segments):
            parent = bodies[segment.parent] if i else next(root.iter("worldbody"))
            bodies.append(self._segment(next(root.iter("asset")), parent, i, -floor))
        turn = _quaternion(self.turn[self.trunk].T)
        add(bodies[self.trunk], "site", name=_TRUNK_FRAME, quat=turn)
        add(bodies[self.trunk], "site", name="imu", pos=tree.segments[self.trunk].com, quat=turn)
        legs: list[LegDescription] = []
        for side, number, sign in zip(_SIDES, self.feet, (1.0, -1.0), strict=True):
            to_foot = self.turn[number].T
            origin = to_foot @ np.array([outline.reference, sign * outline.middle, outline.bottom])
            quat = _quaternion(to_foot)
            add(bodies[number], "site", name=f"{side}_sole", pos=origin, quat=quat)
            points = add_sole_points(side, sole, [(bodies[number], origin)] * 2, quat)
            legs.append(self._leg(len(legs), points))
        order = joint_order(root)
        hinges = {hinge.name: hinge for hinge in tree.hinges}
        limits = tuple((name, hinges[name].effort) for name in order)
        add_motors(root, limits)
        add_sensors(root, self.names[0])
        left, right, middle = (tuple(tree.hinges[k].name for k in group) for group in self.arms)
        description = BodyDescription(
            height=height,
            mass=mass,
            root_segment=self.names[0],
            trunk_segment=self.names[self.trunk],
            trunk_frame=_TRUNK_FRAME,
            left_leg=legs[0],
            right_leg=legs[1],
            waist=tuple(tree.hinges[k].name for k in self.trunk_joints),
            chest=(),
            left_arm=left,
            right_arm=right,
            head=middle,
            sole=sole,
            hip_height=hip_height,
            hip_half_width=abs(float(self._along(before, 0)[1])),
            leg_length=self._straight(self.knees[0], hip, ankle)[1],
            com_over_hip=com_height - hip_height,
            mirror=tuple(
                (hinge.name, tree.hinges[image].name, float(sign))
                for hinge, image, sign in zip(tree.hinges, tree.images, tree.signs, strict=True)
            ),
            torque_limits=limits,
            rest=self._rest(),
            speed_limits=tuple(
                (name, hinges[name].speed) for name in order if math.isfinite(hinges[name].speed)
            ),
            passive=tuple(
                Passive(name, hinge.damping, hinge.stiffness, hinge.spring, hinge.friction)
                for name, hinge in ((name, hinges[name]) for name in order)
                if hinge.damping or hinge.stiffness or hinge.friction
            ),
        )
        return BodyModel(to_xml(root), description)

    def _check(self) -> None:
        """Refuse a body that cannot be simulated or steered."""
        tree = self.tree
        light = [segment.name for segment in tree.segments if not segment.mass > 0.0]
        weak = [hinge.name for hinge in tree.hinges if not 0.0 < hinge.effort < math.inf]
        loose = [
            hinge.name
            for leg in self.legs
            for k in leg
            if not math.isfinite((hinge := tree.hinges[k]).high - hinge.low)
        ]
        short = [side for side, leg in zip(_SIDES, self.legs, strict=True) if len(leg) < 6]
        below = [
            hinge.name for k, hinge in enumerate(tree.hinges) for foot in self.feet if self._is_below(foot, k)
        ]
        inner = [tree.hinges[k].name for leg in self.legs for k in leg]
        resting = [name for name in self.file.rest if name in inner]
        outside = [
            f"{hinge.name} = {angle:g}"
            for name, angle in self._rest()
            for hinge in tree.hinges
            if hinge.name == name and not hinge.low <= angle <= hinge.high
        ]
        for names, what, way_out in (
            (below, "joints below a foot", "weld them with lock"),
            (resting, "joints of a leg in rest", "leave them out, as legs follow the gait"),
            (outside, "angles at rest or in neutral outside of their range", "correct them"),
            (light, "moving segments without mass", "weld their joints with lock"),
            (weak, "joints without a torque limit", "give it with [body.effort]"),
            (loose, "joints of a leg without a range", "give it in the model"),
            (short, "legs of less than six joints, which cannot hold a sole flat", "take another model"),
        ):
            if names:
                raise InputError(f"the body has {what}: {', '.join(names)}; {way_out}.")

    def _segment(self, asset: Element, parent: Element, i: int, height: float) -> Element:
        """Write one segment, and its meshes as assets; the root at a height [m]."""
        segment, base = self.tree.segments[i], self.tree.segments[max(self.tree.segments[i].parent, 0)]
        place = segment.place - base.place if i else np.array([0.0, 0.0, height])
        body = add_segment(parent, self.names[i], place, segment.mass, segment.com, segment.inertia)
        if not i:
            add_root(body)
        for hinge in segment.joints:
            values: dict[str, Any] = {"range": (hinge.low, hinge.high)}
            if not math.isfinite(hinge.high - hinge.low):
                values = {}
            if hinge.stiffness:
                values |= {"stiffness": hinge.stiffness, "springref": hinge.spring}
            add(
                body, "joint", name=hinge.name, type="hinge", pos=hinge.anchor, axis=hinge.axis,
                armature=hinge.armature, damping=hinge.damping, frictionloss=hinge.friction, **values,
            )  # fmt: skip
        for number, shape in enumerate(segment.shapes or [_inertial_shape(segment)]):
            values = dict(shape)
            if "vertex" in shape:
                values["mesh"] = f"{self.names[i]}_{number}"
                add(asset, "mesh", name=values["mesh"], vertex=values.pop("vertex").ravel())
            add(body, "geom", rgba=_COLOUR, **values)
        return body

    def _rest(self) -> tuple[tuple[str, float], ...]:
        """Angles at rest of hinges that do not rest at 0; one that is given for one side holds for both."""
        tree, found = self.tree, {}
        for k, hinge in enumerate(tree.hinges):
            image, sign = tree.hinges[tree.images[k]].name, float(tree.signs[k])
            if hinge.name in self.file.rest:
                found[hinge.name] = self.file.rest[hinge.name]
            elif image in self.file.rest:
                found[hinge.name] = sign * self.file.rest[image]
            elif self.neutral[k]:
                found[hinge.name] = float(self.neutral[k])
        return tuple(found.items())

    def _hip(self, foot: int) -> list[int]:
        return self.legs[foot][: self.legs[foot].index(self.knees[foot])]

    def _ankle(self, foot: int) -> list[int]:
        return self.legs[foot][self.legs[foot].index(self.knees[foot]) + 1 :]


def _inertial_shape(segment: Segment) -> dict[str, Any]:
    """The ellipsoid of equal density with the mass and the inertia of a segment that has no shape."""
    moments, axes = np.linalg.eigh(segment.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    squares = 2.5 * (moments.sum() - 2.0 * moments) / segment.mass
    size = np.sqrt(np.maximum(squares, _THIN**2))
    return {"type": "ellipsoid", "pos": segment.com, "quat": _quaternion(axes), "size": size}


def _quaternion(matrix: Array) -> Array:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(matrix).ravel())
    return quaternion

"""The body of a run: the human, or one from a description file, written as the other modules expect it.

Every segment of the result is a moving one, with what is fixed to it; with all joints at 0 its axes are those
of the world, x where the feet point.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ampm.description import BodyDescription, LegDescription, Passive, SoleGeometry, UprightLegs
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import HUMAN, RunParameters
from models import scene
from models.human import COM_OVER_HIP, HIP_HEIGHT, build_human
from models.scene import BodyModel, add
from models.segments import Hinge, Segment
from models.source import MASSLESS, body_path, compiled_source, read_body_file, source_path
from models.tree import Tree

_COLOUR = (0.45, 0.52, 0.60, 1.0)
LEG_JOINTS = 6
"""Hinges of a leg that holds its sole flat, whatever it does."""
_SIDEWAYS = 0.7  # least part along y of the axis of a knee, or of the ankle's pitch [1]
_LEAST_PART = 0.2  # of thigh or shank, of both together [1]
_LEAST_BEND = 0.1  # range of a knee [rad]
_EVEN = 0.2  # most difference of both ways from a straight knee, over its range: less shows none [1]
_LARGEST_RANGE = 4.0 * math.pi  # of a joint of a leg [rad]: more is in degrees
_TALLEST = 3.0  # stature, as of body.height [m]
_DRY = (0.001, 1.0)  # solreffriction: MuJoCo's default makes dry friction viscous at slow rates [s, 1]
_THIN = 0.005  # least half axis of a segment's shape [m]


class _Leg(NamedTuple):
    """Side, hinges from trunk to knee and from knee to foot, and the foot."""

    side: str
    hip: list[Hinge]
    knee: Hinge
    ankle: list[Hinge]
    foot: Segment

    @property
    def joints(self) -> list[Hinge]:
        """Root to foot."""
        return [*self.hip, self.knee, *self.ankle]

    @property
    def ends(self) -> tuple[Array, Array]:
        """Centres of hip and ankle, those of their pitch, each of shape (3,) [m]."""
        return _place(self.hip, 1), _place(self.ankle, 1)

    def straight(self) -> tuple[float, float]:
        """Angle of the straight knee [rad], and the length of the leg [m]."""
        axis, centre = self.knee.axis, self.knee.place
        upper, lower = (end - centre for end in self.ends)
        along = float((upper - lower) @ axis)
        upper, lower = upper - (upper @ axis) * axis, lower - (lower @ axis) * axis
        angle = math.atan2(float(np.cross(lower, -upper) @ axis), float(lower @ -upper))
        return angle, math.hypot(float(np.linalg.norm(upper) + np.linalg.norm(lower)), along)


class Writer:
    """Writes the MJCF of a tree, and derives its description."""

    def __init__(self, tree: Tree) -> None:
        self.tree, self.file = tree, tree.file
        if taken := sorted(scene.ADDED_NAMES.intersection(tree.hinges)):
            raise InputError(f"joints have names that ampm needs: {', '.join(taken)}; rename them.")
        others = scene.ADDED_NAMES.union(tree.hinges)  # Pinocchio has one set of names for all
        self.names = {s: f"{s.name}_segment" if s.name in others else s.name for s in tree.segments}
        self._find_legs()

    def _find_legs(self) -> None:
        """Find legs and trunk from the feet, knees and trunk that the description names."""
        tree, file = self.tree, self.file
        feet = [tree.of_body[body] for body in tree.feet]
        left, right = (foot.chain for foot in feet)
        shared = [joint for joint in left if joint in right]
        self.legs: list[_Leg] = []
        for foot, name, side in zip(feet, file.knee, scene.SIDES, strict=True):
            knee = tree.joint(name, "knee")
            joints = [joint for joint in foot.chain if joint not in shared]
            pitches = joints[-2:-1] == [knee] and abs(joints[-1].axis[1]) > _SIDEWAYS
            if len(joints) != LEG_JOINTS and not (len(joints) == LEG_JOINTS - 1 and pitches):
                why = (
                    "which cannot hold a sole flat: that takes 6, or 3 at the hip, the knee and the ankle's "
                    "pitch; take another model, or correct foot or lock"
                    if len(joints) < LEG_JOINTS
                    else "of which hip and sole determine 6; lock the others, and if they are toes, give the "
                    "segment that they hang on as foot, and its sole"
                )
                raise InputError(
                    f"the {side} leg has {len(joints)} hinges ({', '.join(_names(joints))}), {why} "
                    "in the body's description.",
                    key="body.foot",
                )
            if knee not in joints[1:-1]:
                raise InputError(
                    f"the knee {name!r} is not amid the joints from root to the {side} foot "
                    f"({', '.join(_names(joints))}); correct knee or foot in the body's description.",
                    key="body.knee",
                )
            at = joints.index(knee)
            self.legs.append(_Leg(side, joints[:at], knee, joints[at + 1 :], foot))
            self._check_knee(self.legs[-1])
        self.trunk = tree.of_body[tree.body(file.trunk, "trunk")]
        self.trunk_joints = shared + [joint for joint in self.trunk.chain if joint not in shared]
        if set(self.trunk_joints) & set(self.legs[0].joints + self.legs[1].joints):
            raise InputError("the trunk hangs on a leg; correct body.trunk.", key="body.trunk")

    def _check_knee(self, leg: _Leg) -> None:
        """Refuse a knee that does not bend its leg."""
        joint = leg.knee
        to_hip, to_ankle = (np.linalg.norm(end - joint.place) for end in leg.ends)
        beside = abs(joint.axis[1]) < _SIDEWAYS or min(to_hip, to_ankle) < _LEAST_PART * (to_hip + to_ankle)
        if beside or 0.0 < joint.high - joint.low < _LEAST_BEND:
            axis = ", ".join(f"{part:.2g}" for part in joint.axis)
            raise InputError(
                f"the knee {joint.name!r} does not bend the leg: its axis is ({axis}), {to_hip:.3g} m from "
                f"the hip and {to_ankle:.3g} m from the ankle, its range {joint.low:.3g} to {joint.high:.3g} "
                "rad; correct knee or [body.range] in the body's description.",
                key="body.knee",
            )

    def _add_leg(self, leg: _Leg, sole: SoleGeometry, foot: Element) -> LegDescription:
        """Write the sole of a leg into its foot, and describe the leg."""
        outline, side, sign = self.file.sole, leg.side, 1.0 if leg.side == "left" else -1.0
        turn = sole_turn(outline.pitch)
        origin = turn @ np.array([outline.reference, sign * outline.middle, outline.bottom])
        origin += self.tree.foot_offset * (1.0, sign, 1.0)
        add(foot, "site", name=f"{side}_sole", pos=origin, quat=scene.quaternion(turn))
        joint, straight = leg.knee, leg.straight()[0]
        bends = 1.0 if joint.high - straight > straight - joint.low else -1.0
        if not bends * joint.axis[1] > 0.0:
            even = abs(joint.low + joint.high - 2.0 * straight) < _EVEN * (joint.high - joint.low)
            which = "may bend forward and backward" if even else "bends forward"
            other = "" if even else ", or, if right, exchange left and right in the file"
            raise InputError(
                f"the knee {joint.name!r} {which}, with its range of {joint.low:g} to {joint.high:g} rad; "
                f"correct it with [body.range]{other}.",
                key="body.foot",
            )
        return LegDescription(
            hip=_names(leg.hip),
            knee=joint.name,
            ankle=_names(leg.ankle),
            foot_segment=self.names[leg.foot],
            sole_frame=f"{side}_sole",
            sole_points=scene.add_sole_points(side, sole, [(foot, origin)] * 2, turn),
            straight_knee=straight,
            knee_sign=bends,
        )

    def _sole(self) -> SoleGeometry:
        """Outline of the sole from its reference point."""
        outline, leg = self.file.sole, self.legs[0]
        hip, ankle = leg.ends
        foot = leg.foot.place + self.tree.foot_offset
        under = (ankle - foot) @ sole_turn(outline.pitch)  # of the ankle, in the sole's axes
        sole = SoleGeometry(
            heel_x=outline.heel - outline.reference,
            ball_x=outline.front - outline.reference,
            tip_x=outline.front - outline.reference,
            heel_half_width=outline.heel_half_width,
            ball_half_width=outline.front_half_width,
            tip_half_width=outline.front_half_width,
            ankle_x=float(under[0]) - outline.reference,
            ankle_height=float(under[2]) - outline.bottom,
        )
        longest, length = max(sole.length, 2.0 * sole.half_width, sole.ankle_height), float(hip[2] - ankle[2])
        if not sole.ankle_height > 0.0:
            wrong = (
                f"sole.bottom = {outline.bottom:g} is {abs(sole.ankle_height):g} m over the ankle; measure "
                "it from the foot's origin, z upwards."
            )
        elif not (
            outline.heel < outline.reference < outline.front and sole.heel_x < sole.ankle_x < sole.tip_x
        ):
            wrong = (
                f"the ankle, at x = {under[0]:.4g} m, and sole.reference = {outline.reference:g} must be "
                f"strictly between sole.heel = {outline.heel:g} and sole.front = {outline.front:g}; "
                "mend sole or foot, x is forward."
            )
        elif longest > length:
            wrong = (
                f"a side of the sole, {longest:g} m, is longer than the leg, {length:.4g} m; give the "
                "outline in metres, and the model, too."
            )
        else:
            return sole
        raise InputError(wrong, key="body.sole")

    def write(self, run: RunParameters) -> BodyModel:
        """MJCF, with contact and simulation of a run, and description."""
        self._check()
        tree, sole = self.tree, self._sole()
        hip, hinges = self.legs[0].hip, tree.hinges.values()
        others = set(hinges).difference(self.trunk_joints, *(leg.joints for leg in self.legs))
        left_arm, right_arm, head = (
            _names(hinge for hinge in hinges if hinge in others and hinge.side == side) for side in (1, -1, 0)
        )
        mass = sum(segment.inertial.mass for segment in tree.segments)
        com_z = sum(s.inertial.mass * float(s.place[2] + s.inertial.com[2]) for s in tree.segments)
        floor = float(self.legs[0].ends[1][2]) - sole.ankle_height
        com_height, hip_height = com_z / mass - floor, float(_place(hip, 1)[2]) - floor
        height = com_height / (HIP_HEIGHT + COM_OVER_HIP)
        if not height <= _TALLEST:
            raise InputError(f"the body is {height:.4g} m tall, {_TALLEST:g} m at most; give it in metres.")
        model, root = scene.new_scene("body", self.names[tree.segments[0]], height, run)
        # Else MuJoCo's dampers would act as further inertia over a time step, which no controller knows.
        next(model.iter("flag")).set("eulerdamp", "disable")
        segments = self._add_segments(model, root, floor)
        add(segments[self.trunk], "site", name="imu", pos=self.trunk.inertial.com)
        left, right = (self._add_leg(leg, sole, segments[leg.foot]) for leg in self.legs)
        limits = tuple((hinge.name, hinge.effort) for hinge in hinges)
        scene.add_motors(model, limits)
        description = BodyDescription(
            height=height,
            mass=mass,
            root_segment=self.names[tree.segments[0]],
            trunk_segment=self.names[self.trunk],
            left_leg=left,
            right_leg=right,
            trunk=_names(self.trunk_joints),
            left_arm=left_arm,
            right_arm=right_arm,
            head=head,
            sole=sole,
            hip_height=hip_height,
            hip_half_width=abs(float(_place(hip, 0)[1])),
            leg_length=self.legs[0].straight()[1],
            com_over_hip=com_height - hip_height,
            mirror=tuple((hinge.name, hinge.image.name, hinge.sign) for hinge in hinges),
            torque_limits=limits,
            rest=self._rest(),
            upright=self._upright(com_height, floor),
            speed_limits=tuple((h.name, h.speed) for h in hinges if math.isfinite(h.speed)),
            passive=tuple(
                Passive(hinge.name, hinge.damping, hinge.stiffness, hinge.spring, hinge.friction)
                for hinge in hinges
                if hinge.damping or hinge.stiffness or hinge.friction
            ),
        )
        return BodyModel(scene.to_xml(model), description, tree.findings)

    def _upright(self, com_height: float, floor: float) -> UprightLegs | None:
        """How legs stay upright whose ankles do not roll; the heights are of COM and floor [m].

        The trunk sways as a pendulum about the hips; c_y is the height of the COM over that of its end.
        """
        leg = self.legs[0]
        if len(leg.joints) == LEG_JOINTS:
            return None
        legs, hips = {*leg.joints, *self.legs[1].joints}, float(_place(leg.hip, 0)[2])
        first = second = 0.0  # moments of what the hips carry, about the axis along x between them
        for segment in self.tree.segments:
            if legs.isdisjoint(segment.chain):
                part = segment.inertial
                _, aside, above = segment.place + part.com - (0.0, 0.0, hips)
                first += part.mass * above
                second += part.inertia[0, 0] + part.mass * (aside**2 + above**2)
        sole = leg.foot.place + self.tree.foot_offset
        width = 2.0 * (float(sole[1]) + self.file.sole.middle)
        return UprightLegs(width, com_height / (hips - floor + float(second / first)))

    def _add_segments(self, model: Element, root: Element, floor: float) -> dict[Segment, Element]:
        """Write all segments; ``floor`` is its height in the source [m]."""
        written: dict[Segment, Element] = {}
        for segment, name in self.names.items():
            element, place = root, np.array([0.0, 0.0, -floor])
            if segment.parent:
                element = add(written[segment.parent], "body", name=name)
                place = segment.place - segment.parent.place
            scene.set_inertial(element, place, segment.inertial)
            _add_joints(element, segment)
            _add_shapes(next(model.iter("asset")), element, name, segment)
            written[segment] = element
        return written

    def _check(self) -> None:
        """Refuse a body that cannot be simulated or steered."""
        hinges, of_legs = self.tree.hinges.values(), self.legs[0].joints + self.legs[1].joints
        ends = {leg.foot for leg in self.legs}
        leg_length = self.legs[0].straight()[1]
        below, wrong = list[str](), list[str]()
        for segment in self.tree.segments:
            if segment.parent in ends:
                ends.add(segment)
                below += _names(segment.joints)
            moments = np.linalg.eigvalsh(segment.inertial.inertia)
            if not (moments[0] > MASSLESS and moments[-1] <= segment.inertial.mass * leg_length**2):
                wrong.append(segment.name)
        resting = [joint.name for joint in of_legs if joint.name in self.file.rest]
        rest = [(self.tree.hinges[name], angle) for name, angle in self._rest()]
        outside = [
            f"{h.name} = {a:g}, not {h.low:g} to {h.high:g}" for h, a in rest if not h.low <= a <= h.high
        ]
        bare = [segment.name for segment in self.tree.segments if not segment.inertial.mass > 0.0]
        widest = dict.fromkeys(of_legs, _LARGEST_RANGE)
        astray = [h.name for h in hinges if not 0.0 < h.high - h.low <= widest.get(h, math.inf)]
        weak = [hinge.name for hinge in hinges if not 0.0 < hinge.effort < math.inf]
        still = [hinge.name for hinge in hinges if not hinge.speed > 0.0]
        of_pairs = ", by name of the left one of a pair"
        for names, what, way_out in (
            (below, "joints below a foot", "weld them with lock"),
            (resting, "joints of a leg in rest", "leave them out, as legs follow the gait"),
            (outside, "angles at rest outside of their range", "correct them"),
            (bare, "moving segments without positive mass", "give it in the model, or lock joints of no leg"),
            (wrong, "segments with moments of inertia of 0 or too large", "give radii with [body.gyration]"),
            (weak, "joints without a torque limit above 0", f"give it with [body.effort]{of_pairs}"),
            (still, "joints with a speed limit of 0", f"give it with [body.speed]{of_pairs}"),
            (
                astray,
                "joints whose range is empty or, in a leg, over two turns",
                f"give it in rad with [body.range], least angle first{of_pairs}",
            ),
        ):
            if names:
                raise InputError(f"the body has {what}: {', '.join(names)}; {way_out}.")

    def _rest(self) -> tuple[tuple[str, float], ...]:
        """Angles of hinges that do not rest at 0 [rad]; one that is for one side holds for both."""
        given, angles = self.file.rest, list[tuple[str, float]]()
        for name, hinge in self.tree.hinges.items():
            if angle := given.get(name, hinge.sign * given.get(hinge.image.name, 0.0)):
                angles.append((name, angle))
        return tuple(angles)


def _names(joints: Iterable[Hinge]) -> tuple[str, ...]:
    return tuple(joint.name for joint in joints)


def _place(joints: Sequence[Hinge], axis: int) -> Array:
    """Place of the hinge whose axis is nearest to an axis of the world, shape (3,) [m]."""
    return max(joints, key=lambda joint: abs(joint.axis[axis])).place


def sole_turn(pitch: float) -> Array:
    """Rotation of both soles to world with all joints at 0, by their ``pitch`` [rad], shape (3, 3)."""
    c, s = math.cos(pitch), math.sin(pitch)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _add_joints(element: Element, segment: Segment) -> None:
    """Write the hinges of a segment."""
    for hinge in segment.joints:
        values: dict[str, Any] = {}
        if math.isfinite(hinge.high - hinge.low):
            values["range"] = (hinge.low, hinge.high)
        if hinge.stiffness:
            values |= {"stiffness": hinge.stiffness, "springref": hinge.spring}
        add(
            element,
            "joint",
            name=hinge.name,
            type="hinge",
            pos=hinge.anchor,
            axis=hinge.axis,
            armature=hinge.armature,
            damping=hinge.damping,
            frictionloss=hinge.friction,
            solreffriction=_DRY,
            **values,
        )


def _add_shapes(asset: Element, element: Element, name: str, segment: Segment) -> None:
    """Write the shapes of a segment, its meshes as assets."""
    for number, shape in enumerate(segment.shapes or [_inertial_shape(segment)]):
        values = dict(shape)
        if "vertex" in shape:
            values["mesh"] = f"{name}_{number}"
            add(asset, "mesh", name=values["mesh"], vertex=values.pop("vertex").ravel())
        add(element, "geom", rgba=_COLOUR, **values)


def _inertial_shape(segment: Segment) -> dict[str, Any]:
    """The ellipsoid of equal density with the mass and the inertia of a segment that has no shape."""
    moments, axes = np.linalg.eigh(segment.inertial.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    squares = 2.5 * (moments.sum() - 2.0 * moments) / segment.inertial.mass
    size = np.sqrt(np.maximum(squares, _THIN**2))
    return {"type": "ellipsoid", "pos": segment.inertial.com, "quat": scene.quaternion(axes), "size": size}


def build_body(run: RunParameters) -> BodyModel:
    """Build the body that ``body.source`` of a run names, with its contact, time step and integrator.

    Raises InputError if there is no such body, or its description or source is not usable.
    """
    if run.body.source == HUMAN:
        return build_human(run)
    path = body_path(run.body.source)
    file = read_body_file(path)
    model, speeds = compiled_source(source_path(file.source, path.parent), balance=file.balance_inertia)
    return Writer(Tree(file, model, speeds)).write(run)

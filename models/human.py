"""The 40-dof human of the paper: 17 segments, 34 hinges and a free root, for any stature and mass.

The model is written from the tables in :mod:`models.anthropometry`. Every segment has an explicit
inertial; visual geometry has neither mass nor contact. Only the twelve points under the soles have contact,
and only with the floor.
"""

from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ampm.description import BodyDescription, LegDescription, SoleGeometry
from ampm.parameters import GRAVITY, BodyParameters
from ampm.physics_parameters import ContactParameters, SimulationParameters
from models import anthropometry as table
from models import scene
from models.scene import BodyModel, Inertial, add

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]

_AXES = {"roll": (1, 0, 0), "pitch": (0, 1, 0), "yaw": (0, 0, 1)}
_TRUNK_JOINTS = ("yaw", "roll", "pitch")
_BALL_JOINTS = ("pitch", "roll", "yaw")

_SKIN = (0.87, 0.72, 0.60, 1.0)
_SHIRT = (0.25, 0.42, 0.62, 1.0)
_TROUSERS = (0.23, 0.25, 0.31, 1.0)
_LEFT_SHADE = (0.30, 0.33, 0.40, 1.0)
_SHOE = (0.55, 0.16, 0.14, 1.0)
_TOE_CAP = (0.72, 0.30, 0.24, 1.0)


def sole_geometry(height: float) -> SoleGeometry:
    """Outline of the sole of a body of stature ``height`` [m]."""
    return SoleGeometry(**{name: share * height for name, share in table.SOLE.items()})


def _joint(name: str) -> tuple[tuple[float, float], float]:
    """Range [rad] and share of torque [1] of a hinge; a right limb's roll and yaw are mirrored."""
    side, _, rest = name.partition("_")
    low, high, torque = table.JOINTS[rest if side in scene.SIDES else name]
    if side == "right" and not rest.endswith("pitch"):
        low, high = 0.0 - high, 0.0 - low
    return (low, high), torque


class Builder:
    """Writes the MJCF of a human, trunk first, then legs, then arms.

    Args:
        body: ``height`` [m] and ``mass`` [kg].
        contact: stiffness and friction of the soles on the floor.
        simulation: ``time_step`` [s] and ``integrator``.
    """

    def __init__(
        self, body: BodyParameters, contact: ContactParameters, simulation: SimulationParameters
    ) -> None:
        self.height, self.mass = body.height, body.mass
        # The table adds up to 100.00 %; dividing by the sum keeps the total exact whatever is edited there.
        self.table_mass = self.mass / table.TOTAL_MASS_SHARE
        self.sole = sole_geometry(self.height)
        self.model, self.pelvis = scene.new_scene("human", "pelvis", self.height, contact, simulation)

    def _inertial(self, row: table.Row, length: float, com: Vector) -> Inertial:
        """Inertial of a table row for a segment of a length [m] with its COM [m]; z is the long axis."""
        mass = row.mass * self.table_mass
        radii = np.array(row.radii) * length
        return Inertial(mass, np.array(com), mass * np.diag(np.square(radii)))

    def _segment(self, on: Element, name: str, pos: Any, inertial: Inertial) -> Element:
        return scene.fill(add(on, "body", name=name), pos, inertial)

    def _limb(self, on: Element, name: str, pos: Any, row: table.Row, length: float) -> Element:
        """Add a segment of one table row, which runs downward from its origin."""
        return self._segment(on, name, pos, self._inertial(row, length, (0, 0, -row.com * length)))

    def _hinges(self, body: Element, prefix: str, kinds: tuple[str, ...]) -> tuple[str, ...]:
        names = tuple(f"{prefix}_{kind}" for kind in kinds)
        for name, kind in zip(names, kinds, strict=True):
            add(body, "joint", name=name, type="hinge", axis=_AXES[kind], range=_joint(name)[0])
        return names

    def _capsule(self, body: Element, start: Vector, end: Vector, radius: float, rgba: Colour) -> None:
        add(body, "geom", type="capsule", fromto=(*start, *end), size=radius, rgba=rgba)

    def _ellipsoid(self, body: Element, pos: Any, size: Vector, rgba: Colour) -> None:
        add(body, "geom", type="ellipsoid", pos=pos, size=size, rgba=rgba)

    def build(self) -> BodyModel:
        """At ``q = 0`` it stands upright with hanging arms, its hips at x = 0 and its soles on the floor."""
        waist, chest = self._trunk()
        left_leg, right_leg = map(self._leg, scene.SIDES)
        left_arm, right_arm = map(self._arm, scene.SIDES)
        names = [joint.get("name", "") for joint in self.model.iter("joint")]
        limits = tuple((name, _joint(name)[1] * self.mass * GRAVITY * self.height) for name in names)
        scene.add_motors(self.model, limits)
        description = BodyDescription(
            height=self.height,
            mass=self.mass,
            root_segment="pelvis",
            trunk_segment="thorax",
            left_leg=left_leg,
            right_leg=right_leg,
            waist=waist,
            chest=chest,
            left_arm=left_arm,
            right_arm=right_arm,
            head=(),
            sole=self.sole,
            hip_height=table.HIP_HEIGHT * self.height,
            hip_half_width=table.HIP_HALF_WIDTH * self.height,
            leg_length=(table.HIP_HEIGHT - table.ANKLE_HEIGHT) * self.height,
            com_over_hip=table.COM_OVER_HIP * self.height,
            mirror=tuple(map(_mirrored, names)),
            torque_limits=limits,
            spread=(("left_shoulder_roll", 1.0), ("right_shoulder_roll", -1.0)),
        )
        return BodyModel(scene.to_xml(self.model), description)

    def _trunk(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Hinges of waist and chest."""
        h = self.height
        # De Leva's trunk, set upon Winter's hip, would make the body 1.6 % too tall.
        rows = (table.HEAD, table.UPPER_TRUNK, table.MIDDLE_TRUNK, table.LOWER_TRUNK)
        scale = (1.0 - table.HIP_HEIGHT) / sum(row.length for row in rows) * h
        head, upper, middle, lower = (row.length * scale for row in rows)

        def upward(row: table.Row, length: float) -> Inertial:
            """Rows run downward, but the frames of the trunk are at the lower end."""
            return self._inertial(row, length, (0, 0, (1 - row.com) * length))

        pelvis = scene.fill(self.pelvis, (0, 0, table.HIP_HEIGHT * h), upward(table.LOWER_TRUNK, lower))
        self._ellipsoid(pelvis, (0, 0, 0.035 * h), (0.068 * h, 0.099 * h, 0.062 * h), _TROUSERS)

        abdomen = self._segment(pelvis, "abdomen", (0, 0, lower), upward(table.MIDDLE_TRUNK, middle))
        waist = self._hinges(abdomen, "waist", _TRUNK_JOINTS)
        self._ellipsoid(abdomen, (0, 0, 0.45 * middle), (0.062 * h, 0.088 * h, 0.105 * h), _SHIRT)

        skull = self._inertial(table.HEAD, head, (0, 0, upper + (1 - table.HEAD.com) * head))
        both = upward(table.UPPER_TRUNK, upper).plus(skull)
        thorax = self._segment(abdomen, "thorax", (0, 0, middle), both)
        chest = self._hinges(thorax, "chest", _TRUNK_JOINTS)
        self._ellipsoid(thorax, (0, 0, 0.40 * upper), (0.068 * h, 0.102 * h, 0.112 * h), _SHIRT)
        shoulder_z = table.SHOULDER_HEIGHT * h - table.HIP_HEIGHT * h - lower - middle
        half = table.SHOULDER_HALF_WIDTH * h
        self._capsule(thorax, (0, -0.82 * half, shoulder_z), (0, 0.82 * half, shoulder_z), 0.031 * h, _SHIRT)
        self._capsule(thorax, (0, 0, shoulder_z), (0.004 * h, 0, upper + 0.15 * head), 0.030 * h, _SKIN)
        self._ellipsoid(
            thorax, (0.012 * h, 0, upper + 0.53 * head), (0.054 * h, 0.045 * h, 0.47 * head), _SKIN
        )
        nose = (0.064 * h, 0, upper + 0.46 * head)
        self._ellipsoid(thorax, nose, (0.010 * h, 0.007 * h, 0.013 * h), _SKIN)
        add(thorax, "site", name="imu", pos=(0, 0, 0.5 * upper))
        self.thorax, self.shoulder_z = thorax, shoulder_z
        return waist, chest

    def _leg(self, side: str) -> LegDescription:
        h, sole = self.height, self.sole
        sign = 1.0 if side == "left" else -1.0
        thigh_length = (table.HIP_HEIGHT - table.KNEE_HEIGHT) * h
        shank_length = (table.KNEE_HEIGHT - table.ANKLE_HEIGHT) * h
        rgba = _LEFT_SHADE if side == "left" else _TROUSERS

        socket = (0, sign * table.HIP_HALF_WIDTH * h, 0)
        thigh = self._limb(self.pelvis, f"{side}_thigh", socket, table.THIGH, thigh_length)
        hip = self._hinges(thigh, f"{side}_hip", _BALL_JOINTS)
        self._capsule(thigh, (0, 0, 0), (0, 0, -thigh_length), 0.035 * h, rgba)
        self._ellipsoid(
            thigh, (0, 0, -0.36 * thigh_length), (0.051 * h, 0.044 * h, 0.46 * thigh_length), rgba
        )

        shank = self._limb(thigh, f"{side}_shank", (0, 0, -thigh_length), table.SHANK, shank_length)
        (knee,) = self._hinges(shank, f"{side}_knee", ("pitch",))
        self._capsule(shank, (0, 0, 0), (0, 0, -0.97 * shank_length), 0.023 * h, rgba)
        belly = (-0.010 * h, 0, -0.30 * shank_length)
        self._ellipsoid(shank, belly, (0.034 * h, 0.033 * h, 0.32 * shank_length), rgba)

        to_ankle = np.array([sole.ankle_x, 0.0, sole.ankle_height])  # of the foot's frame, in the sole frame
        to_toe = np.array([sole.ball_x, 0.0, 0.0])
        foot_inertial, toe_inertial = self._foot_inertials()
        foot = self._segment(shank, f"{side}_foot", (0, 0, -shank_length), foot_inertial.seen_from(to_ankle))
        ankle = self._hinges(foot, f"{side}_ankle", ("pitch", "roll"))
        add(foot, "site", name=f"{side}_sole", pos=-to_ankle)
        back, front = sole.heel_x - 0.004 * h, sole.ball_x
        thickness = table.TOE_THICKNESS * h
        pos = np.array([0.5 * (back + front), 0, 0.5 * thickness + 0.001]) - to_ankle
        size = (0.5 * (front - back), 0.9 * sole.ball_half_width, 0.5 * thickness)
        add(foot, "geom", type="box", pos=pos, size=size, rgba=_SHOE)
        pos = np.array([0.35 * front + 0.65 * back, 0, 0.55 * sole.ankle_height]) - to_ankle
        size = (0.46 * (front - back), 0.8 * sole.ball_half_width, 0.46 * sole.ankle_height)
        self._ellipsoid(foot, pos, size, _SHOE)

        toe = self._segment(foot, f"{side}_toe", to_toe - to_ankle, toe_inertial.seen_from(to_toe))
        (toe_joint,) = self._hinges(toe, f"{side}_toe", ("pitch",))
        add(toe, "site", name=f"{side}_toe_axis")
        length = sole.tip_x - sole.ball_x + 0.003 * h
        size = (0.5 * length, 0.9 * sole.ball_half_width, 0.5 * thickness)
        pos = (0.5 * length, 0, 0.5 * thickness + 0.001)
        add(toe, "geom", type="box", pos=pos, size=size, rgba=_TOE_CAP)

        points = scene.add_sole_points(side, sole, [(foot, -to_ankle), (foot, -to_ankle), (toe, -to_toe)])
        return LegDescription(
            hip=hip,
            knee=knee,
            ankle=ankle,
            toe=toe_joint,
            foot_segment=f"{side}_foot",
            toe_segment=f"{side}_toe",
            sole_frame=f"{side}_sole",
            sole_points=points,
        )

    def _foot_inertials(self) -> tuple[Inertial, Inertial]:
        """Inertials of foot and toes in the sole frame.

        The toes are a homogeneous box in front of the toe axis with DELP's share of the mass; the rest is cut
        so that both together have exactly the mass, centre of mass and inertia of DE_LEVA's foot.
        """
        h, sole = self.height, self.sole
        com = (sole.heel_x + table.FOOT.com * sole.length, 0, table.FOOT_COM_HEIGHT * sole.ankle_height)
        # The row's longitudinal axis points forward, the sagittal one upward.
        row = replace(table.FOOT, radii=table.FOOT.radii[::-1])
        whole = self._inertial(row, sole.length, com)
        x, y, z = sole.tip_x - sole.ball_x, 2.0 * sole.tip_half_width, table.TOE_THICKNESS * h
        mass = table.TOE_MASS_SHARE * whole.mass
        box = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
        toes = Inertial(mass, np.array([0.5 * (sole.ball_x + sole.tip_x), 0, 0.5 * z]), box)
        return whole.plus(Inertial(-toes.mass, toes.com, -toes.inertia)), toes

    def _arm(self, side: str) -> tuple[str, ...]:
        h = self.height
        sign = 1.0 if side == "left" else -1.0
        upper_length, fore_length = table.UPPER_ARM.length * h, table.FOREARM.length * h
        hand_length = table.HAND.length * h
        shoulder = (0, sign * table.SHOULDER_HALF_WIDTH * h, self.shoulder_z)
        upper = self._limb(self.thorax, f"{side}_upper_arm", shoulder, table.UPPER_ARM, upper_length)
        joints = list(self._hinges(upper, f"{side}_shoulder", _BALL_JOINTS))
        self._capsule(upper, (0, 0, -0.3 * upper_length), (0, 0, -upper_length), 0.023 * h, _SKIN)
        self._ellipsoid(
            upper, (0, 0, -0.26 * upper_length), (0.034 * h, 0.032 * h, 0.40 * upper_length), _SHIRT
        )
        fore = self._limb(upper, f"{side}_forearm", (0, 0, -upper_length), table.FOREARM, fore_length)
        joints += self._hinges(fore, f"{side}_elbow", ("pitch", "yaw"))
        self._capsule(fore, (0, 0, 0), (0, 0, -0.98 * fore_length), 0.017 * h, _SKIN)
        self._ellipsoid(fore, (0, 0, -0.28 * fore_length), (0.025 * h, 0.024 * h, 0.34 * fore_length), _SKIN)
        # The row's radii belong to a hand whose palm faces forward; here it faces the thigh, so the fore-aft
        # and left-right radii change places.
        sagittal, transverse, longitudinal = table.HAND.radii
        hand_row = replace(table.HAND, radii=(transverse, sagittal, longitudinal))
        hand = self._limb(fore, f"{side}_hand", (0, 0, -fore_length), hand_row, hand_length)
        joints += self._hinges(hand, f"{side}_wrist", ("pitch", "roll"))
        self._ellipsoid(hand, (0, 0, -0.9 * hand_length), (0.024 * h, 0.009 * h, 0.054 * h), _SKIN)
        return tuple(joints)


def _mirrored(joint: str) -> tuple[str, str, float]:
    """(joint, its mirror image, sign): roll and yaw change sign under reflection in the sagittal plane."""
    side, _, rest = joint.partition("_")
    image = {"left": f"right_{rest}", "right": f"left_{rest}"}.get(side, joint)
    return (joint, image, 1.0 if joint.endswith("pitch") else -1.0)

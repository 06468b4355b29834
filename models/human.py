"""The 40-dof human of the paper: 17 segments, 34 hinges and a free root, for any stature and mass.

The model is written with PyMJCF from the tables in :mod:`models.anthropometry`. Every segment has an explicit
inertial; visual geometry has neither mass nor contact. Only the twelve points under the soles have contact,
and only with the floor.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from pydantic import TypeAdapter

from ampm.description import SOLE_POINT_GROUPS, BodyDescription, LegDescription, SoleGeometry
from models import anthropometry as table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import BodyParameters, ContactParameters, SimulationParameters

GRAVITY = 9.81
"""Gravity [m/s^2], as in the paper."""
SOLE_POINT_RADIUS = 0.00001
"""Radius of the spheres that touch the floor [m]."""
SIDES = ("left", "right")

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]

_AXES = {"roll": (1, 0, 0), "pitch": (0, 1, 0), "yaw": (0, 0, 1)}
# Twelve digits: legible, the same text on every platform, and 1e-11 kg at most in the total mass.
_XML_PRECISION = 12

_TRUNK_JOINTS = ("yaw", "roll", "pitch")
_BALL_JOINTS = ("pitch", "roll", "yaw")

_SKIN = (0.87, 0.72, 0.60, 1.0)
_SHIRT = (0.25, 0.42, 0.62, 1.0)
_TROUSERS = (0.23, 0.25, 0.31, 1.0)
_LEFT_SHADE = (0.30, 0.33, 0.40, 1.0)
_SHOE = (0.55, 0.16, 0.14, 1.0)
_TOE_CAP = (0.72, 0.30, 0.24, 1.0)


@dataclass(frozen=True)
class BodyModel:
    """A body ready to be simulated.

    Attributes:
        xml: MJCF text, complete in itself.
        description: which joint, sole and segment is what.
    """

    xml: str
    description: BodyDescription

    def compile(self) -> mujoco.MjModel:
        """Return the compiled MuJoCo model."""
        return mujoco.MjModel.from_xml_string(self.xml)


@dataclass(frozen=True)
class _Inertial:
    """Mass [kg], centre of mass in the segment's frame (3,) [m], inertia about it (3, 3) [kg m^2]."""

    mass: float
    com: NDArray[np.float64]
    inertia: NDArray[np.float64]

    def about(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Inertia (3, 3) about ``point`` (3,) of the same frame [kg m^2]."""
        r = self.com - point
        return self.inertia + self.mass * ((r * r).sum() * np.eye(3) - np.outer(r, r))

    def plus(self, other: _Inertial) -> _Inertial:
        """Both bodies taken together."""
        mass = self.mass + other.mass
        com = (self.mass * self.com + other.mass * other.com) / mass
        return _Inertial(mass, com, self.about(com) + other.about(com))

    def seen_from(self, point: NDArray[np.float64]) -> _Inertial:
        """The same body in a frame with its origin at ``point`` (3,) [m]."""
        return replace(self, com=self.com - point)

    def minus(self, part: _Inertial) -> _Inertial:
        """The remainder when ``part`` is cut off."""
        mass = self.mass - part.mass
        com = (self.mass * self.com - part.mass * part.com) / mass
        return _Inertial(mass, com, self.about(com) - part.about(com))


def _inertial(
    segment: table.Segment, body_mass: float, length: float, com: Vector, *, forward: bool = False
) -> _Inertial:
    """Inertial of a table row for a segment of ``length`` [m] with its centre of mass at ``com`` [m].

    The longitudinal axis is z, or x if ``forward``; then the sagittal axis points up.
    """
    sagittal, transverse, longitudinal = (radius * length for radius in segment.radii)
    radii = (longitudinal, transverse, sagittal) if forward else (sagittal, transverse, longitudinal)
    mass = segment.mass * body_mass
    return _Inertial(mass, np.array(com), mass * np.diag(np.square(radii)))


def _box_inertial(mass: float, com: Vector, size: Vector) -> _Inertial:
    """Inertial of a homogeneous box with the edge lengths ``size`` [m]."""
    x, y, z = size
    inertia = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    return _Inertial(mass, np.array(com), inertia)


def sole_geometry(height: float) -> SoleGeometry:
    """Outline of the sole of a body of stature ``height`` [m]."""
    return SoleGeometry(**{name: share * height for name, share in table.SOLE.items()})


def _joint(name: str) -> tuple[tuple[float, float], float]:
    """Range [rad] and share of torque [1] of a hinge; a right limb's roll and yaw are mirrored."""
    side, _, rest = name.partition("_")
    low, high, torque = table.JOINTS[rest if side in SIDES else name]
    if side == "right" and not rest.endswith("pitch"):
        low, high = 0.0 - high, 0.0 - low
    return (low, high), torque


class _Builder:
    """Writes the MJCF of one body, trunk first, then legs, then arms."""

    def __init__(
        self, body: BodyParameters, contact: ContactParameters, simulation: SimulationParameters
    ) -> None:
        from models._pymjcf import mjcf  # imported here: a body that is kept needs no PyMJCF

        self.height = float(body.height)
        self.mass = float(body.mass)
        # The table adds up to 100.00 %; dividing by the sum keeps the total exact whatever is edited there.
        self.table_mass = self.mass / table.TOTAL_MASS_SHARE
        self.sole = sole_geometry(self.height)
        self.root = mjcf.RootElement(model="human")
        # De Leva's trunk, set upon Winter's hip, would make the body 1.6 % too tall.
        rows = (table.HEAD, table.UPPER_TRUNK, table.MIDDLE_TRUNK, table.LOWER_TRUNK)
        trunk = sum(row.length for row in rows)
        self.trunk_scale = (1.0 - table.HIP_HEIGHT) / trunk * self.height
        self._options(contact, simulation)

    def _options(self, contact: ContactParameters, simulation: SimulationParameters) -> None:
        root = self.root
        root.compiler.set_attributes(
            angle="radian", autolimits=True, inertiafromgeom=False, balanceinertia=False
        )
        # Contact forces are measured, so the tolerance is that of rounding; Newton needs few iterations.
        root.option.set_attributes(
            timestep=simulation.time_step, integrator=simulation.integrator, gravity=(0, 0, -GRAVITY),
            cone="elliptic", impratio=contact.impratio, solver="Newton", iterations=100, tolerance=1e-12,
            ls_iterations=50, ls_tolerance=1e-3,
        )  # fmt: skip
        root.statistic.set_attributes(extent=2.0, center=(0, 0, 0.5 * self.height))
        root.visual.map.znear = 0.01
        root.visual.quality.shadowsize = 4096
        root.visual.headlight.set_attributes(ambient=(0.35, 0.35, 0.35), diffuse=(0.55, 0.55, 0.55))
        getattr(root.visual, "global").set_attributes(offwidth=1920, offheight=1080)

        root.default.geom.set_attributes(contype=0, conaffinity=0, mass=0, group=1)
        root.default.site.set_attributes(size=(0.004,), group=4)
        root.default.add("default", dclass="contact").geom.set_attributes(
            condim=3,
            friction=(contact.friction, 0.005, 0.0001),
            solref=(contact.time_constant, contact.damping_ratio),
            solimp=(contact.impedance_min, contact.impedance_max, contact.impedance_width, 0.5, 2),
            group=0,
        )

        for name, kind, pattern, first, second in (
            ("sky", "skybox", "gradient", (0.93, 0.95, 0.97), (0.6, 0.7, 0.8)),
            ("floor", "2d", "checker", (0.78, 0.80, 0.82), (0.70, 0.72, 0.75)),
        ):
            colours = {"rgb1": first, "rgb2": second}
            root.asset.add("texture", name=name, type=kind, builtin=pattern, width=256, height=256, **colours)
        # One square is 0.5 m: the pattern repeats every metre.
        root.asset.add("material", name="floor", texture="floor", texrepeat=(1, 1), texuniform=True)
        # contype only on the floor, conaffinity only on the points: two points never touch each other.
        root.worldbody.add(
            "geom", name="floor", dclass="contact", type="plane", size=(0, 0, 1), material="floor", contype=1,
            conaffinity=0,
        )  # fmt: skip

    def _body(self, parent: Any, name: str, pos: Vector, inertial: _Inertial) -> Any:
        body = parent.add("body", name=name, pos=pos)
        values: dict[str, Any] = {"mass": inertial.mass, "pos": inertial.com}
        i = inertial.inertia
        if abs(i[0, 2]) > 0.0:
            values["fullinertia"] = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        else:
            values["diaginertia"] = np.diag(i)
        body.add("inertial", **values)
        return body

    def _segment(
        self, parent: Any, name: str, pos: Vector, row: table.Segment, length: float, *, upward: bool = False
    ) -> Any:
        """Add a segment of one table row; rows run downward, the frames of the trunk are at the lower end."""
        return self._body(parent, name, pos, self._inertial(row, length, upward=upward))

    def _inertial(self, row: table.Segment, length: float, *, upward: bool = False) -> _Inertial:
        com = (1 - row.com) * length if upward else -row.com * length
        return _inertial(row, self.table_mass, length, (0, 0, com))

    def _hinges(self, body: Any, prefix: str, kinds: tuple[str, ...]) -> tuple[str, ...]:
        names = tuple(f"{prefix}_{kind}" for kind in kinds)
        for name, kind in zip(names, kinds, strict=True):
            body.add("joint", name=name, type="hinge", axis=_AXES[kind], range=_joint(name)[0])
        return names

    def _capsule(self, body: Any, start: Vector, end: Vector, radius: float, rgba: Colour) -> None:
        body.add("geom", type="capsule", fromto=(*start, *end), size=(radius,), rgba=rgba)

    def _limb(self, body: Any, length: float, radius: float, rgba: Colour) -> None:
        self._capsule(body, (0, 0, 0), (0, 0, -length), radius, rgba)

    def _ellipsoid(self, body: Any, pos: Any, size: Vector, rgba: Colour) -> None:
        body.add("geom", type="ellipsoid", pos=pos, size=size, rgba=rgba)

    def build(self) -> BodyModel:
        waist, chest = self._trunk()
        left_leg, right_leg = map(self._leg, SIDES)
        left_arm, right_arm = map(self._arm, SIDES)
        self._sensors()
        limits = tuple(
            (name, _joint(name)[1] * self.mass * GRAVITY * self.height) for name in self._chain_order()
        )
        for name, limit in limits:
            both = (-limit, limit)
            self.root.actuator.add(
                "motor", name=name, joint=name, gear=(1,), ctrllimited=True, ctrlrange=both,
                forcelimited=True, forcerange=both,
            )  # fmt: skip
        description = BodyDescription(
            height=self.height,
            mass=self.mass,
            root_segment="pelvis",
            trunk_segment="thorax",
            trunk_frame="thorax",
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
            mirror=tuple(_mirrored(name) for name, _ in limits),
            torque_limits=limits,
            spread=(("left_shoulder_roll", 1.0), ("right_shoulder_roll", -1.0)),
        )
        return BodyModel(self.root.to_xml_string(precision=_XML_PRECISION), description)

    def _chain_order(self) -> list[str]:
        """Hinges in MuJoCo's joint order, which is depth first."""
        joints = self.root.find_all("joint", exclude_attachments=True)
        return [joint.name for joint in joints if joint.tag == "joint"]

    def _trunk(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Hinges of waist and chest."""
        h, scale = self.height, self.trunk_scale
        lower, middle = table.LOWER_TRUNK.length * scale, table.MIDDLE_TRUNK.length * scale
        upper, head = table.UPPER_TRUNK.length * scale, table.HEAD.length * scale
        hips = (0, 0, table.HIP_HEIGHT * h)
        pelvis = self._segment(self.root.worldbody, "pelvis", hips, table.LOWER_TRUNK, lower, upward=True)
        pelvis.add("freejoint", name="root")
        # A light that follows the body: a fixed one casts grainy shadows on a large floor.
        pelvis.add(
            "light", name="lamp", mode="trackcom", pos=(1.2, -1.6, 3.2), dir=(-0.33, 0.42, -1), cutoff=75,
            exponent=0, castshadow=True, diffuse=(0.5, 0.5, 0.5), specular=(0.1, 0.1, 0.1),
        )  # fmt: skip
        for name, pos, xyaxes in (
            ("side", (0.0, -3.2, 0.1), (1, 0, 0, 0, 0.03, 1)),
            ("front", (3.2, 0.0, 0.1), (0, 1, 0, -0.03, 0, 1)),
            ("oblique", (2.3, -2.3, 0.5), (0.707, 0.707, 0, -0.13, 0.13, 1)),
        ):
            pelvis.add("camera", name=name, mode="trackcom", pos=pos, xyaxes=xyaxes)
        self._ellipsoid(pelvis, (0, 0, 0.035 * h), (0.068 * h, 0.099 * h, 0.062 * h), _TROUSERS)

        abdomen = self._segment(pelvis, "abdomen", (0, 0, lower), table.MIDDLE_TRUNK, middle, upward=True)
        waist = self._hinges(abdomen, "waist", _TRUNK_JOINTS)
        self._ellipsoid(abdomen, (0, 0, 0.45 * middle), (0.062 * h, 0.088 * h, 0.105 * h), _SHIRT)

        skull = _inertial(table.HEAD, self.table_mass, head, (0, 0, upper + (1 - table.HEAD.com) * head))
        both = self._inertial(table.UPPER_TRUNK, upper, upward=True).plus(skull)
        thorax = self._body(abdomen, "thorax", (0, 0, middle), both)
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
        thorax.add("site", name="imu", pos=(0, 0, 0.5 * upper))
        self.pelvis, self.thorax, self.shoulder_z = pelvis, thorax, shoulder_z
        return waist, chest

    def _leg(self, side: str) -> LegDescription:
        h, sole = self.height, self.sole
        sign = 1.0 if side == "left" else -1.0
        thigh_length = (table.HIP_HEIGHT - table.KNEE_HEIGHT) * h
        shank_length = (table.KNEE_HEIGHT - table.ANKLE_HEIGHT) * h
        rgba = _LEFT_SHADE if side == "left" else _TROUSERS

        socket = (0, sign * table.HIP_HALF_WIDTH * h, 0)
        thigh = self._segment(self.pelvis, f"{side}_thigh", socket, table.THIGH, thigh_length)
        hip = self._hinges(thigh, f"{side}_hip", _BALL_JOINTS)
        self._limb(thigh, thigh_length, 0.035 * h, rgba)
        self._ellipsoid(
            thigh, (0, 0, -0.36 * thigh_length), (0.051 * h, 0.044 * h, 0.46 * thigh_length), rgba
        )

        shank = self._segment(thigh, f"{side}_shank", (0, 0, -thigh_length), table.SHANK, shank_length)
        (knee,) = self._hinges(shank, f"{side}_knee", ("pitch",))
        self._limb(shank, 0.97 * shank_length, 0.023 * h, rgba)
        belly = (-0.010 * h, 0, -0.30 * shank_length)
        self._ellipsoid(shank, belly, (0.034 * h, 0.033 * h, 0.32 * shank_length), rgba)

        foot_inertial, toe_inertial = self._foot_inertials()
        to_ankle = np.array([sole.ankle_x, 0.0, sole.ankle_height])  # of the foot's frame, in the sole frame
        foot_inertial = foot_inertial.seen_from(to_ankle)
        foot = self._body(shank, f"{side}_foot", (0, 0, -shank_length), foot_inertial)
        ankle = self._hinges(foot, f"{side}_ankle", ("pitch", "roll"))
        foot.add("site", name=f"{side}_sole", pos=-to_ankle)
        back, front = sole.heel_x - 0.004 * h, sole.ball_x
        thickness = table.TOE_THICKNESS * h
        pos = np.array([0.5 * (back + front), 0, 0.5 * thickness + 0.001]) - to_ankle
        size = (0.5 * (front - back), 0.9 * sole.ball_half_width, 0.5 * thickness)
        foot.add("geom", type="box", pos=pos, size=size, rgba=_SHOE)
        pos = np.array([0.35 * front + 0.65 * back, 0, 0.55 * sole.ankle_height]) - to_ankle
        size = (0.46 * (front - back), 0.8 * sole.ball_half_width, 0.46 * sole.ankle_height)
        self._ellipsoid(foot, pos, size, _SHOE)

        to_toe = np.array([sole.ball_x, 0.0, 0.0])
        toe = self._body(foot, f"{side}_toe", tuple(to_toe - to_ankle), toe_inertial.seen_from(to_toe))
        (toe_joint,) = self._hinges(toe, f"{side}_toe", ("pitch",))
        toe.add("site", name=f"{side}_toe_axis")
        length = sole.tip_x - sole.ball_x + 0.003 * h
        size = (0.5 * length, 0.9 * sole.ball_half_width, 0.5 * thickness)
        pos = (0.5 * length, 0, 0.5 * thickness + 0.001)
        toe.add("geom", type="box", pos=pos, size=size, rgba=_TOE_CAP)

        points = []
        for group in SOLE_POINT_GROUPS:
            body, origin = (toe, to_toe) if group == "tip" else (foot, to_ankle)
            x, half_width = getattr(sole, f"{group}_x"), getattr(sole, f"{group}_half_width")
            for edge, edge_sign in (("left", 1.0), ("right", -1.0)):
                name = f"{side}_{group}_{edge}"
                pos = np.array([x, edge_sign * half_width, 0.0]) - origin
                body.add("site", name=name, pos=pos)
                # The sphere stands on the site, so the point that touches the floor is the site.
                body.add(
                    "geom", name=name, dclass="contact", type="sphere", size=(SOLE_POINT_RADIUS,),
                    pos=pos + np.array([0, 0, SOLE_POINT_RADIUS]), contype=0, conaffinity=1,
                    rgba=(0.1, 0.1, 0.1, 1),
                )  # fmt: skip
                points.append(name)
        return LegDescription(
            hip=hip,
            knee=knee,
            ankle=ankle,
            toe=toe_joint,
            foot_segment=f"{side}_foot",
            toe_segment=f"{side}_toe",
            sole_frame=f"{side}_sole",
            sole_points=tuple(points),
        )

    def _foot_inertials(self) -> tuple[_Inertial, _Inertial]:
        """Inertials of foot and toes in the sole frame.

        The toes are a homogeneous box in front of the toe axis with DELP's share of the mass; the rest is cut
        so that both together have exactly the mass, centre of mass and inertia of DE_LEVA's foot.
        """
        h, sole = self.height, self.sole
        whole = _inertial(
            table.FOOT,
            self.table_mass,
            sole.length,
            (sole.heel_x + table.FOOT.com * sole.length, 0, table.FOOT_COM_HEIGHT * sole.ankle_height),
            forward=True,
        )
        thickness = table.TOE_THICKNESS * h
        toes = _box_inertial(
            table.TOE_MASS_SHARE * whole.mass,
            (0.5 * (sole.ball_x + sole.tip_x), 0, 0.5 * thickness),
            (sole.tip_x - sole.ball_x, 2.0 * sole.tip_half_width, thickness),
        )
        return whole.minus(toes), toes

    def _arm(self, side: str) -> tuple[str, ...]:
        h = self.height
        sign = 1.0 if side == "left" else -1.0
        upper_length, fore_length = table.UPPER_ARM.length * h, table.FOREARM.length * h
        hand_length = table.HAND.length * h
        shoulder = (0, sign * table.SHOULDER_HALF_WIDTH * h, self.shoulder_z)
        upper = self._segment(self.thorax, f"{side}_upper_arm", shoulder, table.UPPER_ARM, upper_length)
        joints = list(self._hinges(upper, f"{side}_shoulder", _BALL_JOINTS))
        self._capsule(upper, (0, 0, -0.3 * upper_length), (0, 0, -upper_length), 0.023 * h, _SKIN)
        self._ellipsoid(
            upper, (0, 0, -0.26 * upper_length), (0.034 * h, 0.032 * h, 0.40 * upper_length), _SHIRT
        )
        fore = self._segment(upper, f"{side}_forearm", (0, 0, -upper_length), table.FOREARM, fore_length)
        joints += self._hinges(fore, f"{side}_elbow", ("pitch", "yaw"))
        self._limb(fore, 0.98 * fore_length, 0.017 * h, _SKIN)
        self._ellipsoid(fore, (0, 0, -0.28 * fore_length), (0.025 * h, 0.024 * h, 0.34 * fore_length), _SKIN)
        # The row's radii belong to a hand whose palm faces forward; here it faces the thigh, so the fore-aft
        # and left-right radii change places.
        sagittal, transverse, longitudinal = table.HAND.radii
        hand_row = replace(table.HAND, radii=(transverse, sagittal, longitudinal))
        hand = self._segment(fore, f"{side}_hand", (0, 0, -fore_length), hand_row, hand_length)
        joints += self._hinges(hand, f"{side}_wrist", ("pitch", "roll"))
        self._ellipsoid(hand, (0, 0, -0.9 * hand_length), (0.024 * h, 0.009 * h, 0.054 * h), _SKIN)
        return tuple(joints)

    def _sensors(self) -> None:
        sensor = self.root.sensor
        sensor.add("accelerometer", name="imu_accelerometer", site="imu")
        sensor.add("gyro", name="imu_gyro", site="imu")
        sensor.add("framequat", name="imu_orientation", objtype="site", objname="imu")
        sensor.add("subtreecom", name="com", body="pelvis")
        sensor.add("subtreeangmom", name="angular_momentum", body="pelvis")
        for name in self._chain_order():
            sensor.add("jointpos", name=f"{name}_position", joint=name)
            sensor.add("jointvel", name=f"{name}_velocity", joint=name)


def _mirrored(joint: str) -> tuple[str, str, float]:
    """(joint, its mirror image, sign): roll and yaw change sign under reflection in the sagittal plane."""
    side, _, rest = joint.partition("_")
    image = {"left": f"right_{rest}", "right": f"left_{rest}"}.get(side, joint)
    return (joint, image, 1.0 if joint.endswith("pitch") else -1.0)


def build(
    body: BodyParameters,
    contact: ContactParameters,
    simulation: SimulationParameters,
    *,
    cache: Path | None = None,
) -> BodyModel:
    """Build the human for a stature, a mass, a floor and a time step.

    Args:
        body: ``height`` [m] and ``mass`` [kg].
        contact: stiffness and friction of the soles on the floor.
        simulation: ``time_step`` [s] and ``integrator``.
        cache: folder that keeps built bodies by their inputs; None keeps nothing.

    Returns:
        MJCF text and description. At ``q = 0`` the body stands upright with hanging arms, its hips at x = 0
        and its soles on the floor.
    """
    if cache is None:
        return _Builder(body, contact, simulation).build()
    digest = hashlib.sha256(repr((body, contact, simulation, metadata.version("dm_control"))).encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    key = digest.hexdigest()[:24]
    kept = cache / f"body-{key}.json"
    adapter = TypeAdapter(tuple[str, BodyModel])
    # A file that is not there, is damaged or of another body is written again; where none can be written the
    # body is built.
    with contextlib.suppress(OSError, ValueError):
        own, model = adapter.validate_json(kept.read_bytes())
        if own == key:
            return model
    model = _Builder(body, contact, simulation).build()
    with contextlib.suppress(OSError):
        partial = kept.with_suffix(f".{os.getpid()}")
        partial.write_bytes(adapter.dump_json((key, model)))
        partial.replace(kept)  # renamed, so that readers see whole files only
    return model

"""Derive ``models/human.xml``, the human at 1.70 m and 60 kg, from published tables.

    python docs/human.py

Sources:
    DE_LEVA: P. de Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters", J. Biomech.
        29(9), 1996, table 4, males (stature 1.741 m, mass 73.0 kg).
    WINTER: D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed., Wiley 2009, figure 4.1
        (after Drillis & Contini 1966).
    BELL: A. L. Bell, D. R. Pedersen, R. A. Brand, "A comparison of the accuracy of several hip center
        location prediction methods", J. Biomech. 23(6), 1990.
    DELP: S. L. Delp et al., "An interactive graphics-based model of the lower extremity to study orthopaedic
        surgical procedures", IEEE Trans. Biomed. Eng. 37(8), 1990 (as distributed with OpenSim: talus 0.1 kg,
        calcaneus 1.25 kg, toes 0.2166 kg).
    AAOS: W. B. Greene, J. D. Heckman (eds.), "The Clinical Measurement of Joint Motion", American Academy of
        Orthopaedic Surgeons, 1994.
    ANDERSON: D. E. Anderson, M. L. Madigan, M. A. Nussbaum, "Maximum voluntary joint torque as a function of
        joint angle and angular velocity", J. Biomech. 40(14), 2007, table 3, men of 18 to 25 years.
The sources of the remaining ranges and torques are in docs/data.
"""

from dataclasses import dataclass, replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ampm.parameters import GRAVITY
from models import scene
from models.human import ANKLE_HEIGHT, FILE, HIP_HALF_WIDTH, HIP_HEIGHT, MASS, STATURE, sole_geometry
from models.scene import Inertial, add

DE_LEVA_STATURE = 1.741
"""Mean stature of the men measured in DE_LEVA [m]."""


@dataclass(frozen=True)
class Row:
    """One row of DE_LEVA, table 4 (males)."""

    mass: float  # share of the body's mass [1]
    length: float  # distance of the two endpoints, as a share of stature [1]
    com: float  # distance of the COM from the first endpoint, as a share of the length [1]
    radii: tuple[float, float, float]  # of gyration about sagittal, transverse, long axis, shares of length


def _row(mass: float, length: float, com: float, radii: tuple[float, float, float]) -> Row:
    """A row as printed: mass, com and radii in per cent, length in mm."""
    sagittal, transverse, longitudinal = (radius / 100.0 for radius in radii)
    length = length / 1000.0 / DE_LEVA_STATURE
    return Row(mass / 100.0, length, com / 100.0, (sagittal, transverse, longitudinal))


HEAD = _row(6.94, 242.9, 50.02, (30.3, 31.5, 26.1))
"""Vertex to cervicale."""
UPPER_TRUNK = _row(15.96, 242.1, 50.66, (50.5, 32.0, 46.5))
"""Cervicale to xiphion."""
MIDDLE_TRUNK = _row(16.33, 215.5, 45.02, (48.2, 38.3, 46.8))
"""Xiphion to omphalion."""
LOWER_TRUNK = _row(11.17, 145.7, 61.15, (61.5, 55.1, 58.7))
"""Omphalion to the middle of the hip centres."""
UPPER_ARM = _row(2.71, 281.7, 57.72, (28.5, 26.9, 15.8))
"""Shoulder to elbow centre."""
FOREARM = _row(1.62, 268.9, 45.74, (27.6, 26.5, 12.1))
"""Elbow to wrist centre."""
HAND = _row(0.61, 86.2, 79.00, (62.8, 51.3, 40.1))
"""Wrist centre to the third knuckle."""
THIGH = _row(14.16, 422.2, 40.95, (32.9, 32.9, 14.9))
"""Hip to knee centre."""
SHANK = _row(4.33, 440.3, 43.95, (25.1, 24.6, 10.2))
"""Knee to ankle centre."""
FOOT = _row(1.37, 258.1, 44.15, (25.7, 24.5, 12.4))
"""Heel to tip of the longest toe; the longitudinal axis points forward, the sagittal one upward."""
TOTAL_MASS_SHARE = (
    HEAD.mass
    + UPPER_TRUNK.mass
    + MIDDLE_TRUNK.mass
    + LOWER_TRUNK.mass
    + 2.0 * (UPPER_ARM.mass + FOREARM.mass + HAND.mass + THIGH.mass + SHANK.mass + FOOT.mass)
)
"""Sum of all rows, limbs twice [1]."""

# Lengths as shares of stature, beside those of models/human.py. WINTER where the leg and the foot are
# concerned, because his leg adds up to a height of the hip over the floor; DE_LEVA's trunk and head are then
# scaled so that the vertex is at stature.
KNEE_HEIGHT = 0.285
"""WINTER."""
SHOULDER_HEIGHT = 0.818
"""WINTER."""
SHOULDER_HALF_WIDTH = 0.129
"""WINTER."""
TOE_MASS_SHARE = 0.2166 / (0.1 + 1.25 + 0.2166)
"""Share of the foot's mass in front of the toe axis (DELP)."""
TOE_THICKNESS = 0.012
"""Thickness of the toes, as a share of stature."""
FOOT_COM_HEIGHT = 0.45
"""Height of the foot's centre of mass over the sole, as a share of the ankle's height (a wedge)."""

JOINTS: dict[str, tuple[float, float, float]] = {
    # Flexion of hip, shoulder and elbow is negative about +y, of knee and trunk positive; ankle and toe: + is
    # plantar flexion. Left side for roll and yaw: abduction, eversion and outward rotation are positive.
    "waist_yaw": (-0.6, 0.6, 0.10),
    "waist_roll": (-0.5, 0.5, 0.16),
    "waist_pitch": (-0.6, 0.8, 0.22),
    "chest_yaw": (-0.6, 0.6, 0.10),
    "chest_roll": (-0.6, 0.6, 0.14),
    "chest_pitch": (-0.5, 0.6, 0.20),
    "hip_pitch": (-2.10, 0.52, 0.161),
    "hip_roll": (-0.52, 0.79, 0.105),
    "hip_yaw": (-0.79, 0.79, 0.06),
    "knee_pitch": (0.0, 2.40, 0.163),
    "ankle_pitch": (-0.80, 0.87, 0.139),
    "ankle_roll": (-0.61, 0.35, 0.035),
    "toe_pitch": (-1.22, 0.79, 0.04),
    "shoulder_pitch": (-3.14, 1.05, 0.07),
    "shoulder_roll": (-0.52, 3.14, 0.06),
    "shoulder_yaw": (-1.22, 1.57, 0.035),
    "elbow_pitch": (-2.62, 0.17, 0.06),
    "elbow_yaw": (-1.40, 1.40, 0.010),
    "wrist_pitch": (-0.35, 0.58, 0.012),
    "wrist_roll": (-1.27, 1.24, 0.012),
}
"""Least and largest angle [rad] and largest torque as a share of weight times stature [1] of each hinge; the
ranges of a right limb are mirrored. Sources, joint by joint: docs/body.md."""

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


def _joint(name: str) -> tuple[tuple[float, float], float]:
    """Range [rad] and share of torque [1] of a hinge; a right limb's roll and yaw are mirrored."""
    side, _, rest = name.partition("_")
    low, high, torque = JOINTS[rest if side in scene.SIDES else name]
    if side == "right" and not rest.endswith("pitch"):
        low, high = 0.0 - high, 0.0 - low
    return (low, high), torque


class Builder:
    """Writes the segments of a human, trunk first, then legs, then arms."""

    def __init__(self) -> None:
        self.height, self.mass = STATURE, MASS
        # The table adds up to 100.00 %; dividing by the sum keeps the total exact whatever is edited there.
        self.table_mass = self.mass / TOTAL_MASS_SHARE
        self.sole = sole_geometry(self.height)
        self.model = Element("mujoco", model="human")
        self.pelvis = add(add(self.model, "worldbody"), "body", name="pelvis")

    def _inertial(self, row: Row, length: float, com: Vector) -> Inertial:
        """Inertial of a table row for a segment of a length [m] with its COM [m]; z is the long axis."""
        mass = row.mass * self.table_mass
        radii = np.array(row.radii) * length
        return Inertial(mass, np.array(com), mass * np.diag(np.square(radii)))

    def _segment(self, on: Element, name: str, pos: Any, inertial: Inertial) -> Element:
        return scene.set_inertial(add(on, "body", name=name), pos, inertial)

    def _limb(self, on: Element, name: str, pos: Any, row: Row, length: float) -> Element:
        """Add a segment of one table row, which runs downward from its origin."""
        return self._segment(on, name, pos, self._inertial(row, length, (0, 0, -row.com * length)))

    def _hinges(self, body: Element, prefix: str, kinds: tuple[str, ...]) -> None:
        for kind in kinds:
            name = f"{prefix}_{kind}"
            add(body, "joint", name=name, type="hinge", axis=_AXES[kind], range=_joint(name)[0])

    def _capsule(self, body: Element, start: Vector, end: Vector, radius: float, rgba: Colour) -> None:
        add(body, "geom", type="capsule", fromto=(*start, *end), size=radius, rgba=rgba)

    def _ellipsoid(self, body: Element, pos: Any, size: Vector, rgba: Colour) -> None:
        add(body, "geom", type="ellipsoid", pos=pos, size=size, rgba=rgba)

    def build(self) -> str:
        """At ``q = 0`` it stands upright with hanging arms, its hips at x = 0 and its soles on the floor."""
        self._trunk()
        for side in scene.SIDES:
            self._leg(side)
        for side in scene.SIDES:
            self._arm(side)
        actuator = add(self.model, "actuator")
        for joint in self.model.iter("joint"):
            name = joint.get("name", "")
            limit = _joint(name)[1] * self.mass * GRAVITY * self.height
            add(actuator, "motor", joint=name, ctrlrange=(-limit, limit))
        return scene.to_xml(self.model)

    def _trunk(self) -> None:
        h = self.height
        # De Leva's trunk, set upon Winter's hip, would make the body 1.6 % too tall.
        rows = (HEAD, UPPER_TRUNK, MIDDLE_TRUNK, LOWER_TRUNK)
        scale = (1.0 - HIP_HEIGHT) / sum(row.length for row in rows) * h
        head, upper, middle, lower = (row.length * scale for row in rows)

        def upward(row: Row, length: float) -> Inertial:
            """Rows run downward, but the frames of the trunk are at the lower end."""
            return self._inertial(row, length, (0, 0, (1 - row.com) * length))

        pelvis = scene.set_inertial(self.pelvis, (0, 0, HIP_HEIGHT * h), upward(LOWER_TRUNK, lower))
        self._ellipsoid(pelvis, (0, 0, 0.035 * h), (0.068 * h, 0.099 * h, 0.062 * h), _TROUSERS)

        abdomen = self._segment(pelvis, "abdomen", (0, 0, lower), upward(MIDDLE_TRUNK, middle))
        self._hinges(abdomen, "waist", _TRUNK_JOINTS)
        self._ellipsoid(abdomen, (0, 0, 0.45 * middle), (0.062 * h, 0.088 * h, 0.105 * h), _SHIRT)

        skull = self._inertial(HEAD, head, (0, 0, upper + (1 - HEAD.com) * head))
        both = upward(UPPER_TRUNK, upper).plus(skull)
        thorax = self._segment(abdomen, "thorax", (0, 0, middle), both)
        self._hinges(thorax, "chest", _TRUNK_JOINTS)
        self._ellipsoid(thorax, (0, 0, 0.40 * upper), (0.068 * h, 0.102 * h, 0.112 * h), _SHIRT)
        shoulder_z = SHOULDER_HEIGHT * h - HIP_HEIGHT * h - lower - middle
        half = SHOULDER_HALF_WIDTH * h
        self._capsule(thorax, (0, -0.82 * half, shoulder_z), (0, 0.82 * half, shoulder_z), 0.031 * h, _SHIRT)
        self._capsule(thorax, (0, 0, shoulder_z), (0.004 * h, 0, upper + 0.15 * head), 0.030 * h, _SKIN)
        self._ellipsoid(
            thorax, (0.012 * h, 0, upper + 0.53 * head), (0.054 * h, 0.045 * h, 0.47 * head), _SKIN
        )
        nose = (0.064 * h, 0, upper + 0.46 * head)
        self._ellipsoid(thorax, nose, (0.010 * h, 0.007 * h, 0.013 * h), _SKIN)
        add(thorax, "site", name="imu", pos=(0, 0, 0.5 * upper))
        self.thorax, self.shoulder_z = thorax, shoulder_z

    def _leg(self, side: str) -> None:
        h, sole = self.height, self.sole
        sign = 1.0 if side == "left" else -1.0
        thigh_length = (HIP_HEIGHT - KNEE_HEIGHT) * h
        shank_length = (KNEE_HEIGHT - ANKLE_HEIGHT) * h
        rgba = _LEFT_SHADE if side == "left" else _TROUSERS

        socket = (0, sign * HIP_HALF_WIDTH * h, 0)
        thigh = self._limb(self.pelvis, f"{side}_thigh", socket, THIGH, thigh_length)
        self._hinges(thigh, f"{side}_hip", _BALL_JOINTS)
        self._capsule(thigh, (0, 0, 0), (0, 0, -thigh_length), 0.035 * h, rgba)
        self._ellipsoid(
            thigh, (0, 0, -0.36 * thigh_length), (0.051 * h, 0.044 * h, 0.46 * thigh_length), rgba
        )

        shank = self._limb(thigh, f"{side}_shank", (0, 0, -thigh_length), SHANK, shank_length)
        self._hinges(shank, f"{side}_knee", ("pitch",))
        self._capsule(shank, (0, 0, 0), (0, 0, -0.97 * shank_length), 0.023 * h, rgba)
        belly = (-0.010 * h, 0, -0.30 * shank_length)
        self._ellipsoid(shank, belly, (0.034 * h, 0.033 * h, 0.32 * shank_length), rgba)

        to_ankle = np.array([sole.ankle_x, 0.0, sole.ankle_height])  # of the foot's frame, in the sole frame
        to_toe = np.array([sole.ball_x, 0.0, 0.0])
        foot_inertial, toe_inertial = self._foot_inertials()
        foot = self._segment(shank, f"{side}_foot", (0, 0, -shank_length), _moved(foot_inertial, to_ankle))
        self._hinges(foot, f"{side}_ankle", ("pitch", "roll"))
        add(foot, "site", name=f"{side}_sole", pos=-to_ankle)
        back, front = sole.heel_x - 0.004 * h, sole.ball_x
        thickness = TOE_THICKNESS * h
        pos = np.array([0.5 * (back + front), 0, 0.5 * thickness + 0.001]) - to_ankle
        size = (0.5 * (front - back), 0.9 * sole.ball_half_width, 0.5 * thickness)
        add(foot, "geom", type="box", pos=pos, size=size, rgba=_SHOE)
        pos = np.array([0.35 * front + 0.65 * back, 0, 0.55 * sole.ankle_height]) - to_ankle
        size = (0.46 * (front - back), 0.8 * sole.ball_half_width, 0.46 * sole.ankle_height)
        self._ellipsoid(foot, pos, size, _SHOE)

        toe = self._segment(foot, f"{side}_toe", to_toe - to_ankle, _moved(toe_inertial, to_toe))
        self._hinges(toe, f"{side}_toe", ("pitch",))
        add(toe, "site", name=f"{side}_toe_axis")
        length = sole.tip_x - sole.ball_x + 0.003 * h
        size = (0.5 * length, 0.9 * sole.ball_half_width, 0.5 * thickness)
        pos = (0.5 * length, 0, 0.5 * thickness + 0.001)
        add(toe, "geom", type="box", pos=pos, size=size, rgba=_TOE_CAP)

    def _foot_inertials(self) -> tuple[Inertial, Inertial]:
        """Inertials of foot and toes in the sole frame.

        The toes are a homogeneous box in front of the toe axis with DELP's share of the mass; the rest is cut
        so that both together have exactly the mass, centre of mass and inertia of DE_LEVA's foot.
        """
        h, sole = self.height, self.sole
        com = (sole.heel_x + FOOT.com * sole.length, 0, FOOT_COM_HEIGHT * sole.ankle_height)
        # The row's longitudinal axis points forward, the sagittal one upward.
        row = replace(FOOT, radii=FOOT.radii[::-1])
        whole = self._inertial(row, sole.length, com)
        x, y, z = sole.tip_x - sole.ball_x, 2.0 * sole.tip_half_width, TOE_THICKNESS * h
        mass = TOE_MASS_SHARE * whole.mass
        box = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
        toes = Inertial(mass, np.array([0.5 * (sole.ball_x + sole.tip_x), 0, 0.5 * z]), box)
        return whole.plus(Inertial(-toes.mass, toes.com, -toes.inertia)), toes

    def _arm(self, side: str) -> None:
        h = self.height
        sign = 1.0 if side == "left" else -1.0
        upper_length, fore_length = UPPER_ARM.length * h, FOREARM.length * h
        hand_length = HAND.length * h
        shoulder = (0, sign * SHOULDER_HALF_WIDTH * h, self.shoulder_z)
        upper = self._limb(self.thorax, f"{side}_upper_arm", shoulder, UPPER_ARM, upper_length)
        self._hinges(upper, f"{side}_shoulder", _BALL_JOINTS)
        self._capsule(upper, (0, 0, -0.3 * upper_length), (0, 0, -upper_length), 0.023 * h, _SKIN)
        self._ellipsoid(
            upper, (0, 0, -0.26 * upper_length), (0.034 * h, 0.032 * h, 0.40 * upper_length), _SHIRT
        )
        fore = self._limb(upper, f"{side}_forearm", (0, 0, -upper_length), FOREARM, fore_length)
        self._hinges(fore, f"{side}_elbow", ("pitch", "yaw"))
        self._capsule(fore, (0, 0, 0), (0, 0, -0.98 * fore_length), 0.017 * h, _SKIN)
        self._ellipsoid(fore, (0, 0, -0.28 * fore_length), (0.025 * h, 0.024 * h, 0.34 * fore_length), _SKIN)
        # The row's radii belong to a hand whose palm faces forward; here it faces the thigh, so the fore-aft
        # and left-right radii change places.
        sagittal, transverse, longitudinal = HAND.radii
        hand_row = replace(HAND, radii=(transverse, sagittal, longitudinal))
        hand = self._limb(fore, f"{side}_hand", (0, 0, -fore_length), hand_row, hand_length)
        self._hinges(hand, f"{side}_wrist", ("pitch", "roll"))
        self._ellipsoid(hand, (0, 0, -0.9 * hand_length), (0.024 * h, 0.009 * h, 0.054 * h), _SKIN)


def _moved(inertial: Inertial, point: np.ndarray) -> Inertial:
    """The same in a frame with its origin at a point, shape (3,) [m]."""
    return replace(inertial, com=inertial.com - point)


if __name__ == "__main__":
    FILE.write_text(Builder().build(), encoding="utf-8")

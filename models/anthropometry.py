"""Anthropometric tables: masses, lengths, mass distribution, joint ranges and strength of an adult.

All numbers that describe a human are in this file, with their sources.

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
The sources of the remaining ranges and torques are in docs/body.md.
"""

from dataclasses import dataclass

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

# Lengths as shares of stature. WINTER where the leg and the foot are concerned, because his leg adds up to a
# height of the hip over the floor; DE_LEVA's trunk and head are then scaled so that the vertex is at stature.
HIP_HEIGHT = 0.530
"""WINTER."""
COM_OVER_HIP = 0.037
"""Of the body standing straight: 0.567, from the rows above, less ``HIP_HEIGHT``."""
KNEE_HEIGHT = 0.285
"""WINTER."""
ANKLE_HEIGHT = 0.039
"""WINTER."""
SHOULDER_HEIGHT = 0.818
"""WINTER."""
SHOULDER_HALF_WIDTH = 0.129
"""WINTER."""
HIP_HALF_WIDTH = 0.050
"""BELL: hip centres lie 14 % of the breadth between the spines (.139 of stature) inside of them."""

# The sole, from the reference point, as shares of stature; foot length .152 (WINTER), ball at 74 % of it,
# ankle at 25 %. The reference point lies a little in front of the middle between heel and ball.
SOLE = {
    "heel_x": -0.100 / 1.70,
    "ball_x": 0.090 / 1.70,
    "tip_x": 0.158 / 1.70,
    "heel_half_width": 0.028 / 1.70,
    "ball_half_width": 0.040 / 1.70,
    "tip_half_width": 0.032 / 1.70,
    "ankle_x": -0.035 / 1.70,
    "ankle_height": ANKLE_HEIGHT,
}
"""Foot breadth .055 of stature (WINTER), less the soft rim that carries no load."""

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

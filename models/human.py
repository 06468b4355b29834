"""The 40-dof human of the paper: 17 segments, 34 hinges and a free root, for any stature and mass.

``human.xml`` has it at 1.70 m and 60 kg, as ``docs/human.py`` derives it from published tables. Lengths
scale with stature, masses with mass, inertias with mass times stature squared, torques with mass times
stature. Every segment has an explicit inertial; visual geometry has neither mass nor contact. Only the twelve
points under the soles have contact, and only with the floor.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ampm.description import BodyDescription, LegDescription, SoleGeometry
from ampm.parameters import RunParameters
from models import scene
from models.scene import BodyModel

FILE = Path(__file__).with_name("human.xml")
STATURE, MASS = 1.70, 60.0
"""Stature and mass of the human in the file [m, kg]."""
HIP_HEIGHT = 0.530
"""Height of the hips as a share of stature (Winter 2009), as the following."""
COM_OVER_HIP = 0.037
"""Of the COM of the body standing straight: 0.567, by de Leva's masses, less ``HIP_HEIGHT``."""
ANKLE_HEIGHT = 0.039
HIP_HALF_WIDTH = 0.050
"""Half the distance of the hip centres (Bell et al. 1990): they lie 14 % of the breadth between the spines
(.139 of stature) inside of them."""
# Foot length .152 (Winter), ball at 74 % of it, ankle at 25 %; breadth .055, less the soft rim that carries
# no load. The reference point lies a little in front of the middle between heel and ball.
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
"""The sole from the reference point, as shares of stature."""
_POWERS = {
    **dict.fromkeys(("pos", "size", "fromto"), (1, 0)),
    **dict.fromkeys(("diaginertia", "fullinertia"), (2, 1)),
    "mass": (0, 1),
    "ctrlrange": (1, 1),
}
"""Powers of stature and mass with which attributes of the file scale."""


def sole_geometry(height: float) -> SoleGeometry:
    """Outline of the sole of a body of stature ``height`` [m]."""
    return SoleGeometry(**{name: share * height for name, share in SOLE.items()})


def build_human(run: RunParameters) -> BodyModel:
    """Build the human of a run's height and mass; at ``q = 0`` it stands with hanging arms, hips at x = 0."""
    height, mass, sole = run.body.height, run.body.mass, sole_geometry(run.body.height)
    human = ElementTree.parse(FILE).getroot()
    for element in human.iter():
        for key in _POWERS.keys() & element.attrib.keys():
            length, weight = _POWERS[key]
            factor = (height / STATURE) ** length * (mass / MASS) ** weight
            element.set(key, scene.text(factor * np.array(element.attrib[key].split(), dtype=float)))
    model, root = scene.new_scene("human", "pelvis", height, run)
    (pelvis,) = human.iterfind("worldbody/body")
    root.set("pos", pelvis.attrib["pos"])
    root.extend(pelvis)
    segments = {segment.get("name"): segment for segment in root.iter("body")}
    limits = tuple((m.attrib["joint"], float(m.attrib["ctrlrange"].split()[1])) for m in human.iter("motor"))
    scene.add_motors(model, limits)
    names = [name for name, _ in limits]

    def joints(*groups: str) -> tuple[str, ...]:
        return tuple(name for name in names if name.rpartition("_")[0] in groups)

    def leg(side: str) -> LegDescription:
        foot, toe = segments[f"{side}_foot"], segments[f"{side}_toe"]
        ankle, ball = np.array([sole.ankle_x, 0.0, sole.ankle_height]), np.array([sole.ball_x, 0.0, 0.0])
        return LegDescription(
            hip=joints(f"{side}_hip"),
            knee=f"{side}_knee_pitch",
            ankle=joints(f"{side}_ankle"),
            toe=f"{side}_toe_pitch",
            foot_segment=f"{side}_foot",
            toe_segment=f"{side}_toe",
            sole_frame=f"{side}_sole",
            sole_points=scene.add_sole_points(side, sole, [(foot, -ankle), (foot, -ankle), (toe, -ball)]),
        )

    left_leg, right_leg = map(leg, scene.SIDES)
    left_arm, right_arm = (
        joints(*(f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist"))) for side in scene.SIDES
    )
    description = BodyDescription(
        height=height,
        mass=mass,
        root_segment="pelvis",
        trunk_segment="thorax",
        left_leg=left_leg,
        right_leg=right_leg,
        trunk=joints("waist", "chest"),
        left_arm=left_arm,
        right_arm=right_arm,
        head=(),
        sole=sole,
        hip_height=HIP_HEIGHT * height,
        hip_half_width=HIP_HALF_WIDTH * height,
        leg_length=(HIP_HEIGHT - ANKLE_HEIGHT) * height,
        com_over_hip=COM_OVER_HIP * height,
        mirror=tuple(map(_mirrored, names)),
        torque_limits=limits,
        spread=(("left_shoulder_roll", 1.0), ("right_shoulder_roll", -1.0)),
    )
    return BodyModel(scene.to_xml(model), description)


def _mirrored(joint: str) -> tuple[str, str, float]:
    """(joint, its mirror image, sign): roll and yaw change sign under reflection in the sagittal plane."""
    side, _, rest = joint.partition("_")
    image = {"left": f"right_{rest}", "right": f"left_{rest}"}.get(side, joint)
    return (joint, image, 1.0 if joint.endswith("pitch") else -1.0)

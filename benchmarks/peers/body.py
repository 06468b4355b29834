"""Body and reference motion for inverse kinematics and dynamics by other libraries, and ours at the same."""

from typing import Any
from xml.etree import ElementTree as xml

import numpy as np
import pinocchio as pin

from ampm.body.robot import Robot
from ampm.description import SOLE_POINT_GROUPS
from ampm.geometry import Array
from validation.trial.plan import PlannedWalk

_TIP = SOLE_POINT_GROUPS.index("tip")
_AXES = {"JointModelRX": "1 0 0", "JointModelRY": "0 1 0", "JointModelRZ": "0 0 1"}


def urdf_of(robot: Robot) -> str:
    """The body as a URDF: one link per hinge, and one without mass for trunk, soles and the
    middles of their corners.

    Raises:
        ValueError: a joint is no hinge about an axis of its frame.
    """
    model, root = robot.model, xml.Element("robot", name="body")
    largest = {"lower": model.lowerPositionLimit, "upper": model.upperPositionLimit}
    for i in range(1, model.njoints):
        _link(root, model.names[i], model.inertias[i])
        if i == 1:
            continue
        joint = _joint(
            root, model.names[i], "revolute", model.names[model.parents[i]], model.jointPlacements[i]
        )
        kind = model.joints[i].shortname()
        if kind not in _AXES:
            raise ValueError(f"joint {model.names[i]} is a {kind}, not one of {', '.join(_AXES)}")
        xml.SubElement(joint, "axis", xyz=_AXES[kind])
        v, q = model.joints[i].idx_v, model.joints[i].idx_q
        ends = {name: repr(float(values[q])) for name, values in largest.items()}
        xml.SubElement(joint, "limit", ends, effort=repr(float(model.effortLimit[v])), velocity="1000")
    frames = [model.frames[number] for number in (*robot.sole_frames, robot.trunk_frame)]
    places = [(frame.name, frame.parentJoint, frame.placement) for frame in frames]
    for (name, joint, placement), corners in zip(places[:2], sole_corners(robot), strict=True):
        middle = pin.SE3(np.eye(3), corners.mean(axis=0))
        places.append((f"{name}_centre", joint, placement * middle))
    for name, parent, placement in places:
        _link(root, name, None)
        _joint(root, name, "fixed", model.names[parent], placement)
    return xml.tostring(root, encoding="unicode")


def sole_corners(robot: Robot) -> Array:
    """Points of heel and ball from the reference point of each sole, in its axes, shape (2, 4, 3) [m]."""
    frames, corners = robot.model.frames, []
    points = list(zip(robot.point_frames, robot.point_foot, robot.point_group, strict=True))
    for foot, sole in enumerate(robot.sole_frames):
        back = frames[sole].placement.inverse()
        flat = [point for point, of, group in points if of == foot and group < _TIP]
        corners.append([(back * frames[point].placement).translation for point in flat])
    return np.array(corners)


def _link(root: Any, name: str, inertia: Any) -> None:
    link = xml.SubElement(root, "link", name=f"{name}_link" if inertia else name)
    if inertia and inertia.mass > 0.0:
        mass = xml.SubElement(link, "inertial")
        xml.SubElement(mass, "origin", xyz=_text(inertia.lever), rpy="0 0 0")
        xml.SubElement(mass, "mass", value=repr(float(inertia.mass)))
        names = {(0, 0): "ixx", (0, 1): "ixy", (0, 2): "ixz", (1, 1): "iyy", (1, 2): "iyz", (2, 2): "izz"}
        xml.SubElement(
            mass, "inertia", {name: repr(float(inertia.inertia[at])) for at, name in names.items()}
        )


def _joint(root: Any, name: str, kind: str, parent: str, placement: Any) -> Any:
    fixed = kind == "fixed"
    joint = xml.SubElement(root, "joint", name=f"{name}_joint" if fixed else name, type=kind)
    rpy = _text(pin.rpy.matrixToRpy(placement.rotation))
    xml.SubElement(joint, "origin", xyz=_text(placement.translation), rpy=rpy)
    xml.SubElement(joint, "parent", link=f"{parent}_link")
    xml.SubElement(joint, "child", link=name if fixed else f"{name}_link")
    return joint


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def references(walk: PlannedWalk, time_step: float) -> dict[str, Any]:
    """What the libraries follow: the plan's targets of one stride, and the body as URDF and MJCF.

    Arrays: com (T, 3), place (T, 2, 3), turn (T, 2, 3, 3) of both soles, trunk (T, 3, 3); q (nq,) before the
    first tick.
    """
    robot, duration = walk.body.robot, walk.plan.contacts.step_ends[1]
    times = np.arange(0.0, duration, time_step)
    plan = walk.plan.table(times)
    return {
        "urdf": urdf_of(robot),
        "mjcf": walk.body.model.xml,
        "hinges": np.array(robot.joint_names),
        "soles": np.array([robot.model.frames[frame].name for frame in robot.sole_frames]),
        "trunk_frame": robot.model.frames[robot.trunk_frame].name,
        "time_step": time_step,
        "q": plan.posture.q[0],
        "com": plan.com[1:],
        "place": plan.feet.position[1:],
        "turn": plan.feet.rotation[1:],
        "trunk": plan.posture.trunk[1:],
    }


def errors(robot: Robot, targets: dict[str, Any], q: Array) -> tuple[float, float, float]:
    """Largest distances of COM and soles [m], and rotation of the soles [rad], from their targets."""
    com, place, turn = 0.0, 0.0, 0.0
    for k, configuration in enumerate(q):
        terms = robot.jacobian(configuration)
        com = max(com, float(np.linalg.norm(terms.com - targets["com"][k])))
        place = max(place, float(np.linalg.norm(terms.sole - targets["place"][k], axis=1).max()))
        rotations = np.einsum("fij,fik->fjk", terms.sole_turn, targets["turn"][k])
        turn = max(turn, *(float(np.linalg.norm(pin.log3(rotation))) for rotation in rotations))
    return com, place, turn

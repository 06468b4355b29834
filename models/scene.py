"""What every body is built into: floor, contact, sole points, motors and sensors, written as MJCF."""

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

import mujoco
import numpy as np

from ampm.description import SOLE_POINT_GROUPS, BodyDescription, SoleGeometry
from ampm.geometry import Array
from ampm.parameters import ContactParameters, SimulationParameters

GRAVITY = 9.81
"""Gravity [m/s^2], as in the paper."""
SOLE_POINT_RADIUS = 0.00001
"""Radius of the spheres that touch the floor [m]."""

# Twelve digits: legible, the same text on every platform, and 1e-11 kg at most in the total mass.
_DIGITS = 12
_SCENE = Path(__file__).with_name("scene.xml")
"""MJCF without a body; words in braces differ from run to run."""


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
        """Return the compiled MuJoCo model; every call a copy of its own."""
        return copy.copy(_compiled(self.xml))


@lru_cache(maxsize=4)
def _compiled(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


def new_scene(
    name: str, height: float, contact: ContactParameters, simulation: SimulationParameters
) -> Element:
    """A model with options, floor and the class of touching points, but without a body.

    Args:
        name: of the model.
        height: of the body, for the camera [m].
        contact: stiffness and friction of the soles on the floor.
        simulation: ``time_step`` [s] and ``integrator``.
    """
    impedance = contact.impedance_min, contact.impedance_max, contact.impedance_width
    return fromstring(
        _SCENE.read_text(encoding="utf-8").format(
            name=name, time_step=_text(simulation.time_step), integrator=simulation.integrator,
            gravity=GRAVITY, impratio=_text(contact.impratio), middle=_text(0.5 * height),
            friction=_text(contact.friction), impedance=_text(impedance),
            stiffness=_text((contact.time_constant, contact.damping_ratio)),
        )
    )  # fmt: skip


def add(parent: Element, tag: str, **attributes: Any) -> Element:
    """A new element of MJCF.

    Args:
        parent: of the element.
        tag: its name.
        attributes: texts, truths, numbers or vectors of numbers; ``class_`` is ``class``.
    """
    return SubElement(parent, tag, {key.rstrip("_"): _text(value) for key, value in attributes.items()})


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return str(value).lower()
    return " ".join(f"{number:.{_DIGITS}g}" for number in np.atleast_1d(value))


def add_segment(parent: Element, name: str, pos: Any, mass: float, com: Array, inertia: Array) -> Element:
    """A body with its mass [kg], its COM [m] and its inertia about that, (3, 3) [kg m^2]."""
    body = add(parent, "body", name=name, pos=pos)
    values: dict[str, Any] = {"mass": mass, "pos": com}
    i = inertia
    if np.abs(i - np.diag(np.diag(i))).max() > 0.0:
        values["fullinertia"] = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    else:
        values["diaginertia"] = np.diag(i)
    add(body, "inertial", **values)
    return body


def add_root(body: Element) -> None:
    """Make a body the free root, and let light and cameras follow it."""
    add(body, "freejoint", name="root")
    # A light that follows the body: a fixed one casts grainy shadows on a large floor.
    add(
        body, "light", name="lamp", mode="trackcom", pos=(1.2, -1.6, 3.2), dir=(-0.33, 0.42, -1), cutoff=75,
        exponent=0, castshadow=True, diffuse=(0.5, 0.5, 0.5), specular=(0.1, 0.1, 0.1),
    )  # fmt: skip
    for name, pos, xyaxes in (
        ("side", (0.0, -3.2, 0.1), (1, 0, 0, 0, 0.03, 1)),
        ("front", (3.2, 0.0, 0.1), (0, 1, 0, -0.03, 0, 1)),
        ("oblique", (2.3, -2.3, 0.5), (0.707, 0.707, 0, -0.13, 0.13, 1)),
    ):
        add(body, "camera", name=name, mode="trackcom", pos=pos, xyaxes=xyaxes)


def add_sole_points(
    side: str, sole: SoleGeometry, segments: Sequence[tuple[Element, Any]], quat: Any = None
) -> tuple[str, ...]:
    """Points that touch the floor, and their sites; their names.

    Args:
        side: of the foot.
        sole: its outline.
        segments: for heel, ball and, with toes, tip the body that has the points, and the place of the
            reference point in its axes, shape (3,) [m].
        quat: turn of the sole's axes to those of the body, None for none.
    """
    points = []
    for group, (body, origin) in zip(SOLE_POINT_GROUPS, segments, strict=False):
        x, half_width = getattr(sole, f"{group}_x"), getattr(sole, f"{group}_half_width")
        for edge, edge_sign in (("left", 1.0), ("right", -1.0)):
            name = f"{side}_{group}_{edge}"
            pos, up = np.array([x, edge_sign * half_width, 0.0]), np.array([0, 0, SOLE_POINT_RADIUS])
            if quat is not None:
                pos, up = _rotated(quat, pos), _rotated(quat, up)
            add(body, "site", name=name, pos=origin + pos)
            # The sphere stands on the site, so the point that touches the floor is the site.
            add(
                body, "geom", name=name, class_="contact", type="sphere", size=SOLE_POINT_RADIUS,
                pos=origin + pos + up, contype=0, conaffinity=1, rgba=(0.1, 0.1, 0.1, 1),
            )  # fmt: skip
            points.append(name)
    return tuple(points)


def _rotated(quat: Any, vector: Array) -> Array:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, np.asarray(quat, dtype=np.float64))
    return result


def joint_order(root: Element) -> list[str]:
    """Hinges in MuJoCo's joint order, which is depth first."""
    return [joint.get("name", "") for joint in root.iter("joint")]


def add_motors(root: Element, limits: Iterable[tuple[str, float]]) -> None:
    """A motor for every hinge, by its largest torque [N m]."""
    actuator = next(root.iter("actuator"))
    for name, limit in limits:
        both = (-limit, limit)
        add(
            actuator, "motor", name=name, joint=name, gear=1, ctrllimited=True, ctrlrange=both,
            forcelimited=True, forcerange=both,
        )  # fmt: skip


def add_sensors(root: Element, pelvis: str) -> None:
    """The sensors that a run reads: of the site ``imu``, of COM and angular momentum, of all hinges."""
    sensor = next(root.iter("sensor"))
    add(sensor, "accelerometer", name="imu_accelerometer", site="imu")
    add(sensor, "gyro", name="imu_gyro", site="imu")
    add(sensor, "framequat", name="imu_orientation", objtype="site", objname="imu")
    add(sensor, "subtreecom", name="com", body=pelvis)
    add(sensor, "subtreeangmom", name="angular_momentum", body=pelvis)
    for name in joint_order(root):
        add(sensor, "jointpos", name=f"{name}_position", joint=name)
        add(sensor, "jointvel", name=f"{name}_velocity", joint=name)


def to_xml(root: Element) -> str:
    """MJCF text of a model."""
    indent(root)
    return tostring(root, encoding="unicode") + "\n"

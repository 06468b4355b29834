"""What every body is built into: floor, contact, sole points and motors, written as MJCF."""

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
from ampm.parameters import GRAVITY, RunParameters

SIDES = ("left", "right")
ADDED_NAMES = frozenset(
    {"root", "imu", "universe", *(f"{side}_sole" for side in SIDES)}
    | {f"{side}_{group}_{edge}" for side in SIDES for group in SOLE_POINT_GROUPS for edge in SIDES}
)
"""Names of the joints and frames that are added to every body."""
_SOLE_POINT_RADIUS = 0.00001  # radius of the spheres that touch the floor [m]

# Twelve digits: legible, the same text on every platform, and 1e-11 kg at most in the total mass.
_DIGITS = 12
_SCENE = Path(__file__).with_name("scene.xml")
"""MJCF with a root segment that is empty; words in braces differ from run to run."""


@dataclass(frozen=True)
class Findings:
    """How far the source of a body is from its mirror image, and what it lacks."""

    place: float = 0.0  # largest distance of a joint from its mirrored image [m]
    com: float = 0.0  # the same of a segment's COM, times its share of the mass [m]
    mass: float = 0.0  # largest difference of two masses [kg]
    bare: tuple[int, ...] = ()  # numbers of segments without a shape
    unlike: tuple[str, ...] = ()  # values of right joints that were not those of the left

    @property
    def of_sides(self) -> str:
        """What right joints got from the left, a sentence; empty if they were alike."""
        return f"Right joints get the values of the left: {'; '.join(self.unlike)}." if self.unlike else ""


@dataclass(frozen=True)
class BodyModel:
    """A body ready to be simulated."""

    xml: str  # MJCF, complete in itself
    description: BodyDescription
    findings: Findings = Findings()

    def compile(self) -> mujoco.MjModel:
        """Return the compiled MuJoCo model; every call a copy of its own."""
        return copy.copy(_compiled(self.xml))


@lru_cache(maxsize=4)
def _compiled(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], COM in some frame, shape (3,) [m], and inertia about the COM, shape (3, 3) [kg m^2]."""

    mass: float
    com: Array
    inertia: Array

    def about(self, point: Array) -> Array:
        """Inertia about a point of the same frame, shape (3, 3) [kg m^2] (parallel axes)."""
        r = self.com - point
        return self.inertia + self.mass * ((r * r).sum() * np.eye(3) - np.outer(r, r))

    def plus(self, other: "Inertial") -> "Inertial":
        """Both bodies taken together."""
        mass = self.mass + other.mass
        com = (self.mass * self.com + other.mass * other.com) / mass
        return Inertial(mass, com, self.about(com) + other.about(com))


def new_scene(name: str, root: str, height: float, run: RunParameters) -> tuple[Element, Element]:
    """A model with options, floor, sensors, and an empty root segment that moves freely.

    Args:
        name: of the model.
        root: name of the root segment.
        height: of the body, for the camera [m].
        run: its ``contact``, and of ``simulation`` time step and integrator.

    Returns:
        The model and its root segment.
    """
    contact, simulation = run.contact, run.simulation
    model = fromstring(
        _SCENE.read_text(encoding="utf-8").format(
            name=name,
            time_step=text(simulation.time_step),
            integrator=simulation.integrator,
            gravity=GRAVITY,
            impratio=text(contact.impratio),
            middle=text(0.5 * height),
            friction=text(contact.friction),
            impedance=text((contact.impedance_min, contact.impedance_max, contact.impedance_width)),
            stiffness=text((contact.time_constant, contact.damping_ratio)),
            radius=_SOLE_POINT_RADIUS,
        )
    )
    segment = next(model.iter("body"))
    segment.set("name", root)
    for sensor in next(model.iter("sensor")):
        sensor.set("body", root)
    return model, segment


def add(parent: Element, tag: str, **attributes: Any) -> Element:
    """A new element of MJCF, with texts, numbers or vectors of numbers; ``class_`` is ``class``."""
    return SubElement(parent, tag, {key.rstrip("_"): text(value) for key, value in attributes.items()})


def text(value: Any) -> str:
    """Numbers or words of an attribute."""
    if isinstance(value, str):
        return value
    return " ".join(f"{number:.{_DIGITS}g}" for number in np.atleast_1d(value))


def set_inertial(segment: Element, pos: Any, inertial: Inertial) -> Element:
    """Give a segment its place in the axes of the one that it hangs on, shape (3,) [m], and its mass."""
    segment.set("pos", text(pos))
    values: dict[str, Any] = {"mass": inertial.mass, "pos": inertial.com}
    i = inertial.inertia
    if np.abs(i - np.diag(np.diag(i))).max() > 0.0:
        values["fullinertia"] = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    else:
        values["diaginertia"] = np.diag(i)
    add(segment, "inertial", **values)
    return segment


def add_sole_points(
    side: str, sole: SoleGeometry, segments: Sequence[tuple[Element, Any]], turn: Array | None = None
) -> tuple[str, ...]:
    """Points that touch the floor, and their sites; their names.

    Args:
        side: of the foot.
        sole: its outline.
        segments: for heel, ball and, with toes, tip the segment that has the points, and the place of the
            reference point in its axes, shape (3,) [m].
        turn: rotation of the sole to their axes, shape (3, 3); by default none.
    """
    points = []
    turn = np.eye(3) if turn is None else turn
    for group, (segment, origin) in zip(SOLE_POINT_GROUPS, segments, strict=False):
        x, half_width = getattr(sole, f"{group}_x"), getattr(sole, f"{group}_half_width")
        for edge, sign in (("left", 1.0), ("right", -1.0)):
            name = f"{side}_{group}_{edge}"
            pos = origin + turn @ np.array([x, sign * half_width, 0.0])
            centre = pos + turn @ np.array([0.0, 0.0, _SOLE_POINT_RADIUS])
            add(segment, "site", name=name, pos=pos)
            add(segment, "geom", name=name, class_="point", pos=centre)
            points.append(name)
    return tuple(points)


def quaternion(matrix: Array) -> Array:
    """Unit quaternion, w first, shape (4,), of a rotation matrix."""
    result = np.zeros(4)
    mujoco.mju_mat2Quat(result, np.ascontiguousarray(matrix).ravel())
    return result


def add_motors(model: Element, limits: Iterable[tuple[str, float]]) -> None:
    """A motor for every hinge, by its largest torque [N m]."""
    actuator = next(model.iter("actuator"))
    for name, limit in limits:
        add(actuator, "motor", name=name, joint=name, ctrlrange=(-limit, limit), forcerange=(-limit, limit))


def to_xml(model: Element) -> str:
    """MJCF text of a model."""
    indent(model)
    return tostring(model, encoding="unicode") + "\n"

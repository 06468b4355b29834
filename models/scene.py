"""What every body is built into: floor, contact, sole points, motors and sensors, written with PyMJCF."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ampm.description import SOLE_POINT_GROUPS, BodyDescription, SoleGeometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import ContactParameters, SimulationParameters

    Array = NDArray[np.float64]

GRAVITY = 9.81
"""Gravity [m/s^2], as in the paper."""
SOLE_POINT_RADIUS = 0.00001
"""Radius of the spheres that touch the floor [m]."""

# Twelve digits: legible, the same text on every platform, and 1e-11 kg at most in the total mass.
_XML_PRECISION = 12


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


def new_scene(name: str, height: float, contact: ContactParameters, simulation: SimulationParameters) -> Any:
    """An empty PyMJCF model with options, floor and the class of touching points.

    Args:
        name: of the model.
        height: of the body, for the camera [m].
        contact: stiffness and friction of the soles on the floor.
        simulation: ``time_step`` [s] and ``integrator``.
    """
    from models._pymjcf import mjcf  # imported here: a body that is kept needs no PyMJCF

    root = mjcf.RootElement(model=name)
    root.compiler.set_attributes(angle="radian", autolimits=True, inertiafromgeom=False, balanceinertia=False)
    # Contact forces are measured, so the tolerance is that of rounding; Newton needs few iterations.
    root.option.set_attributes(
        timestep=simulation.time_step, integrator=simulation.integrator, gravity=(0, 0, -GRAVITY),
        cone="elliptic", impratio=contact.impratio, solver="Newton", iterations=100, tolerance=1e-12,
        ls_iterations=50, ls_tolerance=1e-3,
    )  # fmt: skip
    root.statistic.set_attributes(extent=2.0, center=(0, 0, 0.5 * height))
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

    for texture, kind, pattern, first, second in (
        ("sky", "skybox", "gradient", (0.93, 0.95, 0.97), (0.6, 0.7, 0.8)),
        ("floor", "2d", "checker", (0.78, 0.80, 0.82), (0.70, 0.72, 0.75)),
    ):
        colours = {"rgb1": first, "rgb2": second}
        root.asset.add("texture", name=texture, type=kind, builtin=pattern, width=256, height=256, **colours)
    # One square is 0.5 m: the pattern repeats every metre.
    root.asset.add("material", name="floor", texture="floor", texrepeat=(1, 1), texuniform=True)
    # contype only on the floor, conaffinity only on the points: two points never touch each other.
    root.worldbody.add(
        "geom", name="floor", dclass="contact", type="plane", size=(0, 0, 1), material="floor", contype=1,
        conaffinity=0,
    )  # fmt: skip
    return root


def add_segment(parent: Any, name: str, pos: Any, mass: float, com: Array, inertia: Array) -> Any:
    """A body with its mass [kg], its COM [m] and its inertia about that, (3, 3) [kg m^2]."""
    body = parent.add("body", name=name, pos=pos)
    values: dict[str, Any] = {"mass": mass, "pos": com}
    i = inertia
    if np.abs(i - np.diag(np.diag(i))).max() > 0.0:
        values["fullinertia"] = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    else:
        values["diaginertia"] = np.diag(i)
    body.add("inertial", **values)
    return body


def add_root(body: Any) -> None:
    """Make a body the free root, and let light and cameras follow it."""
    body.add("freejoint", name="root")
    # A light that follows the body: a fixed one casts grainy shadows on a large floor.
    body.add(
        "light", name="lamp", mode="trackcom", pos=(1.2, -1.6, 3.2), dir=(-0.33, 0.42, -1), cutoff=75,
        exponent=0, castshadow=True, diffuse=(0.5, 0.5, 0.5), specular=(0.1, 0.1, 0.1),
    )  # fmt: skip
    for name, pos, xyaxes in (
        ("side", (0.0, -3.2, 0.1), (1, 0, 0, 0, 0.03, 1)),
        ("front", (3.2, 0.0, 0.1), (0, 1, 0, -0.03, 0, 1)),
        ("oblique", (2.3, -2.3, 0.5), (0.707, 0.707, 0, -0.13, 0.13, 1)),
    ):
        body.add("camera", name=name, mode="trackcom", pos=pos, xyaxes=xyaxes)


def add_sole_points(
    side: str, sole: SoleGeometry, segments: Sequence[tuple[Any, Any]], quat: Any = None
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
            body.add("site", name=name, pos=origin + pos)
            # The sphere stands on the site, so the point that touches the floor is the site.
            body.add(
                "geom", name=name, dclass="contact", type="sphere", size=(SOLE_POINT_RADIUS,),
                pos=origin + pos + up, contype=0, conaffinity=1, rgba=(0.1, 0.1, 0.1, 1),
            )  # fmt: skip
            points.append(name)
    return tuple(points)


def _rotated(quat: Any, vector: Array) -> Array:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, np.asarray(quat, dtype=np.float64))
    return result


def joint_order(root: Any) -> list[str]:
    """Hinges in MuJoCo's joint order, which is depth first."""
    joints = root.find_all("joint", exclude_attachments=True)
    return [joint.name for joint in joints if joint.tag == "joint"]


def add_motors(root: Any, limits: Iterable[tuple[str, float]]) -> None:
    """A motor for every hinge, by its largest torque [N m]."""
    for name, limit in limits:
        both = (-limit, limit)
        root.actuator.add(
            "motor", name=name, joint=name, gear=(1,), ctrllimited=True, ctrlrange=both, forcelimited=True,
            forcerange=both,
        )  # fmt: skip


def add_sensors(root: Any, pelvis: str) -> None:
    """The sensors that a run reads: of the site ``imu``, of COM and angular momentum, of all hinges."""
    sensor = root.sensor
    sensor.add("accelerometer", name="imu_accelerometer", site="imu")
    sensor.add("gyro", name="imu_gyro", site="imu")
    sensor.add("framequat", name="imu_orientation", objtype="site", objname="imu")
    sensor.add("subtreecom", name="com", body=pelvis)
    sensor.add("subtreeangmom", name="angular_momentum", body=pelvis)
    for name in joint_order(root):
        sensor.add("jointpos", name=f"{name}_position", joint=name)
        sensor.add("jointvel", name=f"{name}_velocity", joint=name)


def to_xml(root: Any) -> str:
    """MJCF text of a PyMJCF model."""
    return str(root.to_xml_string(precision=_XML_PRECISION))

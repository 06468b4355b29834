"""The simulated world and body of a run with disturbances or steps of the floor: compiled, saved, replayed.

MuJoCo ignores most changes of a compiled model's floor: the pose of a geom that is fixed to the world is read
once, and so is the tree that sorts contacts out. So every change is written into the MJCF text before it is
compiled, and only there.
"""

from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import DisturbanceParameters, RunParameters
from ampm.planner.contacts import LEVEL, Contacts, Footstep, footprint
from ampm.planner.heights import Box, Ground, uneven
from ampm.section import unknown
from models.scene import BodyModel

_FAR = 1e3  # half the size of the floor of a scene with edges [m]
_THICK = 1.0  # thickness of that floor [m]
_AROUND = 0.08  # distance of the edges of a raised or lowered place from the sole [m]


def disturbed_model(body: BodyModel, run: RunParameters, contacts: Contacts) -> BodyModel:
    """The body in its world as it is simulated; ``body`` itself if the run does not change them.

    The floor is as high as the footsteps of the plan's contacts; a step of the floor is at one of them.
    Raises :class:`InputError` if there is no such segment or footstep, or a disturbance needs a level floor.
    """
    wanted = run.disturbance
    if wanted == DisturbanceParameters() and not uneven(contacts.footsteps) and contacts.slope == LEVEL:
        return body
    root = ElementTree.fromstring(body.xml)
    for contact in root.iterfind(".//default[@class='contact']/geom"):
        _scale(contact, "friction", wanted.friction_factor)
        _scale(contact, "solref", wanted.softness_factor)
    _change_masses(root, body, wanted)
    for key, more in (("damping", wanted.joint_damping), ("frictionloss", wanted.joint_friction)):
        for joint in root.findall(".//worldbody//joint") if more else ():
            joint.set(key, repr(float(joint.get(key, 0.0)) + more))
    _change_floor(root, body, run, contacts)
    return replace(body, xml=ElementTree.tostring(root, encoding="unicode"))


def surfaces(wanted: DisturbanceParameters, contacts: Contacts) -> Array:
    """Heights of the level surfaces of the floor, ascending, shape (L,); empty if it slopes [m]."""
    if wanted.slope_along or wanted.slope_across or contacts.slope != LEVEL:
        return np.empty(0)
    levels = {step.position[2] for step in contacts.footsteps} | {wanted.step_height}
    return wanted.floor_height + np.array(sorted(levels))


def _scale(element: ElementTree.Element, key: str, factor: float, *, all_of_it: bool = False) -> None:
    """Multiply the first number of an attribute, or all of them."""
    if factor != 1.0 and key in element.attrib:
        numbers = [float(text) for text in element.attrib[key].split()]
        scaled = [factor * number if all_of_it or i == 0 else number for i, number in enumerate(numbers)]
        element.set(key, " ".join(map(repr, scaled)))


def _change_masses(root: ElementTree.Element, body: BodyModel, wanted: DisturbanceParameters) -> None:
    """Scale mass and inertia of some segments."""
    segments = {item.get("name", ""): item for item in root.findall(".//worldbody//body")}
    trunk = {"chest": body.description.trunk_segment}
    names = dict.fromkeys(trunk.get(name.strip(), name.strip()) for name in wanted.mass_segment.split(","))
    for name in segments if "all" in names else names:
        item = segments.get(name)
        if item is None:
            known, key = ["all", "chest", *segments], "disturbance.mass_segment"
            raise unknown(name, known, f"segment in {key}", key=key, value=name)
        for inertial in item.iterfind("inertial"):
            for key in ("mass", "diaginertia", "fullinertia"):
                _scale(inertial, key, 1.0 + wanted.mass_change, all_of_it=True)


def _change_floor(root: ElementTree.Element, body: BodyModel, run: RunParameters, contacts: Contacts) -> None:
    """Move the plane, or replace it by boxes where the floor has edges."""
    wanted, world = run.disturbance, next(root.iter("worldbody"))
    plane = next(world.iterfind("geom[@name='floor']"))
    sloped = bool(wanted.slope_along or wanted.slope_across)
    if uneven(contacts.footsteps) and (sloped or wanted.step_height):
        raise InputError(
            "disturbance.slope_along, slope_across, step_height need footsteps of one height; leave out z."
        )
    if uneven(contacts.footsteps) and contacts.slope == LEVEL:
        _raise_floor(world, plane, Ground.under(contacts.footsteps, body.description.sole), wanted)
        return
    if not (sloped or wanted.step_height):
        plane.set("pos", f"0 0 {wanted.floor_height!r}")
        plane.set("zaxis", _text([-contacts.slope[0], -contacts.slope[1], 1.0]))
        return
    if wanted.step_height and len(contacts.footsteps) < 3:
        raise InputError("disturbance.step_height raises a footstep, and the plan has none; leave it out.")
    if wanted.step_height and wanted.step_number > len(contacts.footsteps):
        way_out = f"take 3 to {len(contacts.footsteps)}, or 0 as disturbance.step_height"
        raise run.refusal("disturbance.step_number", "is not a footstep of the plan", way_out)
    step = contacts.footsteps[wanted.step_number - 1 if wanted.step_height else 0]
    turn = Rotation.from_euler("z", step.heading).as_matrix()
    feet = np.array([item.position for item in contacts.footsteps]) @ turn  # in the walk's frame
    ends, hinge = np.full(2, _FAR), np.zeros(3)
    tiles = [Box(-ends, ends, 0.0)]
    if sloped:
        sole = body.description.sole
        front = feet[:2, 0].max() + sole.tip_x
        next_heel = feet[2, 0] + sole.heel_x if len(feet) > 2 else front + sole.length
        hinge[:2] = 0.5 * (front + next_heel), feet[:2, 1].mean()
        behind, ahead = np.array([hinge[0], _FAR]), np.array([hinge[0], -_FAR])
        tiles = [Box(-ends, behind, 0.0), Box(ahead, ends, 0.0)]
    if wanted.step_height:
        low, high = _place(body, step, contacts, turn)
        tiles = [part for tile in tiles for part in _split(tile, low, high, wanted.step_height)]
    tilt = Rotation.from_euler("YX", [-wanted.slope_along, wanted.slope_across]).as_matrix()
    world.remove(plane)
    up, turn = np.array([0.0, 0.0, wanted.floor_height]), _plane(contacts.slope) @ turn
    for number, tile in enumerate(tiles):
        centre = np.array([*(0.5 * (tile.low + tile.high)), tile.height - 0.5 * _THICK])
        rotation = np.eye(3)
        if sloped and tile.low[0] >= hinge[0]:
            # Plan coordinates of the tile are along the slope; its hinge stays where it is.
            centre, rotation = hinge + tilt @ (centre - hinge), tilt
        rotation, centre = turn @ rotation, turn @ centre + up
        name = "floor" if number == 0 else f"floor_{number}"
        world.insert(number, _box(plane, name, 0.5 * (tile.high - tile.low), centre, rotation))


def _plane(slope: tuple[float, float]) -> Array:
    """Rotation of a level floor to one with slopes along x and y, shape (3, 3)."""
    along, across = np.array([1.0, 0.0, slope[0]]), np.array([0.0, 1.0, slope[1]])
    up = np.cross(along, across)
    axes = np.stack([along, np.cross(up, along), up], axis=1)
    return np.asarray(axes / np.linalg.norm(axes, axis=0))


def _raise_floor(
    world: ElementTree.Element, plane: ElementTree.Element, ground: Ground, wanted: DisturbanceParameters
) -> None:
    """Put boxes on the plane, which is as high as the lowest footstep."""
    up, turn = np.array([0.0, 0.0, wanted.floor_height]), Rotation.from_euler("z", ground.heading).as_matrix()
    plane.set("pos", _text([0.0, 0.0, ground.base + wanted.floor_height]))
    for k, (low, high, top) in enumerate(zip(ground.low, ground.high, ground.height, strict=True), start=1):
        centre = turn @ np.array([*(0.5 * (low + high)), float(top) - 0.5 * _THICK]) + up
        world.insert(k, _box(plane, f"floor_{k}", 0.5 * (high - low), centre, turn))


def _box(plane: ElementTree.Element, name: str, half: Array, at: Array, turn: Array) -> ElementTree.Element:
    """A part of the floor with half its extent (2,) [m], centre (3,) [m] and rotation."""
    own = {"name": name, "type": "box", "size": _text([*half, 0.5 * _THICK]), "pos": _text(at)}
    own["xyaxes"] = _text([*turn[:, 0], *turn[:, 1]])
    return ElementTree.Element("geom", dict(plane.attrib) | own)


def _place(body: BodyModel, step: Footstep, contacts: Contacts, turn: Array) -> tuple[Array, Array]:
    """Rectangle around a footprint in the walk's frame, as far as the middle between both feet."""
    outline = footprint(body.description.sole, step) @ turn[:2, :2]
    low, high = outline.min(axis=0) - _AROUND, outline.max(axis=0) + _AROUND
    own = np.array(step.position) @ turn
    others = np.array([item.position for item in contacts.footsteps if item.foot != step.foot]) @ turn
    near = others[np.argmin(np.abs(others[:, 0] - own[0]))]
    middle = 0.5 * (own[1] + near[1])
    if own[1] > near[1]:
        low[1] = max(low[1], middle)
    else:
        high[1] = min(high[1], middle)
    return low, high


def _split(tile: Box, low: Array, high: Array, height: float) -> list[Box]:
    """A rectangle of the floor and, cut out of it, another one at another height.

    The seams lie along the walk's direction, so that no other foot treads on them.
    """
    low, high = np.maximum(low, tile.low), np.minimum(high, tile.high)
    if (low >= high).any():
        return [tile]
    parts = [
        tile._replace(high=np.array([tile.high[0], low[1]])),
        tile._replace(low=np.array([tile.low[0], high[1]])),
        tile._replace(low=np.array([tile.low[0], low[1]]), high=np.array([low[0], high[1]])),
        tile._replace(low=np.array([high[0], low[1]]), high=np.array([tile.high[0], high[1]])),
        tile._replace(low=low, high=high, height=tile.height + height),
    ]
    return [part for part in parts if (part.high > part.low).all()]


def _text(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)

"""Moving segments of a body at joint angles of 0, and the mean of its left and right.

A periodic motion needs a body whose sides are mirror images.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from models.scene import Findings, Inertial

_MIRROR = np.array([1.0, -1.0, 1.0])  # of a vector; of an axis of rotation with the opposite sign
_ALIKE = 0.02  # largest difference of mirrored places over the body's height, and of masses [1]
_UNLIKE = 0.05  # largest angle between an axis and its image [rad]
_VALUES = ("effort", "speed", "armature", "damping", "stiffness", "friction")  # of a hinge


@dataclass
class Hinge:
    """A hinge at angle 0: anchor from its segment's origin [m], axis, and its own values."""

    name: str
    anchor: Array
    axis: Array
    low: float
    high: float
    effort: float
    speed: float
    armature: float
    damping: float
    stiffness: float
    spring: float
    friction: float


@dataclass
class Segment:
    """A moving segment at angle 0, with what is fixed to it; vectors from its origin in axes of the world."""

    name: str
    parent: int
    place: Array  # from the root's origin
    joints: list[Hinge]
    inertial: Inertial = field(default_factory=lambda: Inertial(0.0, np.zeros(3), np.zeros((3, 3))))
    shapes: list[dict[str, Any]] = field(default_factory=list)


def symmetrise(segments: Sequence[Segment], locked: Sequence[str] = ()) -> tuple[list[int], Array, Findings]:
    """Give segments and hinges at angles of 0 the mean of themselves and of their image's mirror image.

    The image of a hinge is found by its place and axis, whatever its name. Limits, dampers and springs of a
    right hinge are those of its image.

    Args:
        segments: of a body whose left is towards +y; changed.
        locked: joints that are locked already, for a message.

    Returns:
        Number of the image of each of n hinges, its own in the middle, shape (n,); the sign of its angle to
        that of the hinge, shape (n,); how far both sides were from it.

    Raises:
        InputError: the body has no mirror image, or one that differs too much from it.
    """
    segment_of = [i for i, segment in enumerate(segments) for _ in segment.joints]
    near = _ALIKE * float(np.ptp([segment.place[2] for segment in segments]))
    images, apart = _images(segments, near, locked)
    pairs = list(range(len(segments)))
    for hinge, image in enumerate(images):
        pairs[segment_of[hinge]] = segment_of[image]
    signs, unlike = _mean_hinges(segments, images)
    place, com, mass = _mean_segments(segments, pairs)
    total = sum(segment.inertial.mass for segment in segments)
    for value, limit, unit, what in (
        (place, near, "m", "places of segments"),
        (com, near, "m", "the COM of one of their segments, as it moves that of the body"),
        (mass, _ALIKE * total, "kg", "masses"),
    ):
        if not value <= limit:
            raise InputError(
                f"left and right differ by {value:.3g} {unit} in {what}, more than {limit:.3g} {unit}; "
                "a periodic walk needs a symmetric body: correct the model, or the names in its description."
            )
    bare = tuple(i for i, segment in enumerate(segments) if not segment.shapes)
    return images, signs, Findings(max(place, apart), com, mass, bare, unlike)


def _images(segments: Sequence[Segment], near: float, locked: Sequence[str]) -> tuple[list[int], float]:
    """Number of the image of each hinge, and the largest distance of a hinge from its image's image [m].

    Two hinges at one place, such as clavicles, are told apart by the hinges that hang on them. Raises
    InputError if a hinge has no image within ``near`` [m].
    """
    hinges = [hinge for segment in segments for hinge in segment.joints]
    places = np.array([segment.place + hinge.anchor for segment in segments for hinge in segment.joints])
    axes = np.array([hinge.axis for hinge in hinges])
    gaps = _gaps(places)
    gaps[np.abs(axes @ (_MIRROR * axes).T) < math.cos(_UNLIKE)] = np.inf
    images: NDArray[np.intp] = (gaps + _gaps(limb_middles(segments))).argmin(axis=1)
    least = gaps[np.arange(len(hinges)), images]
    lonely = (least > near) | (images[images] != np.arange(len(hinges)))
    if lonely.any():
        names = [hinges[k].name for k in np.flatnonzero(lonely)]
        raise InputError(
            f"no mirror image within {near:.3g} m of the joints {', '.join(names)}; a periodic walk needs a "
            f"symmetric body that stands upright: correct it, or write lock = {[*locked, *names]} in [body] "
            "of its description, if they are of no leg."
        )
    return images.tolist(), float(least.max())


def _gaps(places: Array) -> Array:
    """Distance of each of n places from the mirror image of each, shape (n, n) [m]."""
    return np.asarray(np.linalg.norm(places[:, None] - _MIRROR * places, axis=2))


def limb_middles(segments: Sequence[Segment]) -> Array:
    """Mean place of the segments from each hinge outwards, shape (n, 3) [m]."""
    sums, counts = np.array([segment.place for segment in segments]), np.ones(len(segments))
    for i in range(len(segments) - 1, 0, -1):  # a segment comes after the one that it hangs on
        sums[segments[i].parent] += sums[i]
        counts[segments[i].parent] += counts[i]
    means = sums / counts[:, None]
    return np.array([means[i] for i, segment in enumerate(segments) for _ in segment.joints])


def _mean_hinges(segments: Sequence[Segment], images: Sequence[int]) -> tuple[Array, tuple[str, ...]]:
    """Make hinges the mirror images of each other; signs of their angles, shape (n,), and what differed."""
    hinges = [hinge for segment in segments for hinge in segment.joints]
    right = limb_middles(segments)[:, 1] < 0.0
    before = [replace(hinge) for hinge in hinges]
    signs, unlike = np.empty(len(hinges)), list[str]()
    for k, (mean, here) in enumerate(zip(hinges, before, strict=True)):
        image = before[images[k]]
        axis = -_MIRROR * image.axis
        signs[k] = sign = 1.0 if axis @ here.axis > 0.0 else -1.0
        axis = here.axis + sign * axis
        mean.axis = axis / np.linalg.norm(axis)
        mean.anchor = 0.5 * (here.anchor + _MIRROR * image.anchor)
        if images[k] != k and right[k]:
            low, high = sorted((0.0 + sign * image.low, 0.0 + sign * image.high))
            values = {name: getattr(image, name) for name in _VALUES}
            values |= {"low": low, "high": high, "spring": sign * image.spring}
            unlike += [
                f"{here.name} {name} {getattr(here, name):g}, now {value:g}"
                for name, value in values.items()
                if not math.isclose(getattr(here, name), value, rel_tol=1e-3, abs_tol=1e-6)
            ]
            vars(mean).update(values)
    return signs, tuple(unlike)


def _mean_segments(segments: Sequence[Segment], pairs: Sequence[int]) -> tuple[float, float, float]:
    """Make segments the mirror images of each other; largest differences of both sides.

    They are of places [m], of COMs times their share of the mass [m], of masses [kg]. Raises InputError if a
    segment does not hang on the image of what its image hangs on, or nothing has a mass.
    """
    before = [replace(segment) for segment in segments]
    total = sum(segment.inertial.mass for segment in before)
    if not total > 0.0:
        raise InputError("the links of the body have no mass; give them masses in its model.")
    places, coms, masses = [0.0], [0.0], [0.0]
    for mean, here, pair in zip(segments, before, pairs, strict=True):
        image = before[pair]
        if here.parent >= 0 and pairs[here.parent] != image.parent:
            raise InputError(
                f"the segment {here.name!r} is not a mirror image of {image.name!r}: they hang on different "
                "segments; correct the model, or lock the joints of both sides."
            )
        one, two = here.inertial, image.inertial
        place, com = _MIRROR * image.place, _MIRROR * two.com
        inertia = np.outer(_MIRROR, _MIRROR) * two.inertia
        mass = 0.5 * (one.mass + two.mass)
        places.append(float(np.linalg.norm(place - here.place)))
        coms.append(mass / total * float(np.linalg.norm(com - one.com)))
        masses.append(abs(two.mass - one.mass))
        mean.place = 0.5 * (here.place + place)
        mean.inertial = Inertial(mass, 0.5 * (one.com + com), 0.5 * (one.inertia + inertia))
    return max(places), max(coms), max(masses)

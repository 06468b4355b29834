"""Moving segments of a body at joint angles of 0, and the mean of its left and right.

A periodic motion needs a body whose sides are mirror images.
"""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from models.scene import Findings, Inertial

_MIRROR = np.array([1.0, -1.0, 1.0])  # of a vector; of an axis of rotation with the opposite sign
_ALIKE = 0.02  # largest difference of mirrored places over the body's height, and of masses [1]
_UNLIKE = 0.05  # largest angle between an axis and its image [rad]
_VALUES = ("effort", "speed", "armature", "damping", "stiffness", "friction")  # of a hinge


@dataclass(eq=False)
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
    segment: "Segment" = field(init=False)  # that it moves
    # the following are found by `symmetrise`
    image: "Hinge" = field(init=False)  # the hinge on the other side, itself in the middle
    side: int = field(init=False)  # 1 on the left, -1 on the right, 0 in the middle
    sign: float = field(init=False)  # its angle over that of the image in the mirrored pose, 1 or -1

    @property
    def place(self) -> Array:
        """Anchor from the root's origin, shape (3,) [m]."""
        return np.asarray(self.segment.place + self.anchor)


@dataclass(eq=False)
class Segment:
    """A moving segment at angle 0, with what is fixed to it; vectors from its origin in axes of the world."""

    name: str
    parent: Optional["Segment"]  # None of the root
    place: Array  # from the root's origin
    joints: list[Hinge]
    inertial: Inertial = field(default_factory=lambda: Inertial(0.0, np.zeros(3), np.zeros((3, 3))))
    shapes: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        for joint in self.joints:
            joint.segment = self

    @property
    def chain(self) -> list[Hinge]:
        """Hinges from the root to the segment."""
        return [*(self.parent.chain if self.parent else ()), *self.joints]

    @property
    def image(self) -> "Segment":
        """The segment on the other side, itself in the middle."""
        return self.joints[-1].image.segment if self.joints else self


def symmetrise(segments: Sequence[Segment], locked: Sequence[str] = ()) -> Findings:
    """Make a body symmetric: each segment and hinge becomes the mean of itself and its mirrored image.

    The image of a hinge is the one on the other side, found by place and axis at angles of 0, whatever its
    name. Limits, dampers and springs of a right hinge are those of its image.

    Args:
        segments: of a body whose left is towards +y, from the root outwards; changed.
        locked: joints that are locked already, for a message.

    Returns:
        How far both sides were from being mirror images.

    Raises:
        InputError: the body has no mass or mirror image, or one that differs too much from it.
    """
    total = sum(segment.inertial.mass for segment in segments)
    if not total > 0.0:
        raise InputError("the links of the body have no mass; give them masses in its model.")
    near = _ALIKE * float(np.ptp([segment.place[2] for segment in segments]))
    apart = _find_images(segments, near, total, locked)
    unlike = _mean_hinges(segments)
    place, com, mass = _mean_segments(segments, total)
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
    return Findings(max(place, apart), com, mass, bare, unlike)


def _find_images(segments: Sequence[Segment], near: float, total: float, locked: Sequence[str]) -> float:
    """Find image and side of each hinge; the largest distance of a hinge from its mirrored image [m].

    Two hinges at one place, such as clavicles, are told apart by the middles of what hangs on them. Raises
    InputError if a hinge has no image within ``near`` [m]; ``total`` is the mass [kg].
    """
    hinges, middles = [hinge for segment in segments for hinge in segment.joints], _limb_middles(segments)
    axes = np.array([hinge.axis for hinge in hinges])
    gaps = _gaps(np.array([hinge.place for hinge in hinges]))
    gaps[np.abs(axes @ (_MIRROR * axes).T) < math.cos(_UNLIKE)] = np.inf
    images: NDArray[np.intp] = (gaps + _gaps(middles)).argmin(axis=1)
    least = gaps[np.arange(len(hinges)), images]
    lonely = (least > near) | (images[images] != np.arange(len(hinges)))
    if lonely.any():
        names = [hinges[k].name for k in np.flatnonzero(lonely).tolist()]
        way_out = f"or write lock = {[*locked, *names]} in [body] of its description, if they are of no leg"
        aside = abs(sum(s.inertial.mass * float(s.place[1] + s.inertial.com[1]) for s in segments)) / total
        kept = [s.place[2] for s in segments if not any(joint.name in names for joint in s.joints)]
        if aside > (most := 0.5 * _ALIKE * float(np.ptp(kept))):
            way_out = f"as lock leaves its COM {aside:.3g} m from the middle, {most:.3g} m at most"
        raise InputError(
            f"no mirror image within {near:.3g} m of the joints {', '.join(names)}; a periodic walk needs a "
            f"symmetric body that stands upright: correct it, {way_out}."
        )
    for hinge, image, beyond in zip(hinges, images.tolist(), middles[:, 1] - middles[images, 1], strict=True):
        hinge.image, hinge.side = hinges[image], int(np.sign(beyond))
    return float(least.max())


def _gaps(places: Array) -> Array:
    """Distance of each of n places from the mirror image of each, shape (n, n) [m]."""
    return np.asarray(np.linalg.norm(places[:, None] - _MIRROR * places, axis=2))


def _limb_middles(segments: Sequence[Segment]) -> Array:
    """Mean place of the segments from each hinge outwards, shape (n, 3) [m]."""
    sums, counts = {segment: segment.place for segment in segments}, dict.fromkeys(segments, 1)
    for segment in reversed(segments):  # a segment comes after the one that it hangs on
        if segment.parent:
            sums[segment.parent] = sums[segment.parent] + sums[segment]
            counts[segment.parent] += counts[segment]
    return np.array([sums[segment] / counts[segment] for segment in segments for _ in segment.joints])


def _mean_hinges(segments: Sequence[Segment]) -> tuple[str, ...]:
    """Make hinges mirror images of each other, and find the signs of their angles; values that differed."""
    before, unlike = {joint: copy(joint) for segment in segments for joint in segment.joints}, list[str]()
    for mean, here in before.items():
        image = before[here.image]
        axis = -_MIRROR * image.axis
        mean.sign = sign = 1.0 if axis @ here.axis > 0.0 else -1.0
        axis = here.axis + sign * axis
        mean.axis = axis / np.linalg.norm(axis)
        mean.anchor = 0.5 * (here.anchor + _MIRROR * image.anchor)
        if here.side < 0:
            low, high = sorted((0.0 + sign * image.low, 0.0 + sign * image.high))
            values = {name: getattr(image, name) for name in _VALUES}
            values |= {"low": low, "high": high, "spring": sign * image.spring}
            unlike += [
                f"{here.name} {name} {getattr(here, name):g}, now {value:g}"
                for name, value in values.items()
                if not math.isclose(getattr(here, name), value, rel_tol=1e-3, abs_tol=1e-6)
            ]
            vars(mean).update(values)
    return tuple(unlike)


def _mean_segments(segments: Sequence[Segment], total: float) -> tuple[float, float, float]:
    """Make segments mirror images of each other; largest differences of left and right before.

    These are of places [m], of COMs times their share of the mass ``total`` [m], of masses [kg]. Raises
    InputError if two images do not hang on images.
    """
    before = {segment: copy(segment) for segment in segments}
    places, coms, masses = [0.0], [0.0], [0.0]
    for mean, here in before.items():
        image = before[mean.image]
        if here.parent and here.parent.image is not image.parent:
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

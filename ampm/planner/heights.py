"""Footsteps of different heights: the height of the COM over them, and the floor that has these heights.

The COM obeys vertically the law that it obeys horizontally, ``z'' = (g/H) (z - H - h)``, with h the height of
the support: that of the standing foot, blended in double support as the ZMP is. Then
``(z - h) / (g + z'') = H / g`` at every instant: a force line through the COM meets the level plane of height
h where it meets the floor in the walk on level ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ampm.description import SoleGeometry
from ampm.exceptions import BodilyRefusal
from ampm.geometry import Array, rotations
from ampm.parameters import GRAVITY
from ampm.planner.blend import BlendLaw, HeightLaw, shape
from ampm.planner.contacts import Footstep, footprint
from ampm.planner.rest_to_rest import SETTLING, Problem

EDGE = 0.015
"""Distance of an edge of the floor from the soles above it, and the least from those below it [m]."""
_AROUND = 0.5  # by which a raised part of the floor is larger than its soles where none is near [m]


def uneven(footsteps: Sequence[Footstep]) -> bool:
    """Whether any footstep is off the floor z = 0."""
    return any(step.position[2] for step in footsteps)


def vertical_laws(
    footsteps: Sequence[Footstep], problem: Problem, zmp: Sequence[Array], height: float
) -> list[HeightLaw]:
    """Heights of the COM in the phases of a walk from rest to rest.

    The COM follows a point H over the support. For rest at both ends the point is moved in the first and the
    last double support, by two triangles of some tenths of a millimetre.

    Args:
        footsteps: of the walk.
        problem: its N single supports, and the double supports between them.
        zmp: at the ends of the quarters of the first and the last double support, shapes (5, 2) [m].
        height: of the COM over the support, H [m].

    Returns:
        Laws of four, 2 N - 1 and four phases.
    """
    w, n = math.sqrt(GRAVITY / height), 2 * len(problem.single) + 7
    place = np.array([step.position[:2] for step in footsteps])
    z = np.array([step.position[2] for step in footsteps])
    # The phases' durations [s], rates of the blends [1/s], and heights of the support at begin and end [m].
    duration, rate, support = np.full(n, 0.25 * SETTLING), np.zeros(n), np.empty((n, 2))
    duration[4:-4:2], duration[5:-4:2], rate[5:-4:2] = problem.single, problem.double, problem.blend[:, 1]
    support[4:-4:2], support[5:-4:2, 0], support[5:-4:2, 1] = z[1:-1, None], z[1:-2], z[2:-1]
    for foot, rows, quarters, ends in (
        (0, slice(0, 4), zmp[0], (0.5, 1.0)),
        (len(z) - 2, slice(n - 4, n), zmp[1], (0.0, 0.5)),
    ):
        across = place[foot + 1] - place[foot]
        share = np.clip(((quarters - place[foot]) * across).sum(axis=1) / (across**2).sum(), 0.0, 1.0)
        share[[0, -1]] = ends
        blended = z[foot] + share * (z[foot + 1] - z[foot])
        support[rows, 0], support[rows, 1] = blended[:-1], blended[1:]
    points = np.stack([support, *np.zeros((2, n, 2))])  # and both triangles, of unit height
    points[1, [1, 2], [1, 0]] = points[2, [-3, -2], [1, 0]] = 1.0
    # z + z'/w grows and is known at the end; z - z'/w fades and is known at the begin.
    mean, way = points.mean(axis=2), w**2 / (w**2 + rate**2) * np.diff(points, axis=2)[..., 0]
    begin, end = (shape(rate, duration, time) for time in (np.zeros(n), duration))
    fade = np.exp(-w * duration)
    grows, fades = np.empty((2, 3, n + 1))
    grows[:, n], fades[:, 0] = points[:, -1, 1], points[:, 0, 0]
    for k in range(n):
        here, there = (mean[:, k] + way[:, k] * (at.value[k] - at.rate[k] / w) for at in (begin, end))
        fades[:, k + 1] = there + fade[k] * (fades[:, k] - here)
    for k in reversed(range(n)):
        here, there = (mean[:, k] + way[:, k] * (at.value[k] + at.rate[k] / w) for at in (begin, end))
        grows[:, k] = here + fade[k] * (grows[:, k + 1] - there)
    # Velocities at both ends, which the triangles make zero (Cramer's rule).
    (p, q), (a, b), (c, d) = (grows - fades)[:, [0, n]]
    size = np.array([1.0, (q * c - p * d) / (a * d - b * c), (p * b - q * a) / (a * d - b * c)])
    grows, fades = (size[:, None] * grows).sum(axis=0), (size[:, None] * fades).sum(axis=0)
    position, velocity = height + 0.5 * (grows + fades), 0.5 * w * (grows - fades)
    point = height + (size[:, None, None] * points).sum(axis=0)
    columns = rate, duration, position[:n], velocity[:n], point, support - point
    values = zip(*(column.tolist() for column in columns), strict=True)
    return [HeightLaw(BlendLaw(w, k, T, z0, v0, tuple(r), tuple(arm))) for k, T, z0, v0, r, arm in values]


@dataclass(frozen=True)
class Ground:
    """A level floor with raised parts: rectangles along and across one heading."""

    heading: float  # of the rectangles [rad]
    base: float  # height of the floor elsewhere, the lowest of all [m]
    low: Array  # corners in axes along and across the heading, shape (n, 2) [m]
    high: Array  # the opposite corners, shape (n, 2) [m]
    height: Array  # of the rectangles, shape (n,) [m]

    @classmethod
    def under(cls, footsteps: Sequence[Footstep], sole: SoleGeometry) -> Ground:
        """The floor under footsteps.

        Footsteps of one height that follow each other share a rectangle. Where a lower one would be in it,
        only near ones share one. Its edges are :data:`EDGE` from their soles on the side of lower ones, and
        half a metre elsewhere. They lie along the first footstep, or else along another one for which there
        is room. Raises :class:`BodilyRefusal` if footsteps of different heights are too near to each other
        for an edge.
        """
        refusal = None
        for heading in dict.fromkeys(step.heading for step in footsteps):
            try:
                return cls._along(heading, footsteps, sole)
            except BodilyRefusal as error:
                refusal = refusal or error
        raise refusal or ValueError("there are no footsteps")

    @classmethod
    def _along(cls, heading: float, footsteps: Sequence[Footstep], sole: SoleGeometry) -> Ground:
        """The floor under footsteps, with edges along and across a heading; raises as :meth:`under`."""
        z = np.array([step.position[2] for step in footsteps])
        outlines = np.stack([footprint(sole, step) for step in footsteps]) @ rotations(heading)
        soles = np.stack([outlines.min(axis=1), outlines.max(axis=1)], axis=1)  # low and high of each
        starts = np.flatnonzero(np.diff(z, prepend=np.nan))
        parts: list[tuple[Array, float]] = []
        for boxes, height in zip(np.split(soles, starts[1:]), z[starts].tolist(), strict=True):
            rectangles = [_around(boxes)]
            if any(_apart(rectangles[0], sole)[1] < 2.0 * EDGE for sole in soles[z < height]):
                rectangles = _joined(boxes, 2.0 * EDGE)
            for rectangle in rectangles:
                same = [part[0] for part in parts if part[1] == height]
                *kept, whole = _joined([*same, rectangle], 0.0)
                parts = [part for part in parts if part[1] != height or any(part[0] is one for one in kept)]
                parts.append((whole, height))
        parts = [part for part in parts if part[1] > z.min()]
        wide = [box + _AROUND * np.array([[-1.0], [1.0]]) for box, _ in parts]
        for number, ((box, height), cut) in enumerate(zip(parts, wide, strict=True)):
            for other, other_height in parts[:number] + parts[number + 1 :]:
                if other_height == height:
                    side, gap = _apart(box, other)
                    _cut(cut, box, side, gap, 0.5)
            for step, (sole_box, sole_height) in enumerate(zip(soles, z.tolist(), strict=True), start=1):
                if sole_height < height:
                    side, gap = _apart(box, sole_box)
                    _refuse_near(step, gap, height - sole_height)
                    _cut(cut, box, side, EDGE, 1.0)
        corners, heights = np.array(wide).reshape(-1, 2, 2), np.array([height for _, height in parts])
        return cls(heading, float(z.min()), corners[:, 0], corners[:, 1], heights)

    def at(self, points: Array, around: float = 0.0) -> Array:
        """Height of the highest part within a distance of points (..., 2) [m], shape (...) [m]."""
        turned = (points @ rotations(self.heading))[..., None, :]
        inside = ((turned > self.low - around) & (turned < self.high + around)).all(axis=-1)
        return np.max(np.where(inside, self.height, self.base), axis=-1, initial=self.base)


def _around(boxes: Array) -> Array:
    """The least box around boxes (n, 2, 2), low and high corner each."""
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _joined(boxes: Iterable[Array], gap: float) -> list[Array]:
    """Boxes (2, 2) that are more than a gap from each other [m]: nearer ones become the box around them."""
    found: list[Array] = []
    for box in boxes:
        while near := [other for other in found if _apart(box, other)[1] <= gap]:
            box = _around(np.stack([box, *near]))
            found = [other for other in found if not any(other is one for one in near)]
        found.append(box)
    return found


def _apart(box: Array, other: Array) -> tuple[tuple[int, int], float]:
    """Side and axis of a box along which another one is farthest, and their gap [m]."""
    gaps = np.stack([box[0] - other[1], other[0] - box[1]])
    side, axis = divmod(int(gaps.argmax()), 2)
    return (side, axis), float(gaps[side, axis])


def _cut(wide: Array, box: Array, side: tuple[int, int], gap: float, share: float) -> None:
    """Move one side of a wide box to a share of a gap from the narrow box in it, if it is farther."""
    edge, nearer = box[side] + (2 * side[0] - 1) * share * gap, (max, min)[side[0]]
    wide[side] = nearer(float(wide[side]), float(edge))


def _refuse_near(number: int, gap: float, rise: float) -> None:
    if not gap >= 2.0 * EDGE - 1e-9:  # for rounding
        near = f"is {gap:.4g} m from" if gap >= 0.0 else f"reaches {-gap:.3g} m under"
        raise BodilyRefusal(
            f"the sole of footstep {number} {near} one that is {rise:.3g} m higher, and an edge of the floor "
            f"takes {2.0 * EDGE:g} m between them",
            reason="no_room_for_edge",
            value=gap,
            limit=2.0 * EDGE,
            unit="m",
            way_out="move them apart, or give them the same height",
        )

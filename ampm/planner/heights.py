"""Footsteps of different heights: the height of the COM over them, and the floor that has these heights.

The COM obeys vertically the law that it obeys horizontally, ``z'' = (g/H) (z - H - h)``, with h the height of
the support: that of the standing foot, blended in double support as the ZMP is. Then
``(z - h) / (g + z'') = H / g`` at every instant: a force line through the COM meets the level plane of height
h where it meets the floor in the walk on level ground.
"""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import NamedTuple, Self

import numpy as np

from ampm.description import SoleGeometry
from ampm.exceptions import BodilyRefusal
from ampm.geometry import Array, rotations
from ampm.parameters import GRAVITY
from ampm.planner.blend import BlendLaw, shape
from ampm.planner.contacts import Footstep, footprint
from ampm.planner.rest_to_rest import SETTLING, Problem

EDGE = 0.015
"""Distance of an edge of the floor from the soles above it, and the least from those below it [m]."""
_AROUND = 0.5  # by which a raised part of the floor is larger than its soles where none is near [m]


def uneven(footsteps: Sequence[Footstep]) -> bool:
    """Whether any footstep is off the floor z = 0."""
    return any(step.position[2] for step in footsteps)


def vertical_laws(
    footsteps: Sequence[Footstep], problem: Problem, stands: Array, height: float
) -> list[BlendLaw]:
    """Upward laws of the COM in the phases of a walk from rest to rest; their ZMP is the support's height.

    The COM follows a point r that is H over the support, ``z'' = w^2 (z - r)``. For rest at both ends the
    point is moved in the first and the last double support, by two triangles of some tenths of a millimetre.

    Args:
        footsteps: of the walk.
        problem: its N single supports, and the double supports between them.
        stands: ZMP at the ends of the quarters of the first and the last double support, (2, 5, 2) [m].
        height: of the COM over the support, H [m].

    Returns:
        Laws of four, 2 N - 1 and four phases.
    """
    w = math.sqrt(GRAVITY / height)
    duration, rate, support = _supports(footsteps, problem, stands)
    points = np.stack([support, *np.zeros((2, *support.shape))])  # and both triangles, of unit height
    points[1, [1, 2], [1, 0]] = points[2, [-3, -2], [1, 0]] = 1.0
    grows, fades = _components(points, w, rate, duration)
    # Heights of the triangles by which the velocities at both ends become zero (Cramer's rule).
    (p, q), (a, b), (c, d) = (grows - fades)[:, [0, -1]]
    size = np.array([1.0, (q * c - p * d) / (a * d - b * c), (p * b - q * a) / (a * d - b * c)])
    grows, fades = (size[:, None] * grows).sum(axis=0), (size[:, None] * fades).sum(axis=0)
    position, velocity = height + 0.5 * (grows + fades), 0.5 * w * (grows - fades)
    point = height + (size[:, None, None] * points).sum(axis=0)
    columns = rate, duration, position[:-1], velocity[:-1], point, support - point
    values = zip(*(column.tolist() for column in columns), strict=True)
    return [BlendLaw(w, k, T, z0, v0, tuple(r), tuple(arm)) for k, T, z0, v0, r, arm in values]


def _supports(footsteps: Sequence[Footstep], problem: Problem, stands: Array) -> tuple[Array, Array, Array]:
    """Durations [s], rates of the blends [1/s], (n,), and heights of the support at begin and end (n, 2) [m].

    In both stands the support is between the feet where the ZMP is nearest, and midway at rest.
    """
    n = 2 * len(problem.single) + 7
    place, z = np.split(np.array([step.position for step in footsteps]), [2], axis=1)
    duration, rate, support = np.full(n, 0.25 * SETTLING), np.zeros(n), np.empty((n, 2))
    duration[4:-4:2], duration[5:-4:2], rate[5:-4:2] = problem.single, problem.double, problem.blend[:, 1]
    support[4:-4:2], support[5:-4:2] = z[1:-1], np.hstack([z[1:-2], z[2:-1]])
    for foot, rows, zmp, ends in (
        (0, slice(0, 4), stands[0], (0.5, 1.0)),
        (len(z) - 2, slice(n - 4, n), stands[1], (0.0, 0.5)),
    ):
        across = place[foot + 1] - place[foot]
        share = np.clip(((zmp - place[foot]) * across).sum(axis=1) / (across**2).sum(), 0.0, 1.0)
        share[[0, -1]] = ends
        blended = z[foot] + share * (z[foot + 1] - z[foot])
        support[rows, 0], support[rows, 1] = blended[:-1], blended[1:]
    return duration, rate, support


def _components(points: Array, w: float, rate: Array, duration: Array) -> tuple[Array, Array]:
    """Components of COMs that follow blends of points r (m, n, 2), at all switches, shape (m, n + 1) each.

    ``xi = z + z'/w`` grows, ``xi' = w (xi - r)``, and is known at the end, where it is at the point;
    ``eta = z - z'/w`` fades, ``eta' = w (r - eta)``, and is known at the begin. In a phase the distances from
    ``mean + w^2/(w^2 + k^2) (sigma +- sigma'/w) (r_1 - r_0)``, the blend's own motion, change by exp(+-w T).
    """
    n = len(duration)
    mean, way = points.mean(axis=2), w**2 / (w**2 + rate**2) * np.diff(points, axis=2)[..., 0]
    begin, end = (shape(rate, duration, time) for time in (np.zeros(n), duration))
    fade, (grows, fades) = np.exp(-w * duration), np.empty((2, len(points), n + 1))
    grows[:, n], fades[:, 0] = points[:, -1, 1], points[:, 0, 0]
    here, there = (mean + way * (at.value - at.rate / w) for at in (begin, end))
    for k in range(n):
        fades[:, k + 1] = there[:, k] + fade[k] * (fades[:, k] - here[:, k])
    here, there = (mean + way * (at.value + at.rate / w) for at in (begin, end))
    for k in reversed(range(n)):
        grows[:, k] = here[:, k] + fade[k] * (grows[:, k + 1] - there[:, k])
    return grows, fades


@dataclass(frozen=True)
class Ground:
    """A level floor with raised parts: rectangles along and across one heading."""

    heading: float  # of the rectangles [rad]
    base: float  # height of the floor elsewhere, the lowest of all [m]
    low: Array  # corners in axes along and across the heading, shape (n, 2) [m]
    high: Array  # the opposite corners, shape (n, 2) [m]
    height: Array  # of the rectangles, shape (n,) [m]

    @classmethod
    def under(cls, footsteps: Sequence[Footstep], sole: SoleGeometry) -> Self:
        """The floor under footsteps.

        Footsteps of one height that follow each other share a rectangle. Where a lower one would be in it,
        only near ones share one. Its edges are :data:`EDGE` from their soles on the side of lower ones, and
        half a metre elsewhere. They lie along the first footstep, or else along one that steps up or down.
        Raises :class:`BodilyRefusal` if footsteps of different heights are too near to each other for an
        edge.
        """
        try:
            return cls._along(footsteps[0].heading, footsteps, sole)
        except BodilyRefusal:
            stepped = (b for a, b in pairwise(footsteps) if a.position[2] != b.position[2])
            for heading in dict.fromkeys(step.heading for step in stepped):
                with suppress(BodilyRefusal):
                    return cls._along(heading, footsteps, sole)
            raise

    @classmethod
    def _along(cls, heading: float, footsteps: Sequence[Footstep], sole: SoleGeometry) -> Self:
        """The floor under footsteps, with edges along and across a heading; raises as :meth:`under`."""
        z = [float(step.position[2]) for step in footsteps]
        outlines = np.stack([footprint(sole, step) for step in footsteps]) @ rotations(heading)
        corners = outlines.min(axis=1), outlines.max(axis=1)
        soles = [Box(*box) for box in zip(*corners, z, strict=True)]
        parts: list[Box] = []
        for height, following in groupby(soles, key=lambda box: box.height):
            boxes = list(following)
            whole = _around(boxes)
            near = any(box.height < height and _apart(whole, box)[1] < 2.0 * EDGE for box in soles)
            parts = _joined([*parts, *(_joined(boxes, 2.0 * EDGE) if near else [whole])], 0.0)
        parts = [part for part in parts if part.height > min(z)]
        wide = np.empty((len(parts), 2, 2))  # low and high corners
        for part, cut in zip(parts, wide, strict=True):
            cut[0], cut[1] = part.low - _AROUND, part.high + _AROUND
            for other in parts:
                if other is not part and other.height == part.height:
                    side, gap = _apart(part, other)
                    _cut(cut, part, side, 0.5 * gap)
            for step, box in enumerate(soles, start=1):
                if box.height < part.height:
                    side, gap = _apart(part, box)
                    if not gap >= 2.0 * EDGE - 1e-9:  # for rounding
                        place = f"is {gap:.4g} m from" if gap >= 0.0 else f"reaches {-gap:.3g} m under"
                        raise BodilyRefusal(
                            f"the sole of footstep {step} {place} one that is {part.height - box.height:.3g} "
                            f"m higher, and an edge of the floor takes {2.0 * EDGE:g} m between them",
                            reason="no_room_for_edge",
                            value=gap,
                            limit=2.0 * EDGE,
                            unit="m",
                            way_out="move them apart, or give them the same height",
                        )
                    _cut(cut, part, side, EDGE)
        return cls(heading, min(z), wide[:, 0], wide[:, 1], np.array([part.height for part in parts]))

    def at(self, points: Array, around: float = 0.0) -> Array:
        """Height of the highest part within a distance of points (..., 2) [m], shape (...) [m]."""
        turned = (points @ rotations(self.heading))[..., None, :]
        inside = ((turned > self.low - around) & (turned < self.high + around)).all(axis=-1)
        return np.max(np.where(inside, self.height, self.base), axis=-1, initial=self.base)


class Box(NamedTuple):
    """A rectangle of the floor, or around a sole."""

    low: Array  # corner along and across the heading, shape (2,) [m]
    high: Array  # the opposite corner, shape (2,) [m]
    height: float  # [m]


def _around(boxes: Sequence[Box]) -> Box:
    """The least box around boxes of one height."""
    low, high = np.min([box.low for box in boxes], axis=0), np.max([box.high for box in boxes], axis=0)
    return Box(low, high, boxes[0].height)


def _joined(boxes: Iterable[Box], gap: float) -> list[Box]:
    """Boxes farther than a gap from others of their height [m]: nearer ones become the box around them."""
    found: list[Box] = []
    for box in boxes:
        while near := [one for one in found if one.height == box.height and _apart(box, one)[1] <= gap]:
            box = _around([box, *near])
            found = [one for one in found if not any(one is other for other in near)]
        found.append(box)
    return found


def _apart(box: Box, other: Box) -> tuple[tuple[int, int], float]:
    """Side and axis of a box along which another one is farthest, and their gap [m]."""
    gaps = np.stack([box.low - other.high, other.low - box.high])
    side, axis = divmod(int(gaps.argmax()), 2)
    return (side, axis), float(gaps[side, axis])


def _cut(wide: Array, part: Box, side: tuple[int, int], distance: float) -> None:
    """Move one side of a wide box to a distance from the part in it, if it is farther."""
    low, high = part.low[side[1]] - distance, part.high[side[1]] + distance
    wide[side] = min(wide[side], high) if side[0] else max(wide[side], low)

"""Feet that go over from one plan to another, which is made while the first is walked."""

from dataclasses import replace

import numpy as np

from ampm.planner.feet import FeetPlan, FootPath
from ampm.planner.stride import quintic, shift


def joined(old: FeetPlan, new: FeetPlan, begin: float, landed: float) -> FeetPlan:
    """Feet of one plan until an instant, then of another; their difference fades until a landing.

    Args:
        old: motion until then.
        new: motion from then on, with the same feet on the floor at that instant.
        begin: the instant, within both plans [s].
        landed: when the swinging foot lands, or the next one to swing if both stand [s].
    """
    left = _joined(old.left, new.left, begin, landed)
    return replace(new, left=left, right=_joined(old.right, new.right, begin, landed))


def _joined(old: FootPath, new: FootPath, begin: float, landed: float) -> FootPath:
    """One foot of :func:`joined`."""
    before, row = old.start < begin, int(new.segments(np.array([begin]))[0])
    start = np.maximum(new.start[row:], begin)
    curves = shift(new.curve[row:], start - new.start[row:])
    last = slice(max(int(before.sum()) - 1, 0), max(int(before.sum()), 1))  # the segment in force
    gap = shift(old.curve[last], begin - old.start[last])[0] - curves[0]
    values = gap[:, :3].T * np.array([[1.0], [1.0], [2.0]])  # with rates and accelerations
    fade = np.zeros_like(gap)
    fade[:, :6] = quintic(values, np.zeros_like(values), np.full(len(gap), landed - begin))
    swings = start < landed - 1e-9
    curves[swings] += shift(fade[None].repeat(swings.sum(), axis=0), start[swings] - begin)
    return FootPath(
        start=np.concatenate([old.start[before], start]),
        pivot=np.concatenate([old.pivot[before], new.pivot[row:]]),
        contact=np.concatenate([old.contact[before], new.contact[row:]]),
        curve=np.concatenate([old.curve[before], curves]),
    )

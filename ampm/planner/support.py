"""Centroidal motion and feet together: support polygon and ZMP margin."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.description import SoleGeometry
from ampm.geometry import Array, blocks, polygon_margin
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.contacts import times_within
from ampm.planner.feet import FeetPlan, FootSample
from ampm.planner.periodic import gait_contacts, plan_gait
from ampm.planner.stride import plan_feet

_BESIDE_JUMP = 1e-9  # how far beside a jump of the support its two sides are evaluated [s]
_GRID = 24  # instants between two jumps, and in every refinement
_REFINEMENTS = 4


@dataclass(frozen=True)
class StepPlan(CentroidalPlan):
    """Centroidal motion and feet over the same contacts: what is planned before a body has a posture."""

    feet: FeetPlan  # motion of both feet; it may go on after the plan's end

    def points_in_contact(self, time: Array) -> tuple[Array, NDArray[np.bool_]]:
        """World (x, y) of all twelve sole points, (N, 12, 2) [m], and which are in contact, (N, 12)."""
        return _points_of(self.feet.sample(time))

    def zmp_margin(self, times: ArrayLike) -> Array:
        """Signed distance of the planned ZMP to the edge of the support polygon.

        Args:
            times: shape (N,) [s].

        Returns:
            Positive inside, negative outside, shape (N,) [m].

        Raises:
            InputError: a time lies outside the plan.
        """
        time = times_within(times, self.duration)
        margin = np.empty(len(time))
        for block in blocks(len(time)):
            margin[block] = margin_on(self.feet.sample(time[block]), self.sample(time[block]).zmp)
        return margin

    def least_zmp_margin(self, until: float | None = None) -> tuple[float, float]:
        """The least of :meth:`zmp_margin`, and its time.

        The polygon jumps where a contact changes, so a grid alone misses the least: both sides of every jump
        are evaluated, and the least in between is narrowed down.

        Args:
            until: end of the search [s]; the plan's own by default.

        Returns:
            Margin [m] and time [s].

        Raises:
            InputError: the plan ends earlier.
        """
        end = self.duration if until is None else float(times_within(until, self.duration)[0])
        changes = [self.contacts.starts[1:], self.feet.left.start, self.feet.right.start]
        jumps = np.concatenate([[0.0, end], *changes])
        jumps = _ascending(jumps[(jumps >= 0.0) & (jumps <= end)])
        inside = jumps[:-1, None] + np.diff(jumps)[:, None] * np.linspace(0.0, 1.0, _GRID)[1:-1]
        times = np.concatenate([jumps, jumps - _BESIDE_JUMP, jumps + _BESIDE_JUMP, inside.ravel()])
        times = _ascending(np.clip(times, 0.0, end))
        least, at = np.inf, 0.0
        for _ in range(1 + _REFINEMENTS):
            margin = self.zmp_margin(times)
            worst = int(margin.argmin())
            if margin[worst] < least:
                least, at = float(margin[worst]), float(times[worst])
            around = times[max(worst - 1, 0)], times[min(worst + 1, len(times) - 1)]
            times = np.linspace(*around, _GRID)
        return least, at


def _points_of(feet: tuple[FootSample, FootSample]) -> tuple[Array, NDArray[np.bool_]]:
    points = np.concatenate([foot.sole_points[:, :, :2] for foot in feet], axis=1)
    return points, np.concatenate([foot.contact.repeat(2, axis=1) for foot in feet], axis=1)


def margin_on(feet: tuple[FootSample, FootSample], zmp: Array) -> Array:
    """See :meth:`StepPlan.zmp_margin`: of a ZMP, shape (N, 2), on the feet at the same times, (N,) [m]."""
    points, contact = _points_of(feet)
    return np.where(contact.any(axis=1), polygon_margin(points, contact, zmp), -np.inf)


@lru_cache(maxsize=4)  # a search plans them again with another posture
def plan_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """Plan a periodic straight gait and its feet.

    Args:
        gait: what to walk.
        mass: of the body [kg].
        foot: key-frames of the feet.
        sole: outline of a sole.

    Raises:
        InputError: the mass is not a usable number, or the feet's timing does not fit the gait's.
        MathematicalRefusal: the closed form has no solution, or none that can be computed.
    """
    # One step further than the walk: at its end the rear foot is about to leave, as at any other switch.
    plan = plan_gait(gait, mass)
    further = gait_contacts(gait, plan.constants, gait.steps + 1)
    return StepPlan.of(plan, feet=plan_feet(further, foot, sole))


def _ascending(values: Array) -> Array:
    """Different values in order; :func:`numpy.unique` loads NumPy's masked arrays, which takes long."""
    return np.array(sorted(set(values.tolist())))

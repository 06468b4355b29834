"""Which plan a walk followed at which time, as one function of time."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ampm.planner.centroidal import PlanSample
from ampm.stepping.planned import PlannedTick

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from ampm.walk import WalkPlan

    Array = NDArray[np.float64]

STEPPING = -1
"""Number of the plan of the stabiliser that steps, see :attr:`SimulationRecord.tick_plan`."""
_SAME = 1e-9  # time before a tick that counts as the tick [s]
_BLOCK = 16_384  # instants sampled at a time


@dataclass(frozen=True)
class Followed:
    """The plans that a walk followed, one after another.

    A plan holds from the tick after it was made. Off its plan, the stabiliser that steps has planned each
    tick before it sensed the state of this tick, see :mod:`ampm.stepping.planned`.

    Attributes:
        plans: of the planner, the first one first.
        since: first tick of each of them [s].
        stepped: what the stabiliser planned, a tick each, in turn.
        tick: control period [s].
    """

    plans: tuple[WalkPlan, ...]
    since: tuple[float, ...] = (0.0,)
    stepped: tuple[PlannedTick, ...] = ()
    tick: float = 0.0

    @property
    def moved(self) -> bool:
        """Whether there was any plan after the first one."""
        return len(self.plans) > 1 or bool(self.stepped)

    @property
    def changes(self) -> int:
        """Number of plans after the first one; the stabiliser's counts once each time that it leaves."""
        left = 0
        if self.stepped:
            left = 1 + int(np.count_nonzero(np.diff(self._rows.time) > 1.5 * self.tick))
        return len(self.plans) - 1 + left

    def numbers(self, times: Array) -> NDArray[np.int32]:
        """Number of the plan then valid, 0 the first one, :data:`STEPPING` the stabiliser's; shape (N,)."""
        number = np.searchsorted(self.since, times + _SAME, side="right") - 1
        if self.stepped:
            ticks = self._rows.time
            row = self._tick_of(times)
            number[(row >= 0) & (times + _SAME < ticks[row] + self.tick)] = STEPPING
        return number.astype(np.int32)

    def sample(self, times: Array) -> PlanSample:
        """The plan then valid at ascending times, shape (N,) [s]; a plan that has ended stays at its end."""
        parts = [
            self._sample_stepped(part) if plan is None else plan.sample(np.minimum(part, plan.duration))
            for plan, part in self._parts(times)
        ]
        if not self.moved:
            return parts[0]
        columns = {
            item.name: np.concatenate([getattr(part, item.name) for part in parts])
            for item in fields(PlanSample)
        }
        return PlanSample(**{**columns, "time": times.copy()})

    def feet(self, times: Array) -> Array:
        """Reference points of both soles, left first, shape (N, 6) [m]."""
        return self._values(
            times,
            lambda plan, part: np.hstack([foot.position for foot in plan.feet.sample(part)]),
            lambda stepped: stepped.feet.reshape(-1, 6),
        )

    def headings(self, times: Array) -> Array:
        """Yaw of both feet, left first; off the plan that of the standing foot, shape (N, 2) [rad]."""
        return self._values(
            times,
            lambda plan, part: np.column_stack([foot.heading for foot in plan.feet.sample(part)]),
            lambda stepped: np.column_stack([stepped.heading, stepped.heading]),
        )

    def momentum_z(self, times: Array) -> Array:
        """L_z of the planned posture, shape (N,) [N m s]."""
        return self._values(
            times,
            lambda plan, part: plan.posture.sample(part).angular_momentum_z,
            lambda stepped: stepped.angular_momentum[:, 2],
        )

    def zmp_margin(self, times: Array) -> Array:
        """See :meth:`StepPlan.zmp_margin`; NaN where the stabiliser steps, whose support is not planned."""
        return self._values(
            times,
            lambda plan, part: plan.zmp_margin(part),
            lambda stepped: np.full(len(stepped.time), np.nan),
        )

    def least_zmp_margin(self, times: Array) -> tuple[float, float]:
        """Least of :meth:`zmp_margin` and its time; of a plan that moved at these times, shape (N,) [s]."""
        if not self.moved:
            plan = self.plans[0]
            return plan.least_zmp_margin(min(float(times[-1]), plan.duration))
        margin = self.zmp_margin(times)
        if np.isnan(margin).all():
            return float("nan"), float(times[0])
        worst = int(np.nanargmin(margin))
        return float(margin[worst]), float(times[worst])

    def _parts(self, times: Array, most: int = sys.maxsize) -> Iterator[tuple[WalkPlan | None, Array]]:
        """Stretches of one plan, None where the stabiliser steps, and their times, ``most`` at once."""
        number = self.numbers(times)
        changes = np.flatnonzero(np.diff(number)) + 1
        starts = {0, *changes.tolist(), *range(0, len(times), most)}
        for start, end in pairwise([*sorted(starts), len(times)]):
            valid = int(number[start]) if end > start else 0
            yield None if valid == STEPPING else self.plans[valid], times[start:end]

    def _values(
        self,
        times: Array,
        planned: Callable[[WalkPlan, Array], Array],
        stepped: Callable[[PlannedTick], Array],
    ) -> Array:
        """Values of the plan then valid, or of the stabiliser's ticks; a plan that has ended stays there."""
        values = [
            stepped(self._between(part)) if plan is None else planned(plan, np.minimum(part, plan.duration))
            for plan, part in self._parts(times, _BLOCK)
        ]
        return np.concatenate(values)

    # ------------------------------------------------------------------ the stabiliser that steps

    @cached_property
    def _rows(self) -> PlannedTick:
        """All its ticks as arrays."""
        return PlannedTick(*(np.array(column) for column in zip(*self.stepped, strict=True)))

    def _tick_of(self, times: Array) -> NDArray[np.intp]:
        """Its last tick up to every instant, -1 before the first one, shape (N,)."""
        return np.searchsorted(self._rows.time, times + _SAME, side="right") - 1

    def _between(self, times: Array) -> PlannedTick:
        """Its plan at instants within its ticks: on straight lines to the next tick."""
        ticks, row = self._rows, self._tick_of(times)
        ahead = np.minimum(row + 1, len(ticks.time) - 1)
        goes_on = ticks.time[ahead] - ticks.time[row] < 1.5 * self.tick
        share = np.where(goes_on, (times - ticks.time[row]) / self.tick, 0.0)

        def at(column: Array) -> Array:
            part = share.reshape(-1, *[1] * (column.ndim - 1))
            return np.asarray((1.0 - part) * column[row] + part * column[ahead])

        found = PlannedTick(*map(at, ticks))
        return found._replace(time=times, stance=ticks.stance[row], placements=ticks.placements[row])

    def _sample_stepped(self, times: Array) -> PlanSample:
        """Its plan at instants within its ticks."""
        at, plan = self._between(times), self.plans[0]
        weight = np.array([0.0, 0.0, plan.weight])
        frequency = np.sqrt(plan.gravity / plan.com_height)
        return PlanSample(
            time=times,
            phase=np.asarray(at.stance == 2, dtype=np.int8),
            stance=np.asarray(at.stance, dtype=np.int8),
            com=at.com,
            com_velocity=at.com_velocity,
            com_acceleration=at.com_acceleration,
            dcm=(at.com + at.com_velocity / frequency)[:, :2],
            zmp=at.zmp,
            floor=np.asarray(at.floor),
            force=plan.mass * at.com_acceleration + weight,
            moment=at.moment,
            angular_momentum=at.angular_momentum[:, :2],
            left_placement=at.placements[:, 0],
            right_placement=at.placements[:, 1],
            heading=np.asarray(at.heading),
        )

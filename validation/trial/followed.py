"""What a walk's plans said, kept as arrays from the moment at which each of them was handed over.

Controller and judge use these arrays only: what a plan object answers later has no effect. An instant t is
compared with the plan as it stood at t - lead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.trial.frozen_plan import FrozenPlan, PlanRows
from validation.trial.stepped import Stepped

if TYPE_CHECKING:
    from ampm.stepping.tracker import SteppedTick


LEADS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""How long before an instant the plan stood that it is compared with [s]."""
JUDGED_LEAD = 0.1
"""The one of them by which a walk is judged whose plan moved [s]."""
STEPPING = -1
"""Number of the plan of the stabiliser that steps, see :attr:`SimulationRecord.tick_plan`."""
_SAME = 1e-9  # time before a tick that counts as the tick [s]


@dataclass(frozen=True)
class Followed:
    """The plans that a walk followed, one after another.

    A plan holds from the tick after it was made. Off its plan, the stabiliser that steps has planned each
    tick before it sensed the state of this tick, see :mod:`validation.trial.stepped`.

    Attributes:
        plans: of the planner, the first one first.
        since: first tick of each of them [s].
        stepped: states of the stabiliser, a tick each, in turn.
        tick: control period [s].
    """

    plans: tuple[FrozenPlan, ...]
    since: tuple[float, ...] = (0.0,)
    stepped: tuple[SteppedTick, ...] = ()
    tick: float = 0.0

    @property
    def moved(self) -> bool:
        """Whether there was any plan after the first one."""
        return len(self.plans) > 1 or bool(self.stepped)

    @property
    def lead(self) -> float:
        """How long before an instant the plan stood by which the walk is judged [s]."""
        return JUDGED_LEAD if self.moved else 0.0

    @property
    def changes(self) -> int:
        """Number of plans after the first one; the stabiliser's counts once each time that it leaves."""
        left = 0
        if self.stepped:
            left = 1 + int(np.count_nonzero(np.diff(self._steps.time) > 1.5 * self.tick))
        return len(self.plans) - 1 + left

    def numbers(self, times: Array) -> NDArray[np.int32]:
        """Number of the plan valid at times, 0 the first one, :data:`STEPPING` the stabiliser's; (N,)."""
        number = self._planner(times)
        if self.stepped:
            ticks, row = self._steps.time, self._steps.tick_of(times)
            number[(row >= 0) & (times + _SAME < ticks[row] + self.tick)] = STEPPING
        return number.astype(np.int32)

    def at(self, times: Array, lead: float = 0.0) -> PlanRows:
        """What the plan that was valid a while before said of ascending times.

        Args:
            times: shape (N,) [s].
            lead: how long before each of them the plan stood [s]. Before the walk the first plan stands.
        """
        made = np.maximum(times - lead, 0.0)
        number, planner = self.numbers(made), self._planner(made)
        changes = np.flatnonzero((np.diff(number) != 0) | (np.diff(planner) != 0)) + 1
        parts = []
        for start, end in pairwise([0, *changes.tolist(), len(times)]):
            plan = self.plans[planner[start] if end > start else 0]
            if end > start and number[start] == STEPPING:
                parts.append(self._steps.at(times[start:end], made[start:end], plan))
            else:
                parts.append(plan.rows.at(times[start:end]))
        return PlanRows.joined(parts)

    def _planner(self, times: Array) -> NDArray[np.intp]:
        """Number of the planner's last plan at times, shape (N,)."""
        return np.searchsorted(self.since, times + _SAME, side="right") - 1

    @cached_property
    def _steps(self) -> Stepped:
        return Stepped.of(self.stepped)

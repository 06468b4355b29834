"""What a walk's plans said, kept as arrays from the moment at which each of them was handed over.

Controller and judge use these arrays only: what a plan object answers later has no effect. An instant t is
compared with the plan as it stood at t - lead.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.geometry import polygon_margin
from ampm.planner.centroidal import PlanSample
from validation.trial import spill
from validation.trial.stepped import Stepped

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ampm.stepping.follower import SteppedTick
    from ampm.walk import WalkPlan

    Array = NDArray[np.float64]

LEADS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""How long before an instant the plan stood that it is compared with [s]."""
JUDGED_LEAD = 0.1
"""The one of them by which a walk is judged whose plan moved [s]."""
STEPPING = -1
"""Number of the plan of the stabiliser that steps, see :attr:`SimulationRecord.tick_plan`."""
_SAME = 1e-9  # time before a tick that counts as the tick [s]
_SAMPLED = tuple(item.name for item in fields(PlanSample))
_HELD = ("phase", "stance", "left_placement", "right_placement", "heading", "contact")
"""Columns that hold from one instant to the next; others go on along a straight line."""


@dataclass(frozen=True)
class PlanRows:
    """Columns of a plan at N ascending instants.

    Attributes:
        columns: those of a :class:`PlanSample` by name; ``feet``, reference points of both soles, left first,
            shape (N, 6) [m]; ``headings`` of both feet (N, 2) [rad]; ``momentum_z``, L_z of the posture, (N,)
            [N m s]; ``points``, all twelve sole points, (N, 12, 2) [m], and ``contact``, which of them are in
            contact, (N, 12); NaN points where the support is not planned.
    """

    columns: Mapping[str, NDArray[Any]]

    @classmethod
    def of(cls, plan: WalkPlan, times: Array) -> PlanRows:
        """Sample a plan, a block at a time; a plan that has ended stays at its end."""
        columns: dict[str, NDArray[Any]] = {}
        for rows in spill.blocks(len(times)):
            part = _sampled(plan, np.minimum(times[rows], plan.duration))
            for name, values in part.items():
                if len(values) == len(times):
                    columns[name] = values
                    continue
                if name not in columns:
                    columns[name] = spill.zeros((len(times), *values.shape[1:]), values.dtype)
                columns[name][rows] = values
        columns["time"] = times.copy()
        return cls(columns)

    def __post_init__(self) -> None:
        for values in self.columns.values():
            values.setflags(write=False)

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name == "columns" or name not in self.columns:
            raise AttributeError(name)
        return self.columns[name]

    @cached_property
    def sample(self) -> PlanSample:
        """COM, ZMP, force and momentum."""
        return PlanSample(**{name: self.columns[name] for name in _SAMPLED})

    @cached_property
    def zmp_margin(self) -> Array:
        """See :meth:`StepPlan.zmp_margin`; NaN where the support is not planned."""
        margin = np.empty(len(self.time))
        for rows in spill.blocks(len(margin)):
            margin[rows] = polygon_margin(self.points[rows], self.contact[rows], self.zmp[rows])
        margin = np.where(self.contact.any(axis=1), margin, -np.inf)
        return np.where(np.isnan(self.points[:, 0, 0]), np.nan, margin)

    def at(self, times: Array) -> PlanRows:
        """Rows at times (M,) [s], between two instants on a straight line, outside at the first or last."""
        own = self.time
        if np.array_equal(times, own[: len(times)]):
            return PlanRows({name: values[: len(times)] for name, values in self.columns.items()})
        row = np.searchsorted(own, times + _SAME, side="right") - 1
        row = row.clip(0, len(own) - 1)
        ahead = np.minimum(row + 1, len(own) - 1)
        share = np.clip((times - own[row]) / np.where(ahead > row, own[ahead] - own[row], 1.0), 0.0, 1.0)

        def between(name: str, values: NDArray[Any]) -> NDArray[Any]:
            if name in _HELD:
                return values[row]
            part = share.reshape(-1, *[1] * (values.ndim - 1))
            return (1.0 - part) * values[row] + part * values[ahead]

        columns = {name: between(name, values) for name, values in self.columns.items()}
        return PlanRows(columns | {"time": times.copy()})

    def until(self, end: float) -> PlanRows:
        """The rows up to a time and the one after it, without the memory of the others."""
        rows = slice(int(np.searchsorted(self.time, end)) + 1)
        return PlanRows({name: values[rows].copy() for name, values in self.columns.items()})

    @staticmethod
    def joined(parts: list[PlanRows]) -> PlanRows:
        """Rows one after another."""
        if len(parts) == 1:
            return parts[0]
        return PlanRows(
            {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns}
        )


def _sampled(plan: WalkPlan, times: Array) -> dict[str, NDArray[Any]]:
    """Columns of :class:`PlanRows`."""
    sample, feet = plan.sample(times), plan.feet.sample(times)
    return {
        **{name: np.array(getattr(sample, name)) for name in _SAMPLED},
        "feet": np.hstack([foot.position for foot in feet]),
        "headings": np.column_stack([foot.heading for foot in feet]),
        "momentum_z": np.array(plan.posture.sample(times).angular_momentum_z),
        "points": np.concatenate([foot.sole_points[:, :, :2] for foot in feet], axis=1),
        "contact": np.concatenate([foot.contact.repeat(2, axis=1) for foot in feet], axis=1),
    }


@dataclass(frozen=True)
class FrozenPlan:
    """A plan as it was when it was handed over.

    Attributes:
        plan: for its constants and contacts; it is not sampled again.
        rows: what it said, from when it was handed over on.
        least_zmp_margin: of its ZMP in its support [m], and when [s]; None if that was not asked.
    """

    plan: WalkPlan
    rows: PlanRows
    least_zmp_margin: tuple[float, float] | None = None

    @classmethod
    def of(cls, plan: WalkPlan, times: Array) -> FrozenPlan:
        """A plan at ascending times, shape (N,) [s], and its least margin up to the last one."""
        until = min(float(times[-1]), plan.duration) if times.size else 0.0
        return cls(plan, PlanRows.of(plan, times), plan.least_zmp_margin(until))

    def until(self, end: float) -> FrozenPlan:
        """Only what it said up to a time [s]."""
        return replace(self, rows=self.rows.until(end))


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
                parts.append(PlanRows(self._steps.at(times[start:end], made[start:end], plan)))
            else:
                parts.append(plan.rows.at(times[start:end]))
        return PlanRows.joined(parts)

    def _planner(self, times: Array) -> NDArray[np.intp]:
        """Number of the planner's last plan at times, shape (N,)."""
        return np.searchsorted(self.since, times + _SAME, side="right") - 1

    @cached_property
    def _steps(self) -> Stepped:
        return Stepped.of(self.stepped)

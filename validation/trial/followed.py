"""What a walk's plans said, kept as checked, read-only arrays from when each of them was handed over.

Controller and judge use these arrays only: what a plan object answers later has no effect. An instant t is
compared with the plan as it stood at t - lead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array, blocks
from ampm.planner.centroidal import PlanSample
from ampm.planner.newton import ALLOWED, check_newton, zmp_of_com
from ampm.stepping.phases import Phases, forecast
from ampm.walk import WalkPlan

SAME = 1e-9  # time before an instant that counts as the instant [s]
_HELD = ("phase", "stance", "left_placement", "right_placement", "heading")
"""Columns that hold from one row to the next; others go on along a straight line."""
LEADS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Leads: each instant is compared with the plan as it stood this long before [s]."""
JUDGED_LEAD = 0.1
"""The lead by which a walk is judged if its plan moved [s]."""
STEPPING = -1
"""Number of the plan of the stabiliser that steps, see :attr:`SimulationRecord.tick_plan`."""


@dataclass(frozen=True)
class PlanRows(PlanSample):
    """What a plan says of N ascending instants, with feet and posture."""

    feet: Array  # reference points of both soles, left first, shape (N, 6) [m]
    headings: Array  # of both feet, shape (N, 2) [rad]
    momentum_z: Array  # L_z of the posture, shape (N,) [N m s]
    zmp_margin: Array  # see :meth:`StepPlan.zmp_margin`, NaN where no support is planned, shape (N,) [m]

    @classmethod
    def of(cls, plan: WalkPlan, times: Array) -> PlanRows:
        """Sample a plan; one that has ended stays at its end."""
        parts = []
        for rows in blocks(len(times)):
            at = np.minimum(times[rows], plan.duration)
            sample, feet = vars(plan.sample(at)), plan.feet.sample(at)
            part = cls(
                **{name: np.array(values) for name, values in sample.items()} | {"time": times[rows].copy()},
                feet=np.hstack([foot.position for foot in feet]),
                headings=np.column_stack([foot.heading for foot in feet]),
                momentum_z=np.array(plan.posture.sample(at).angular_momentum_z),
                zmp_margin=plan.zmp_margin(at),
            )
            parts.append(part)
        return cls.joined(parts)

    def without_plan(self, stance: NDArray[np.int8]) -> PlanRows:
        """NaN for all that is planned, and what stands, shape (N,), in place of the planned stance."""
        unknown = {name: np.full(values.shape, np.nan) for name, values in vars(self).items()}
        known = {"time": self.time, "stance": stance, "phase": (stance == 2).astype(np.int8)}
        return PlanRows(**unknown | known)

    def at(self, times: Array) -> PlanRows:
        """Rows at times (M,) [s], between two instants on a straight line, outside at the first or last."""
        own = self.time
        if np.array_equal(times, own[: len(times)]):
            return PlanRows(**{name: values[: len(times)] for name, values in vars(self).items()})
        row = (np.searchsorted(own, times + SAME, side="right") - 1).clip(0, len(own) - 1)
        ahead = np.minimum(row + 1, len(own) - 1)
        share = np.clip((times - own[row]) / np.where(ahead > row, own[ahead] - own[row], 1.0), 0.0, 1.0)

        def between(name: str, values: NDArray[Any]) -> NDArray[Any]:
            if name in _HELD:
                return values[row]
            part = share.reshape(-1, *[1] * (values.ndim - 1))
            return (1.0 - part) * values[row] + part * values[ahead]

        found = {name: between(name, values) for name, values in vars(self).items()}
        return PlanRows(**found | {"time": times.copy()})

    def until(self, end: float) -> PlanRows:
        """The rows up to a time and the one after it, without the memory of the others."""
        rows = slice(int(np.searchsorted(self.time, end)) + 1)
        return PlanRows(**{name: values[rows].copy() for name, values in vars(self).items()})

    @staticmethod
    def joined(parts: list[PlanRows]) -> PlanRows:
        """Rows one after another."""
        if len(parts) == 1:
            return parts[0]
        names = vars(parts[0])
        return PlanRows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


@dataclass(frozen=True)
class FrozenPlan:
    """A plan as it was when it was handed over."""

    plan: WalkPlan  # for its constants and contacts; it is not sampled again
    rows: PlanRows  # its samples from the hand-over on
    newton_residual: float  # largest, see `ampm.planner.newton` [m]
    # least distance of its ZMP into the support [m], and its time [s]; None of a later plan
    least_zmp_margin: tuple[float, float] | None = None
    since: float = 0.0  # first tick at which it held [s]

    @classmethod
    def of(cls, plan: WalkPlan, times: Array, since: float = 0.0) -> FrozenPlan:
        """Sample a plan at ascending times (N,) [s]; raises InputError if it contradicts itself."""
        margin = None if since else plan.least_zmp_margin(min(float(times[-1]), plan.duration))
        rows, residual = PlanRows.of(plan, times), check_newton(plan)
        off = np.abs(zmp_of_com(rows) - rows.zmp).max(axis=1)
        off[~np.isfinite(rows.angular_momentum).all(axis=1)] = np.inf
        if not off[times >= plan.phases[0].start].max(initial=0.0) <= ALLOWED:  # also NaN
            raise InputError(
                "the plan contradicts itself when it is sampled again: its ZMP differs from that of its COM, "
                "or is no number; let what it says depend on the times alone."
            )
        return cls(plan, rows, residual, margin, since)


@dataclass(frozen=True)
class Followed:
    """The plans that a walk followed, one after another.

    A plan holds from the tick after it was made. Off its plan, the stabiliser that steps has planned each
    tick before it sensed the state of this tick.
    """

    plans: tuple[FrozenPlan, ...]  # of the planner, the first one first
    stepped: Any = ()  # states of the stabiliser off the plan, entries of `SteppingState`, shape (N,)
    tick: float = 0.0  # control period [s]

    @property
    def moved(self) -> bool:
        """Whether there was any plan after the first one."""
        return len(self.plans) > 1 or len(self.stepped) > 0

    @property
    def lead(self) -> float:
        """The lead by which the walk is judged [s]."""
        return JUDGED_LEAD if self.moved else 0.0

    @property
    def changes(self) -> int:
        """Number of plans after the first one; the stabiliser's counts once each time that it leaves."""
        left = 0
        if len(self.stepped):
            left = 1 + int(np.count_nonzero(np.diff(self.stepped["time"]) > 1.5 * self.tick))
        return len(self.plans) - 1 + left

    def numbers(self, times: Array) -> NDArray[np.int32]:
        """Number of the plan valid at times, 0 the first one, :data:`STEPPING` the stabiliser's; (N,)."""
        number = self.of_planner(times)
        if len(self.stepped):
            ticks = self.stepped["time"]
            row = _last(ticks, times)
            number[(row >= 0) & (times + SAME < ticks[row] + self.tick)] = STEPPING
        return number.astype(np.int32)

    def at(self, times: Array, lead: float = 0.0) -> PlanRows:
        """The plan at ascending times (N,) [s], as it stood ``lead`` [s] before each of them.

        Before the walk the first plan stands.
        """
        made = np.maximum(times - lead, 0.0)
        number, of_planner = self.numbers(made), self.of_planner(made)
        changes = np.flatnonzero((np.diff(number) != 0) | (np.diff(of_planner) != 0)) + 1
        parts = []
        for start, end in pairwise([0, *changes.tolist(), len(times)]):
            plan = self.plans[of_planner[start] if end > start else 0]
            if end > start and number[start] == STEPPING:
                parts.append(self._stepping(times[start:end], made[start:end], plan))
            else:
                parts.append(plan.rows.at(times[start:end]))
        return PlanRows.joined(parts)

    def of_planner(self, times: Array) -> NDArray[np.intp]:
        """Number of the planner's last plan at times (N,) [s], also off it; an index of ``plans``, (N,)."""
        return _last(np.array([plan.since for plan in self.plans]), times)

    def _stepping(self, times: Array, made: Array, frozen: FrozenPlan) -> PlanRows:
        """The stabiliser's plan at ``times``, as it was at the last tick up to ``made``, both (M,) [s].

        It is the plan of the phase, at the phase's own clock and moved with the feet. It has no support, and
        no footsteps ahead.
        """
        plan, every = frozen.plan, np.arange(len(times))
        state = self.stepped[_last(self.stepped["time"], made)].view(np.recarray)
        phases = Phases.of(plan.contacts, frozen.rows.com_velocity[-1])
        at, feet_shift, com_shift, com_rate = forecast(state, phases, times)
        rows, rate = frozen.rows.at(at), state.clock_rate[:, None]
        feet = rows.feet.reshape(-1, 2, 3) + feet_shift
        com, velocity = rows.com + com_shift, rate * rows.com_velocity + com_rate
        heading, omega = rows.headings[every, state.stance], np.sqrt(plan.gravity / plan.com_height)
        return replace(
            rows,
            time=times.copy(),
            phase=(~state.single).astype(np.int8),
            stance=np.where(state.single, state.stance, 2).astype(np.int8),
            com=com,
            com_velocity=velocity,
            dcm=(com + velocity / omega)[:, :2],
            zmp=rows.zmp + com_shift[:, :2],
            floor=np.where(state.single, feet[every, state.stance, 2], feet[:, :, 2].mean(axis=1)),
            force=plan.mass * (rows.com_acceleration + np.array([0.0, 0.0, plan.gravity])),
            moment=rate * rows.moment,
            left_placement=np.full((len(times), 2), np.nan),
            right_placement=np.full((len(times), 2), np.nan),
            feet=feet.reshape(-1, 6),
            headings=np.column_stack([heading, heading]),
            zmp_margin=np.full(len(times), np.nan),
        )


def _last(instants: Array, times: Array) -> NDArray[np.intp]:
    """Last of some ascending instants up to every time, -1 before the first one, shape (M,)."""
    return np.searchsorted(instants, times + SAME, side="right") - 1

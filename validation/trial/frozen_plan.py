"""A plan as read-only arrays, sampled and checked when it is handed over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array, blocks
from ampm.planner.centroidal import PlanSample
from ampm.planner.newton import ALLOWED, check_newton, zmp_of_com
from ampm.walk import WalkPlan

SAME = 1e-9  # time before an instant that counts as the instant [s]
_HELD = ("phase", "stance", "left_placement", "right_placement", "heading")
"""Columns that hold from one row to the next; others go on along a straight line."""


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
        known = {"time": self.time, "stance": stance, "phase": (stance == 2).astype(np.int8)}
        unknown = {name: np.full(values.shape, np.nan) for name, values in vars(self).items()}
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
    # least distance of its ZMP into the support [m], and its time [s]; None if not asked for
    least_zmp_margin: tuple[float, float] | None = None

    @classmethod
    def of(cls, plan: WalkPlan, times: Array, *, exact: bool = True) -> FrozenPlan:
        """Sample a plan at ascending times (N,) [s]; raises InputError if it contradicts itself.

        ``exact`` asks for its least margin, which lies between the instants.
        """
        until = min(float(times[-1]), plan.duration)
        margin = plan.least_zmp_margin(until) if exact else None
        rows, residual = PlanRows.of(plan, times), check_newton(plan)
        off = np.abs(zmp_of_com(rows) - rows.zmp).max(axis=1)
        off[~np.isfinite(rows.angular_momentum).all(axis=1)] = np.inf
        if not off[times >= plan.phases[0].start].max(initial=0.0) <= ALLOWED:  # also NaN
            raise InputError(
                "the plan contradicts itself when it is sampled again: its ZMP differs from that of its COM, "
                "or is no number; let what it says depend on the times alone."
            )
        return cls(plan, rows, residual, margin)

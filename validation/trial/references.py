"""The plans that a walk follows, one after another, and their references at its control ticks."""

import copy
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.contacts import TIME_TOLERANCE, Contacts
from ampm.planner.plan_checks import ASIDE, check_contacts, check_duration, check_footsteps
from ampm.reference import Reference, Timing
from ampm.walk import Controller, Replanner, State, Touch, WalkPlan
from validation.trial.followed import LEADS, FrozenPlan
from validation.trial.physics import Physics
from validation.trial.users import UsersCode, planner_problem, replan_period
from validation.trial.users_plan import check_judged

_CHECKED = ("com", "com_velocity", "com_acceleration", "foot_position", "q", "v", "acceleration")
_SAME_ACCELERATION = 1e-6  # of COM, feet and joints in two plans [m/s^2, rad/s^2]
_NEXT = 3  # phases of a new plan in which the ZMP is checked: what is planned for later will change
_OUTSIDE = 0.1  # most distance of its ZMP from the support [m]: after a push a ZMP inside may not suffice
_LATE = 0.02  # most time from asking for a plan to its begin [s]: a row of samples at 50 Hz


class References:
    """What a walk follows, and when it ends: the plan in force at each control tick.

    A plan is sampled when it is handed over, for all of the walk, and not later. Without ``steps`` all of the
    plan in force is walked. The planner goes on planning from what the controller senses; the controller
    gets every plan, if it has ``follow``.

    Attributes:
        total: steps of the physics until it ends.
        step_ends: when each walking step ends, shape (steps,) [s].
        references: one for each control tick.
        timing: look-ahead of the references.
        plans: all of them so far, as they were handed over; the last one is followed from the next tick on.
        tick: control period [s].
        table: references of all ticks of the plan followed last.
    """

    table: Reference
    step_ends: Array

    def __init__(
        self,
        plan: WalkPlan,
        run: RunParameters,
        physics: Physics,
        *,
        steps: int | None = None,
        planner: Replanner | None = None,
        controller: Controller | None = None,
    ) -> None:
        self.time_step, self.substeps, gains = physics.time_step, physics.substeps, run.controller
        self.tick = self.substeps * self.time_step
        self.timing = Timing(
            lead=gains.touchdown_lead,
            early=gains.touchdown_window,
            hold=(self.substeps - 1) * self.time_step,
            extrapolation=self.tick if gains.hold == "first-order" else 0.0,
        )
        self.steps, self.run = steps, run
        self.planner, self.controller = planner, controller
        self.period, self._due = replan_period(planner), 0.0
        self.plans: list[FrozenPlan] = []
        self._tick = self._first = 0  # the next tick, and the first one of the table
        self._last: Reference | None = None
        self.references: Iterator[Reference] = self._walk()
        self.follow(plan)

    def follow(self, plan: WalkPlan) -> None:
        """Go on with another plan from the next tick on."""
        self.step_ends = plan.contacts.step_ends[: self.steps]
        self.total = total = math.floor(self.step_ends[-1] / self.time_step + 1e-9)
        ticks = np.arange(self._tick * self.substeps, total, self.substeps)
        if not ticks.size:  # the walk ends here
            return
        by = ("planner", self.planner) if self.planner else ("plan with the posture", type(plan.posture))
        with UsersCode(*by, walking=bool(self.plans)):
            self.table = self._sampled(plan, ticks)
            instants = ticks if self.plans else np.arange(total)
            frozen = FrozenPlan.of(plan, instants * self.time_step, self._tick * self.tick)
        if len(self.plans) > 1:  # the first one is compared with the others to the end
            end = self._tick * self.substeps * self.time_step + max(LEADS)
            self.plans[-1] = replace(self.plans[-1], rows=self.plans[-1].rows.until(end))
        self.plans.append(frozen)
        self._first = self._tick
        if self.controller is not None and hasattr(self.controller, "follow"):
            with UsersCode("controller", self.controller, walking=True):
                self.controller.follow(plan, self.timing)

    def part(self, tick: int) -> "References":
        """The first plan from a tick on, as a walk that begins there and is not planned again."""
        part, passed = copy.copy(self), tick * self.substeps
        part.planner, part.references = None, iter(self.table[tick:])
        part.total, part.step_ends = self.total - passed, self.step_ends - passed * self.time_step
        return part

    def replan(self, time: float, state: State, touch: Touch) -> None:
        """After a tick: ask the planner where it is due, and follow what it makes from the next tick on."""
        if self.planner is None or time + 1e-9 < self._due:
            return
        if self.period:
            self._due = (math.floor(time / self.period + 1e-9) + 1) * self.period
        valid = self.plans[-1].plan
        with UsersCode("planner", self.planner, walking=True):
            plan = self.planner.replan(time, state, touch, valid)
            if plan is None or plan is valid:
                return
            if not isinstance(plan, WalkPlan):
                raise TypeError(f"replan at {time:g} s made {planner_problem(plan)}; None keeps the plan")
            if not plan.duration >= time:
                raise ValueError(f"the plan made at {time:g} s ends at {plan.duration:g} s; plan beyond now")
            if not (begin := plan.phases[0].start) <= time + _LATE + 1e-9:
                raise ValueError(f"the plan made at {time:g} s begins at {begin:g} s; plan from now on")
            check_judged(plan)
            # Two footsteps are stood on at first. A plan may add steps, and a later one leave them out again.
            due = len(self.run.footsteps) - 2 if self.steps is None else len(self.step_ends)
            if plan.contacts.steps < due:
                raise ValueError(
                    f"the plan made at {time:g} s has {plan.contacts.steps} of the walk's {due} steps"
                )
            _check_past(plan.contacts, valid.contacts, time)
            check_contacts(plan, time, _NEXT, _OUTSIDE)
            check_footsteps(plan.contacts, self.run, later=True)
            check_duration(plan.contacts, float(plan.contacts.step_ends[: self.steps][-1]), self.run)
        self.follow(plan)

    def _walk(self) -> Iterator[Reference]:
        """The references, as long as the plan in force goes on."""
        while self._tick * self.substeps < self.total:
            self._last = self.table[self._tick - self._first]
            self._tick += 1
            yield self._last

    def _sampled(self, plan: WalkPlan, ticks: NDArray[np.intp]) -> Reference:
        """References of some ticks, given as steps of the physics; refused if one is not a number."""
        first = max(ticks[0] - self.substeps, 0)  # rates of change need the tick before
        steps = np.arange(first, ticks[-1] + 1, self.substeps)
        table = plan.table(steps * self.time_step, self.timing)
        for name in _CHECKED:
            if not np.isfinite(table.row[name]).all():
                raise ValueError(
                    f"'{name}' of its plan from {table[0].time:g} s on has an entry that is not a number"
                )
        if (old := self._last) is not None and any(  # in acceleration, where the plan takes over
            np.abs(table[0].row[name] - old.row[name]).max() > _SAME_ACCELERATION
            for name in ("com_acceleration", "foot_acceleration", "acceleration")
        ):
            table = table.replace(jumps=np.r_[False, True, table.jumps[2:]])
        return table[len(steps) - len(ticks) :]


def _check_past(new: Contacts, old: Contacts, time: float) -> None:
    """Refuse a later plan with other supports up to its time [s] than the plan in force, by a ValueError.

    A foot may stand somewhat aside of where it was planned.
    """
    number, planned = (int(np.searchsorted(one.starts, time - TIME_TOLERANCE)) for one in (new, old))
    stance = old.stance_codes
    same = number == planned and np.array_equal(new.stance_codes[:number], stance[:number])
    if same:
        stands = np.stack([stance[:number] != 1, stance[:number] != 0], axis=1)  # left and right
        same = np.abs(new.placements[:number] - old.placements[:number])[stands].max(initial=0.0) <= ASIDE
    if not same:
        raise ValueError(f"the plan made at {time:g} s has other supports up to then than the plan in force")

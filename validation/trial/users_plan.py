"""What the plan of a user's planner is held to: model, floor, contacts, and the steps and times of its run.

The checks raise a ValueError, which the caller turns into a sentence with the planner's name.
"""

import math
from contextlib import suppress
from typing import Any

import numpy as np
import pinocchio as pin

from ampm.body.robot import Robot
from ampm.exceptions import RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.contacts import Contacts
from ampm.planner.footstep_walk import REST
from ampm.planner.periodic import plan_gait
from ampm.planner.rest_to_rest import SETTLING
from ampm.planner.support import check_contacts
from ampm.walk import WalkPlan
from validation.trial.users import real_numbers

FOOTSTEP_TOLERANCE, ASIDE = 1e-3, 0.2
"""Distance up to which a planner steps on a footstep, and when it plans again, as a push may ask for [m]."""
# Shares by which a planner's steps may differ from the gait's without a word; those of lipm are 12 % longer.
_SAME_LENGTH, _SAME_DURATION = 0.05, 0.15
_SAME_HEADING, _SAME_TIME = 0.2, 0.1  # most difference of a footstep's heading and landing [rad, s]
_UNIT, _COM_OFF = 1e-6, 5e-3  # largest errors of its posture's quaternion and COM at 0 s [1, m]
_LONGEST = 1.5  # most time of a planner's walk over that of the run's durations [1]


def check_steps(plan: WalkPlan, run: RunParameters, *, is_table: bool, goes_on: bool) -> str:
    """Refuse a plan of other footsteps, fewer steps or more time than its run's.

    Returns words for another length or duration of its steps; empty if they are alike.
    """
    contacts, wanted = plan.contacts, run.gait.steps
    ahead = goes_on and not run.footsteps  # what a replanner has planned beyond its steps is not walked
    until = float(contacts.step_ends[:wanted][-1]) if ahead else contacts.duration
    if is_table:
        check_duration(contacts, until, None)
        return ""
    check_footsteps(plan, run)
    check_duration(contacts, until, run)
    if run.footsteps:
        if len(contacts.footsteps) > len(run.footsteps):
            raise ValueError(
                f"it plans {len(contacts.footsteps)} footsteps, and the run has {len(run.footsteps)}"
            )
        return ""
    if contacts.steps < wanted:
        raise ValueError(
            f"it plans {contacts.steps} of the {wanted} steps of gait.steps; plan all, or lower it"
        )
    along = np.abs(np.diff([step.position[0] for step in contacts.footsteps[: wanted + 2]]))
    length, given = float(np.median(along)), run.gait.step_length
    if not math.isclose(length, given, rel_tol=_SAME_LENGTH):
        return f"steps of {length:.3g} m, and gait.step_length is {given:.3g} m"
    single, double = _durations(contacts, run)
    duration = float(np.median(np.diff(contacts.step_ends[:wanted], prepend=0.0)))
    if not math.isclose(duration, single + double, rel_tol=_SAME_DURATION):
        return f"steps of {duration:.3g} s, and those of the gait take {single + double:.3g} s"
    return ""


def check_footsteps(plan: WalkPlan, run: RunParameters, *, later: bool = False) -> None:
    """Refuse a plan that does not step on the footsteps of its run, by a ValueError.

    A later plan may step aside, and land at other times. A run without footsteps has none off its floor: the
    floor of the simulation is where the plan steps.
    """
    planned, within = plan.contacts.footsteps, ASIDE if later else FOOTSTEP_TOLERANCE
    landings = [p.start + p.duration for p in plan.contacts.phases if p.kind == "single_support"]
    if not run.footsteps and any(abs(step.position[2]) > FOOTSTEP_TOLERANCE for step in planned):
        raise ValueError("it steps off the floor of its run, which has no footsteps; plan all at z = 0")
    if len(planned) < len(run.footsteps):
        raise ValueError(f"it plans {len(planned)} of the {len(run.footsteps)} footsteps of the run")
    for number, (wanted, step) in enumerate(zip(run.footsteps, planned, strict=False)):
        x, y, z = step.position
        away, turn = math.hypot(x - wanted.x, y - wanted.y), step.heading - wanted.heading
        late = 0.0
        if number > 1 and wanted.time is not None and not later:
            late = landings[number - 2] - wanted.time
        wrong = ""
        if step.foot != wanted.foot:
            wrong = f"it plans the {step.foot} foot there"
        elif away > within:
            wrong = f"its footstep is {away:.3g} m off"
        elif abs(z - wanted.z) > FOOTSTEP_TOLERANCE:
            wrong = f"it plans z = {z:g} m there"
        elif abs(math.remainder(turn, math.tau)) > _SAME_HEADING:
            wrong = f"it plans a heading of {step.heading:.3g} rad"
        elif abs(late) > _SAME_TIME:
            wrong = f"it lands there {late:+.3g} s late"
        if wrong:
            raise ValueError(
                f"it does not keep to footstep {number + 1} at ({wanted.x:g}, {wanted.y:g}) m: {wrong}; plan "
                "run.footsteps, or leave them out"
            )


def check_duration(contacts: Contacts, until: float, run: RunParameters | None) -> None:
    """Refuse a walk ``until`` a time [s] that takes much longer than its run, by a ValueError.

    Standing would dilute its errors. A table, which has no run, and a gait without a closed form are held to
    the median of the plan's own steps.
    """
    single, double = _durations(contacts, run)
    times: list[float | None] = [None] * contacts.steps
    if run is not None:
        times = [step.time for step in run.footsteps[2:]] or [None] * run.gait.steps
    rests = contacts.phases[0].stance == "both"
    end = SETTLING if rests else 0.0
    for time in times:
        end = (end + single if time is None else time) + double
    usual = end + (SETTLING + REST if rests else 0.0)
    if until > _LONGEST * usual:
        way_out = "; walk what is before and after a stand as two tables" if run is None else ""
        parts = f"its steps{', the times of footsteps and rest at both ends' if rests else ''}{way_out}"
        raise ValueError(
            f"its walk takes {until:.4g} s, more than {_LONGEST:g} times the {usual:.4g} s of {parts}"
        )


def _durations(contacts: Contacts, run: RunParameters | None) -> tuple[float, float]:
    """Durations of single and double support of a run's gait; else zero and the plan's median step [s]."""
    if run is not None:
        with suppress(RefusedGait):
            gait = plan_gait(run.gait.model_copy(update={"steps": 1}), run.body.mass).constants
            return gait.single_support_duration, gait.double_support_duration
    return 0.0, float(np.median(np.diff(contacts.step_ends, prepend=contacts.step_ends[0] / 2)))


def judged_facts(plan: WalkPlan) -> tuple[Any, ...]:
    """What is read of a plan after the walk, beside its samples at hand-over."""
    ends, jumps = plan.contacts.step_ends.tolist(), np.asarray(plan.jump_times).tolist()
    return plan.command, plan.judged_from, plan.constants, ends, jumps


def check_judged(plan: WalkPlan) -> None:
    """Refuse a plan of a class that says itself what of it is judged, by a ValueError."""
    names = ("command", "judged_from", "contacts", "constants", "jump_times")
    own = [name for name in names if getattr(type(plan), name, None) is not getattr(WalkPlan, name, None)]
    if plan.command is not None or own or type(plan.contacts) is not Contacts:
        raise ValueError("its plan has a command or a judged_from of its own, or contacts of another class")


def check_plan(plan: WalkPlan, run: RunParameters, robot: Robot) -> None:
    """Refuse a plan whose posture does not fit body or COM, or that does not fit its floor or contacts."""
    check_judged(plan)
    state = plan.table([0.0])[0]
    shapes = {"q": (robot.nq,), "v": (robot.nv,), "acceleration": (robot.nv,), "trunk": (3, 3)}
    for name, shape in shapes.items():
        real_numbers(f"'{name}' of its posture at 0 s", getattr(state, name), shape, finite=True)
    q = np.asarray(state.q, np.float64)
    norm, com = np.linalg.norm(q[3:7]), pin.centerOfMass(robot.model, robot.model.createData(), q)
    if abs(norm - 1.0) > _UNIT:
        raise ValueError(f"'q' of its posture at 0 s has a quaternion of norm {norm:.8g}, not 1 to {_UNIT:g}")
    if (off := np.linalg.norm(com - state.com)) > _COM_OFF:
        raise ValueError(
            f"'q' of its posture at 0 s has a COM {off * 1e3:.3g} mm off its plan's, more than "
            f"{_COM_OFF * 1e3:g} mm; q is place [m], quaternion (x, y, z, w), joints [rad]"
        )
    check_contacts(plan)
    for key, slope, floor in zip(("slope", "cross_slope"), plan.contacts.slope, run.gait.slopes, strict=True):
        if slope != floor:
            raise ValueError(
                f"it plans for a slope of {slope:g}, and gait.{key} is {floor:g}; make the plan with "
                "ampm.make_plan, which takes it from the run"
            )

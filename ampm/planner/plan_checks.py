"""What a planner's plan is held to: its own contacts, and the steps and times of its run.

The checks raise a ValueError, which the caller turns into a sentence with the planner's name.
"""

import math
from contextlib import suppress

import numpy as np

from ampm.exceptions import RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.contacts import Contacts, footprint
from ampm.planner.footstep_walk import REST
from ampm.planner.periodic import plan_gait
from ampm.planner.rest_to_rest import SETTLING
from ampm.planner.support import StepPlan

FOOTSTEP_TOLERANCE, ASIDE = 1e-3, 0.2
"""Distance up to which a planner steps on a footstep, and when it plans again, as a push may ask for [m]."""
# Shares by which a planner's steps may differ from the gait's without a word; those of lipm are 12 % longer.
_SAME_LENGTH, _SAME_DURATION = 0.05, 0.15
_SAME_HEADING, _SAME_TIME = 0.2, 0.1  # most difference of a footstep's heading and landing [rad, s]
_LONGEST = 1.5  # most time of a planner's walk over that of the run's durations [1]
_OFF = 5e-3  # most distance of a sole point on the floor from its footstep [m]
_SHORTEST = 0.05  # least duration of a swing: none is half as short [s]
_OUTSIDE = 0.02  # most distance of the ZMP from the support [m]: an optimised plan may leave it a little
_POINTS = [0, 5, 1, 4, 2, 3]  # corners of a footprint in the order of a foot's sole points


def check_contacts(
    plan: StepPlan, after: float = 0.0, phases: int | None = None, outside: float = _OUTSIDE
) -> None:
    """Raise ValueError for a plan whose feet or ZMP contradict its contacts in the middle of a phase.

    Feet and the durations of swings are checked in all phases ``after`` a time [s], the ZMP in the first
    ``phases`` of them, by default in all. The ZMP may be ``outside`` the support by this distance [m].
    """
    ahead = [phase for phase in plan.contacts.phases if phase.start + phase.duration > after]
    for phase in ahead:
        if phase.kind == "single_support" and phase.duration < _SHORTEST:
            raise ValueError(
                f"at {phase.start:.4g} s it swings a foot in {phase.duration:.3g} s; plan {_SHORTEST:g} s "
                "or more"
            )
    times = np.array([0.5 * (max(phase.start, after) + phase.start + phase.duration) for phase in ahead])
    feet = plan.feet.sample(times)
    for row, phase in enumerate(ahead):
        for side, footstep, foot in zip(("left", "right"), (phase.left, phase.right), feet, strict=True):
            touching = foot.contact[row].repeat(2)
            if bool(footstep) != touching.any():
                ways = ("in the air", "on the floor")
                raise ValueError(
                    f"at {times[row]:.4g} s its contacts have the {side} foot {ways[bool(footstep)]}, and "
                    f"the path of the foot has it {ways[not footstep]}"
                )
            if footstep:
                corners = footprint(plan.feet.sole, footstep)[_POINTS]
                off = np.linalg.norm(foot.sole_points[row, :, :2] - corners, axis=1)[touching].max()
                if off > _OFF:
                    raise ValueError(
                        f"at {times[row]:.4g} s the path of its {side} foot is {off:.3g} m off its footstep"
                    )
    times = times[:phases]
    margin = plan.zmp_margin(times)
    worst = int(margin.argmin())
    if margin[worst] < -outside:
        raise ValueError(
            f"at {times[worst]:.4g} s its ZMP is {-margin[worst]:.3g} m outside its support, more than "
            f"{outside:g} m; keep it in the soles that stand"
        )


def check_steps(contacts: Contacts, run: RunParameters, *, is_table: bool, goes_on: bool) -> str:
    """Refuse a plan of other footsteps, fewer steps or more time than its run's.

    Returns words for another length or duration of its steps; empty if they are alike.
    """
    wanted = run.gait.steps
    ahead = goes_on and not run.footsteps  # what a replanner has planned beyond its steps is not walked
    until = float(contacts.step_ends[:wanted][-1]) if ahead else contacts.duration
    if is_table:
        check_duration(contacts, until, None)
        return ""
    check_footsteps(contacts, run)
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


def check_footsteps(contacts: Contacts, run: RunParameters, *, later: bool = False) -> None:
    """Refuse a plan that does not step on the footsteps of its run, by a ValueError.

    A later plan may step aside, and land at other times. A run without footsteps has none off its floor: the
    floor of the simulation is where the plan steps.
    """
    planned, within = contacts.footsteps, ASIDE if later else FOOTSTEP_TOLERANCE
    landings = [p.start + p.duration for p in contacts.phases if p.kind == "single_support"]
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

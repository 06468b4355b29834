"""COM and feet of a run's footsteps, from standing to standing."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.blend import BlendLaw
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan
from ampm.planner.contacts import Contacts, Footstep
from ampm.planner.footsteps import check_footsteps, plan_footsteps, swing_times
from ampm.planner.periodic import plan_gait
from ampm.planner.rest_to_rest import SETTLING
from ampm.planner.routes import of_row
from ampm.planner.stride import plan_feet
from ampm.planner.support import StepPlan
from ampm.planner.swings import plan_swings

LONGEST_STAND = 60.0
"""Longest time from a foot's lift-off to its landing, a stand before it included [s]."""
REST = 2.0
"""Time for which the body stands after the walk [s]."""


def plan_footstep_walk(run: RunParameters, body: BodyDescription) -> StepPlan:
    """Plan COM, ZMP, momentum and feet over the footsteps of a run.

    Where a landing leaves time to stop and to start again, the body stands on the two footsteps before it.

    Args:
        run: gait, feet, and at least three footsteps.
        body: its mass, soles and lengths.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
    """
    footsteps = [*map(of_row, run.footsteps)]
    check_footsteps(footsteps)
    walks = []
    for first, last, begin in stands(run, footsteps):
        part = [step._replace(time=step.time and step.time - begin) for step in footsteps[first:last]]
        walks.append((begin, plan_footsteps(part, run.gait, body, first=first + 1)))
    return with_feet(in_turn(walks), run, body)


def with_feet(plan: CentroidalPlan, run: RunParameters, body: BodyDescription) -> StepPlan:
    """A plan with the feet of a run's gait: rolling as its ZMP allows, if it begins standing."""
    if plan.contacts.phases[0].stance == "both":
        return StepPlan.of(plan, feet=plan_swings(plan, run.foot, body.sole, run.gait.step_length))
    return StepPlan.of(plan, feet=plan_feet(plan.contacts, run.foot, body.sole))


def stands(run: RunParameters, footsteps: Sequence[Footstep]) -> list[tuple[int, int, float]]:
    """Parts of a walk from standing to standing.

    Args:
        run: its gait gives the durations.
        footsteps: of the whole walk.

    Returns:
        First footstep of each part, the one after its last, and when it begins [s].

    Raises:
        InputError: a landing leaves no time to swing, or is much later than the step before.
    """
    constants = plan_gait(run.gait.model_copy(update={"steps": 1}), run.body.mass).constants
    single, double = constants.single_support_duration, constants.double_support_duration
    if any(step.time for step in footsteps[:2]):
        raise InputError("footsteps 1 and 2 have a time, but the feet stand there from 0 s; leave it empty.")
    parts, first, begin = [], 0, 0.0
    for number, (lifted, landing) in enumerate(swing_times(footsteps, constants), start=2):
        spare = landing - lifted - single
        if number == 2 and spare >= SETTLING:
            begin = spare
        elif number >= first + 3 and spare >= 2.0 * SETTLING - double:
            parts.append((first, number, begin))
            first, begin = number - 2, landing - SETTLING - single
        if not landing - lifted <= LONGEST_STAND:
            raise InputError(
                f"footstep {number + 1} is reached at {landing:g} s, {landing - lifted:.4g} s after the step "
                f"before it; a walk stands for at most {LONGEST_STAND:g} s. Give times in seconds."
            )
    return [*parts, (first, len(footsteps), begin)]


def stops(contacts: Contacts) -> list[tuple[float, float]]:
    """When a walk comes to rest, and when it goes on, infinity at its end [s]."""
    still = [phase for phase in contacts.phases[1:-1] if phase.duration >= 2.0 * SETTLING - 1e-9]
    ends = [(part.start, part.start + part.duration - SETTLING) for part in still if part.stance == "both"]
    return [*ends, (contacts.phases[-1].start, math.inf)]


def in_turn(walks: Sequence[tuple[float, CentroidalPlan]]) -> CentroidalPlan:
    """Walks from rest to rest one after the other, with rest before, between and after them.

    Args:
        walks: when each begins [s], and its plan, which begins where the one before ends.
    """
    (first, plan), ends = walks[0], [begin for begin, _ in walks[1:]]
    ends.append(walks[-1][0] + walks[-1][1].duration + REST)
    motions = [_rest(plan, 0.0, 0.0, first)] if first else []
    switches, footsteps = [0.0], [*plan.contacts.footsteps[:2]]
    for (begin, walk), end in zip(walks, ends, strict=True):
        motions += [phase._replace(start=phase.start + begin) for phase in walk.phases]
        stood = begin + walk.duration
        if end > stood:
            motions.append(_rest(walk, walk.duration, stood, end - stood))
        switches += (begin + walk.contacts.switches[1:-1]).tolist()  # both feet stand between walks
        footsteps += walk.contacts.footsteps[2:]
    switches.append(ends[-1])
    contacts = replace(plan.contacts, footsteps=tuple(footsteps), switches=np.array(switches))
    return replace(plan, contacts=contacts, phases=tuple(motions))


def _rest(plan: CentroidalPlan, at: float, start: float, duration: float) -> CentroidalPhase:
    """Rest where the COM of a plan is at a time [s]."""
    sample = plan.sample(at)
    (x, y, z), floor = sample.com[0].tolist(), float(sample.floor[0])
    rate = math.sqrt(plan.gravity / plan.com_height)
    still = BlendLaw(rate, 0.0, duration, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0))
    high = None
    if plan.climbs:
        high = BlendLaw(rate, 0.0, duration, z, 0.0, (z, z), (floor - z, floor - z))
    return CentroidalPhase(start, duration, (x, y), still, still, (0.0, 0.0), z=high)

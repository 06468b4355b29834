"""COM and feet of a run's footsteps, from standing to standing."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.blend import BlendLaw
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan
from ampm.planner.contacts import Contacts, Phase, check_landing
from ampm.planner.feet import FeetPlan, FootPath
from ampm.planner.footsteps import check_footsteps, plan_footsteps
from ampm.planner.periodic import plan_gait
from ampm.planner.rest_to_rest import SETTLING
from ampm.planner.routes import footsteps_of
from ampm.planner.support import StepPlan
from ampm.planner.swings import plan_swings

LONGEST = 2.0
"""Time by which a swing may be longer than the gait's [s]; on one foot a COM out of place falls within it."""
Moved = TypeVar("Moved", Phase, CentroidalPhase)

REST = 2.0
"""Time for which the body stands after the walk [s]."""


def plan_footstep_walk(run: RunParameters, body: BodyDescription) -> StepPlan:
    """Plan COM, ZMP, momentum and feet over the footsteps of a run.

    Where a landing leaves time to stop and to start again, the body stands on the two footsteps before it.

    Args:
        run: gait, feet, and at least four footsteps.
        body: its mass, soles and lengths.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
    """
    footsteps, landings = footsteps_of(run)
    check_footsteps(footsteps)

    def part(first: int, last: int, begin: float, rest: float = 0.0) -> StepPlan:
        times = [None if time is None else time - begin for time in landings[first:last]]
        plan = plan_footsteps(footsteps[first:last], run.gait, body, landings=times, first=first + 1)
        plan = rest_after(rest_before(plan, rest) if rest else plan, REST)
        return StepPlan.of(plan, feet=plan_swings(plan, run.foot, body.sole, run.gait.step_length))

    own, *others = stands(run, landings)
    steps = part(*own, rest=own[2])
    for later in others:
        steps = walk_again(steps, part(*later), later[2])
    return steps


def stands(run: RunParameters, landings: Sequence[float | None]) -> list[tuple[int, int, float]]:
    """Parts of a walk from standing to standing.

    Args:
        run: its gait gives the durations.
        landings: time at which each footstep is reached [s], None where the gait says it.

    Returns:
        First footstep of each part, the one after its last, and when it begins [s].

    Raises:
        InputError: a landing leaves no time to swing, or a swing takes much longer than the gait's.
    """
    constants = plan_gait(run.gait.model_copy(update={"steps": 1}), run.body.mass).constants
    single, double = constants.single_support_duration, constants.double_support_duration
    parts, first, begin, lifted = [], 0, 0.0, SETTLING
    for number, wanted in enumerate(landings[2:], start=2):
        landing = lifted + single if wanted is None else wanted
        check_landing(number, landing, lifted, double)
        spare = landing - lifted - single
        if number == 2 and spare >= SETTLING:
            begin = spare
        elif first + 4 <= number <= len(landings) - 2 and spare >= 2.0 * SETTLING - double:
            parts.append((first, number, begin))
            first, begin = number - 2, landing - SETTLING - single
        elif spare > LONGEST:
            raise InputError(
                f"footstep {number + 1} is reached at {landing:g} s, so that its swing takes "
                f"{landing - lifted:.4g} s; give a time of at most {lifted + single + LONGEST:.4g} s."
            )
        lifted = landing + double
    return [*parts, (first, len(landings), begin)]


def stops(contacts: Contacts) -> list[tuple[float, float]]:
    """When a walk comes to rest, and when it goes on, infinity at its end [s]."""
    still = [phase for phase in contacts.phases[1:-1] if phase.duration >= 2.0 * SETTLING - 1e-9]
    ends = [
        (phase.start, phase.start + phase.duration - SETTLING) for phase in still if phase.stance == "both"
    ]
    return [*ends, (contacts.phases[-1].start, math.inf)]


def rest_before(plan: CentroidalPlan, time: float) -> CentroidalPlan:
    """The plan of a walk that begins at rest, after a further time of rest [s]."""
    first, *others = plan.contacts.phases
    phases = first._replace(duration=first.duration + time), *(_later(phase, time) for phase in others)
    rest = _rest(plan, 0.0, time, 0.0)
    contacts = Contacts(plan.contacts.footsteps, phases)
    return replace(plan, contacts=contacts, phases=(rest, *(_later(phase, time) for phase in plan.phases)))


def rest_after(plan: CentroidalPlan, time: float) -> CentroidalPlan:
    """The plan of a walk that ends at rest, with a further time of rest [s]."""
    *others, last = plan.contacts.phases
    phases = *others, last._replace(duration=last.duration + time)
    contacts = Contacts(plan.contacts.footsteps, phases)
    return replace(
        plan, contacts=contacts, phases=(*plan.phases, _rest(plan, plan.duration, time, plan.duration))
    )


def _rest(plan: CentroidalPlan, start: float, duration: float, at: float) -> CentroidalPhase:
    """Rest where the COM of a plan is at a time [s]."""
    sample = plan.sample(at)
    (x, y, z), floor = sample.com[0].tolist(), float(sample.floor[0])
    rate = math.sqrt(plan.gravity / plan.com_height)
    still = BlendLaw(rate, 0.0, duration, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0))
    high = BlendLaw(rate, 0.0, duration, z, 0.0, (z, z), (floor - z, floor - z)) if floor else None
    return CentroidalPhase(start, duration, (x, y), still, still, (0.0, 0.0), z=high)


def _later(phase: Moved, time: float) -> Moved:
    return phase._replace(start=phase.start + time)


def walk_again(first: StepPlan, second: StepPlan, begin: float) -> StepPlan:
    """A walk, rest, and a second walk from where it ended.

    Args:
        first: ends standing.
        second: stands at first where the first one ends.
        begin: when the second one begins [s]; the first one stands until then.
    """
    kept = [phase for phase in first.phases if phase.start < begin]
    kept[-1] = kept[-1]._replace(duration=begin - kept[-1].start)
    stood, (start, *after) = first.contacts.phases[-1], second.contacts.phases
    contacts = Contacts(
        (*first.contacts.footsteps, *second.contacts.footsteps[2:]),
        (
            *first.contacts.phases[:-1],
            stood._replace(duration=begin - stood.start + start.duration),
            *(_later(phase, begin) for phase in after),
        ),
    )
    phases = (*kept, *(_later(phase, begin) for phase in second.phases))
    feet = FeetPlan(
        first.feet.sole,
        _path_again(first.feet.left, second.feet.left, begin),
        _path_again(first.feet.right, second.feet.right, begin),
        begin + second.duration,
    )
    return replace(second, contacts=contacts, phases=phases, feet=feet)


def _path_again(first: FootPath, second: FootPath, begin: float) -> FootPath:
    rows = first.start < begin
    joined = {
        name: np.concatenate([getattr(first, name)[rows], getattr(second, name)])
        for name in ("pivot", "path", "pitch", "toe", "contact", "heading")
    }
    return FootPath(start=np.concatenate([first.start[rows], second.start + begin]), **joined)

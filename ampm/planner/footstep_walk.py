"""COM and feet of a run's footsteps, from standing to standing."""

from __future__ import annotations

import math
from dataclasses import replace

from ampm.description import BodyDescription
from ampm.parameters import RunParameters
from ampm.planner.blend import BlendLaw
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan
from ampm.planner.contacts import Contacts
from ampm.planner.footsteps import plan_footsteps
from ampm.planner.routes import footsteps_of
from ampm.planner.support import StepPlan
from ampm.planner.swings import plan_swings

REST = 2.0
"""Time for which the body stands after the walk [s]."""


def plan_footstep_walk(run: RunParameters, body: BodyDescription) -> StepPlan:
    """Plan COM, ZMP, momentum and feet over the footsteps of a run.

    Args:
        run: gait, feet, and at least four footsteps.
        body: its mass, soles and lengths.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
    """
    footsteps, landings = footsteps_of(run)
    plan = rest_after(plan_footsteps(footsteps, run.gait, body, landings=landings), REST)
    return StepPlan.of(plan, feet=plan_swings(plan, run.foot, body.sole, run.gait.step_length))


def rest_after(plan: CentroidalPlan, time: float) -> CentroidalPlan:
    """The plan of a walk that ends at rest, with a further time of rest [s]."""
    end, *_, last = plan.duration, plan.contacts.phases[-1]
    x, y, _ = plan.sample(end).com[0].tolist()
    still = BlendLaw(math.sqrt(plan.gravity / plan.com_height), 0.0, time, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0))
    rest = CentroidalPhase(end, time, (x, y), still, still, (0.0, 0.0))
    phases = (*plan.contacts.phases[:-1], last._replace(duration=last.duration + time))
    contacts = Contacts(plan.contacts.footsteps, phases)
    return replace(plan, contacts=contacts, phases=(*plan.phases, rest))

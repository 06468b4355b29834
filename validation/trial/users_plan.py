"""What the plan of a user's planner is held to beside its steps: body, floor, and what of it is judged.

The checks raise a ValueError, which the caller turns into a sentence with the planner's name.
"""

from typing import Any

import numpy as np
import pinocchio as pin

from ampm.body.robot import Robot
from ampm.parameters import RunParameters
from ampm.planner.contacts import Contacts
from ampm.planner.plan_checks import check_contacts
from ampm.walk import WalkPlan
from validation.trial.users import real_numbers

_UNIT, _COM_OFF = 1e-6, 5e-3  # largest errors of its posture's quaternion and COM at 0 s [1, m]


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

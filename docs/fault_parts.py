"""A planner and a controller of a user's own for docs/faults.py; each can have one fault.

Without a fault they are the project's own, by other names.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import ampm
from ampm.body.robot import Robot
from ampm.parameters import RunParameters
from ampm.planner.centroidal import PlanSample
from ampm.planner.feet import FeetPlan, FootSample
from ampm.planner.support import plan_steps
from ampm.walk import ControlOutput, Reference, State, Touch, WalkPlan
from validation.trial.plan import make_body


class OwnPlanner:
    """The paper's plan with its periodic motion, changed by a fault.

    Args:
        fault: name of a method of this class, empty for none.
        size: of the fault: of ``late`` and ``late_feet`` [s], of ``other_height`` and ``other_mass`` a share
            [1], of ``shifted_zmp`` [m], of ``narrow`` the step width [m].
    """

    name = "own"

    def __init__(self, fault: str = "", size: float = 0.0, file: str = "") -> None:
        self.fault, self.size, self.file = fault, size, file

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan a walk."""
        if self.file:
            robot = make_body(run.replace({"body.source": self.file})).robot
        plan = ampm.PeriodicPlanner().plan(run, robot)
        return getattr(self, self.fault)(plan, run) if self.fault else plan

    def narrow(self, plan: WalkPlan, run: RunParameters) -> WalkPlan:
        """Feet, COM and ZMP of narrow steps, and the joints of the gait's own."""
        gait = run.replace({"gait.step_width": self.size}).gait
        steps = plan_steps(gait, plan.mass, run.foot, plan.feet.sole)
        offset = plan.constants.angular_momentum_y_offset
        return WalkPlan.of(steps.with_angular_momentum_offset(offset), posture=plan.posture)

    def late(self, plan: WalkPlan, run: RunParameters) -> WalkPlan:
        """COM, ZMP, force and momentum later than feet and contacts."""
        return LatePlan(**vars(plan), late=self.size)

    def late_feet(self, plan: WalkPlan, run: RunParameters) -> WalkPlan:
        """Feet and contacts later than the rest."""
        feet = {
            name: value for name, value in vars(plan.feet).items() if name in FeetPlan.__dataclass_fields__
        }
        return replace(plan, feet=LateFeet(**feet, late=self.size))

    def other_height(self, plan: WalkPlan, run: RunParameters) -> WalkPlan:
        """COM at another height, and the ZMP that belongs to it; COM and force along x and y are right."""
        return HigherPlan(**vars(plan), share=self.size)

    def other_mass(self, plan: WalkPlan, run: RunParameters) -> WalkPlan:
        """Forces and momenta of another mass."""
        other = ampm.plan(run.replace({"body.mass": plan.mass * (1.0 + self.size)}))
        return replace(plan, mass=other.mass, phases=other.phases)

    def shifted_zmp(self, plan: WalkPlan, run: RunParameters) -> WalkPlan:
        """ZMP ahead of its place; COM and force are right."""
        return ShiftedPlan(**vars(plan), ahead=self.size)


@dataclass(frozen=True)
class LatePlan(WalkPlan):
    """A plan whose centroidal part is late [s]."""

    late: float = 0.0

    def sample(self, times: Any) -> PlanSample:
        """The plan at times."""
        return super().sample(np.maximum(np.asarray(times, dtype=float) - self.late, 0.0))


@dataclass(frozen=True)
class HigherPlan(WalkPlan):
    """A plan of a COM that is higher by a share [1]."""

    share: float = 0.0

    def sample(self, times: Any) -> PlanSample:
        """The plan at times."""
        found = super().sample(times)
        higher = found.com[:, 2:] * self.share
        zmp = found.zmp - higher * found.force[:, :2] / found.force[:, 2:]
        return replace(found, com=found.com + higher * [0.0, 0.0, 1.0], zmp=zmp)


@dataclass(frozen=True)
class ShiftedPlan(WalkPlan):
    """A plan whose ZMP is ahead [m]."""

    ahead: float = 0.0

    def sample(self, times: Any) -> PlanSample:
        """The plan at times."""
        found = super().sample(times)
        return replace(found, zmp=found.zmp + np.array([self.ahead, 0.0]))


@dataclass(frozen=True)
class LateFeet(FeetPlan):
    """Feet that are late [s]."""

    late: float = 0.0

    def _earlier(self, times: Any) -> Any:
        return np.maximum(np.asarray(times, dtype=float) - self.late, 0.0)

    def sample(self, times: Any) -> tuple[FootSample, FootSample]:
        """Both feet at times."""
        return super().sample(self._earlier(times))

    def contact(self, times: Any) -> Any:
        """Contacts at times."""
        return super().contact(self._earlier(times))


GAINS = tuple(
    f"{part}_{kind}" for part in ("com", "posture", "swing", "roll") for kind in ("stiffness", "damping")
)
"""Feedback that ``soft`` weakens."""


class OwnController(ampm.TrackingController):
    """The project's controller, changed by a fault.

    Args:
        robot: the body.
        run: parameters.
        fault: ``swapped``: torques of two joints are exchanged; ``sign``: that of a joint has the wrong sign;
            ``soft``: COM feedback is too weak.
        joints: of the fault, separated by commas.
        share: of the gains that ``soft`` leaves [1].
    """

    def __init__(
        self,
        robot: Robot,
        run: RunParameters,
        fault: str = "",
        joints: str = "",
        share: float = 1.0,
        file: str = "",
    ) -> None:
        if file:
            robot = make_body(run.replace({"body.source": file})).robot
        if fault == "soft":
            run = run.replace(
                {f"controller.{name}": share * run.value(f"controller.{name}") for name in GAINS}
            )
        super().__init__(robot, run)
        self.fault = fault
        self.places = [robot.joint_names.index(name) for name in joints.split(",") if name]

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick."""
        output = super().update(state, touch, reference)
        torque, rate = np.array(output.torque), np.array(output.rate)
        for values in (torque, rate):
            if self.fault == "swapped":
                values[self.places] = values[self.places[::-1]]
            elif self.fault == "sign":
                values[self.places] *= -1.0
        return output._replace(torque=torque, rate=rate)

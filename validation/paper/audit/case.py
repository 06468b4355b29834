"""Gaits that the audit computes numbers on: ``normal``, and ``momentum`` where ``normal`` has none.

``normal`` sends the force through the COM (c_s = c_y = 1), which hides several misprints: there the affected
momentum is zero. Such numbers are given for both gaits.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from ampm.parameters import GaitParameters
from ampm.planner.centroidal import CentroidalPlan, PlanSample
from ampm.planner.periodic import plan_gait
from validation.paper.audit.body import BodyEvidence
from validation.trial.outcome import Outcome
from validation.trial.plan import load_request, plan_walk
from validation.trial.simulate import simulate

SAMPLES_PER_STEP = 2001
COARSE = 0.004
"""Largest step of the inverse kinematics' grid where bodies are compared with each other [s]."""


class Numbers:
    """One gait's constants under the paper's names, all from the plan.

    Attributes:
        name: of the gait.
        gait: its parameters.
        plan: of the gait.
        constants: of the plan.
        g_over_h: gravity over height, g / H [1/s^2].
        t_ss, t_ds: durations of single and of double support [s].
        t_l: T_ls, time constant of the lateral single support [s].
        w_d: rate of the lateral double support, ``sqrt(g c_y s / (H beta))`` [1/s].
        v_ex: from the paper's own formula [m].
        half_width: half the lateral distance of the feet, s + beta [m].
        lift_speed: forward speed that section 2.3 gives a foot at lift-off, l_s over T_ss [m/s].
    """

    def __init__(self, name: str, gait: GaitParameters, plan: CentroidalPlan) -> None:
        self.name, self.gait, self.plan = name, gait, plan
        self.constants = constants = plan.constants
        self.g_over_h = plan.gravity / gait.com_height
        self.t_ss, self.t_ds = constants.single_support_duration, constants.double_support_duration
        self.t_l = 1.0 / math.sqrt(gait.c_y * self.g_over_h)
        self.w_d = math.sqrt(gait.c_y * self.g_over_h * constants.s / constants.beta)
        angle = self.t_ss / self.t_l
        self.v_ex = constants.s * (math.cosh(angle) - 1.0) / math.sinh(angle)
        self.half_width = 0.5 * gait.step_width
        self.lift_speed = constants.l_s / self.t_ss

    @cached_property
    def switch(self) -> PlanSample:
        """The plan at the first switch from single to double support."""
        return self.plan.sample(self.t_ss)

    @cached_property
    def stride(self) -> PlanSample:
        """The plan over two steps."""
        step = self.constants.step_duration
        return self.plan.sample(np.linspace(0.0, 2.0 * step, 2 * SAMPLES_PER_STEP - 1))

    @property
    def largest_jump(self) -> float:
        """Largest jump of the COM's acceleration over all switches [m/s^2]."""
        return self.plan.residuals().acceleration * self.plan.gravity

    def momentum_peak_to_peak(self, axis: int) -> float:
        """Peak to peak of L_x (0) or L_y (1) over a stride [N m s]."""
        return float(np.ptp(self.stride.angular_momentum[:, axis]))


class Case:
    """The gaits of the audit, each planned when it is first used."""

    @cached_property
    def body(self) -> BodyEvidence:
        """``normal`` walked by the body's inverse kinematics."""
        return BodyEvidence(plan_walk(load_request("normal")))

    @cached_property
    def normal(self) -> Numbers:
        """The plan of ``normal``, with the body's feet and constant of L_y."""
        return Numbers("normal", self.body.run.gait, self.body.plan)

    @cached_property
    def momentum(self) -> Numbers:
        """The plan of ``momentum``, without a body: mean L_y zero."""
        return self.varied("momentum")

    @cached_property
    def ipm(self) -> Numbers:
        """The plan of ``ipm``, the plain inverted pendulum with the normal gait's steps."""
        return self.varied("ipm")

    def outcome(self, name: str, steps: int) -> Outcome:
        """Outcome of a simulated walk of a preset over so many steps."""
        planned = plan_walk(load_request(name, (f"gait.steps={steps}",)))
        return simulate(planned.plan, planned.run, planned.body.model, steps=steps).outcome

    def varied(self, preset: str = "normal", /, **gait: float) -> Numbers:
        """The plan of a preset with some of its gait changed, without a body."""
        run = load_request(preset, _settings(gait)).run
        return Numbers(preset, run.gait, plan_gait(run.gait, run.body.mass))

    def walked(self, momentum_z: str = "free", /, **gait: float) -> BodyEvidence:
        """``normal`` with another gait, L_z free or zero, walked by the body on a coarse grid."""
        settings = [f"solver.ik_time_step={COARSE!r}", f"body.angular_momentum_z={momentum_z}"]
        settings += _settings(gait)
        return BodyEvidence(plan_walk(load_request("normal", settings, as_is=True)))


def _settings(gait: dict[str, float]) -> list[str]:
    return [f"gait.{name}={value!r}" for name, value in gait.items()]

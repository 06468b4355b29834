"""A periodic straight gait in closed form: from parameters to a centroidal plan.

t = 0 is the start of the first single support, on the left foot, whose reference point is at (0, +w).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import GRAVITY, GaitParameters
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan, PlanConstants
from ampm.planner.contacts import Contacts, Footstep, Phase
from ampm.planner.gaits import Gaits
from ampm.planner.pendulum import AffineLaw, odd_double_integral
from ampm.planner.rules import RULES


def plan_gait(gait: GaitParameters, mass: float, *, angular_momentum_y_offset: float = 0.0) -> CentroidalPlan:
    """Plan a periodic straight gait in closed form.

    Args:
        gait: what to walk.
        mass: of the body [kg].
        angular_momentum_y_offset: mean of L_y over a step [N m s]. The AMPM leaves it free; only a body fixes
            it (the periodic whole-body motion), and a plan without one takes zero.

    Raises:
        InputError: mass or offset is no usable number.
        MathematicalRefusal: the closed form has no solution, or none that can be computed.
    """
    if not (math.isfinite(mass) and mass > 0.0):
        raise InputError(f"the mass is {mass:g} kg; it must be a finite number greater than 0 kg.")
    if not math.isfinite(angular_momentum_y_offset):
        raise InputError(
            f"the angular momentum offset is {angular_momentum_y_offset}; give a finite number [N m s]."
        )
    one = Gaits.of(gait)
    with np.errstate(all="ignore"):  # what overflows is refused by the last rule
        for rule in RULES:
            if rule.refused(one):
                raise rule.refusal(one)
    return _assemble(gait, float(mass), one, float(angular_momentum_y_offset))


def _numbers(law: AffineLaw) -> AffineLaw:
    """A law of plain floats."""
    return AffineLaw(*(float(value) for value in vars(law).values()))


def _mirrored(law: AffineLaw) -> AffineLaw:
    """A lateral law for the other stance foot."""
    return replace(law, even=-law.even, odd=-law.odd, zmp_offset=-law.zmp_offset)


def _assemble(gait: GaitParameters, mass: float, one: Gaits, offset: float) -> CentroidalPlan:
    """Plan of the closed form over its footsteps."""
    sagittal, frontal = one.sagittal, one.frontal
    single_x, double_x, single, double = map(
        _numbers, (sagittal.single, sagittal.double, frontal.single, frontal.double)
    )
    t_ss, t_ds = single_x.duration, double_x.duration
    step, length, w = t_ss + t_ds, gait.step_length, 0.5 * gait.step_width
    weight = mass * GRAVITY

    # L_x(t + T) = -L_x(t): half of what one single support adds; double support adds nothing.
    gained_x = weight * float(single.evaluate(t_ss).moment_arm_integral)
    # L_y returns to its start at every switch; its mean over a step is taken off.
    drift_s, drift_d = (
        (law.force_slope - 1.0) * odd_double_integral(law.rate, law.odd, law.duration)
        for law in (single_x, double_x)
    )
    start_y = weight * (drift_s + drift_d) / step

    laws = ((single, double), (_mirrored(single), _mirrored(double)))
    footsteps = tuple(
        Footstep("left", (k * length, w, 0.0)) if k % 2 == 0 else Footstep("right", (k * length, -w, 0.0))
        for k in range(-1, gait.steps + 1)
    )
    supports: list[Phase] = []
    phases: list[CentroidalPhase] = []
    for k in range(gait.steps):
        on_left = k % 2 == 0
        sign = 1.0 if on_left else -1.0
        single_y, double_y = laws[k % 2]
        start, x = k * step, k * length
        here, ahead = footsteps[k + 1], footsteps[k + 2]
        left, right = (here, ahead) if on_left else (ahead, here)
        supports.append(Phase(start, t_ss, here if on_left else None, None if on_left else here))
        supports.append(Phase(start + t_ss, t_ds, left, right))
        gained = 0.5 * sign * gained_x
        phases.append(CentroidalPhase(start, t_ss, (x, sign * w), single_x, single_y, (-gained, start_y)))
        middle = (x + 0.5 * length, 0.0)
        phases.append(CentroidalPhase(start + t_ss, t_ds, middle, double_x, double_y, (gained, start_y)))
    constants = PlanConstants(
        **{name: float(getattr(sagittal, name)) for name in ("l_s", "l_d", "a_d", "c_d")},
        inverse_a_s=float(one.inverse_a_s),
        single_support_duration=t_ss,
        double_support_duration=t_ds,
        s=float(frontal.s),
        beta=float(frontal.beta),
        lateral_switching_velocity=float(frontal.velocity),
        mean_velocity=length / step,
        angular_momentum_y_offset=offset,
    )
    contacts = Contacts(footsteps, tuple(supports))
    return CentroidalPlan(
        mass, GRAVITY, gait.com_height, gait.switching_velocity, contacts, tuple(phases), constants
    )

"""A periodic straight gait in closed form: from parameters to a centroidal plan.

t = 0 is the start of the first single support, on the left foot, whose reference point is at (0, +w).
"""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ampm.exceptions import InputError, MathematicalRefusal
from ampm.parameters import GRAVITY, GaitParameters, RunParameters
from ampm.planner.centroidal import MAY_JUMP, CentroidalPhase, CentroidalPlan, PlanConstants
from ampm.planner.closed_form import LIPM, step_laws
from ampm.planner.contacts import Contacts, Footstep
from ampm.planner.pendulum import AffineLaw, odd_double_integral, position_integral
from ampm.run_file import load_run

RESIDUAL_LIMIT = 1e-9
"""Largest relative jump at a switch that rounding may cause."""


def plan(run: RunParameters | str | Path) -> CentroidalPlan:
    """Plan a run's gait in closed form, with the mass of its body.

    This is the AMPM, or the ``lipm``; other planners need a body (:class:`ampm.PeriodicPlanner`).

    Args:
        run: parameters, or a preset or TOML file.

    Raises:
        InputError: no such preset or file, or the run has footsteps.
        MathematicalRefusal: the closed form has no solution, or none that can be computed.
    """
    run = run if isinstance(run, RunParameters) else load_run(run)
    if run.footsteps:
        raise InputError("ampm.plan plans equal steps; over footsteps take ampm.plan_footsteps.")
    return plan_gait(run.gait, run.body.mass)


@lru_cache(maxsize=4)  # a search plans a gait again with other feet
@np.errstate(all="ignore")  # what overflows is refused for its jumps
def plan_gait(gait: GaitParameters, mass: float) -> CentroidalPlan:
    """Plan a periodic straight gait in closed form.

    The AMPM leaves the mean of L_y over a step free. Only a body fixes it (the periodic whole-body motion),
    see :meth:`CentroidalPlan.with_angular_momentum_offset`; here it is zero.

    Args:
        gait: what to walk.
        mass: of the body [kg].

    Raises:
        InputError: the mass is not a usable number.
        MathematicalRefusal: the closed form has no solution, or none that can be computed.
    """
    if not (math.isfinite(mass) and mass > 0.0):
        raise InputError(f"the mass is {mass:g} kg; it must be a finite number greater than 0 kg.")
    plan = _assemble(gait, float(mass))
    # The closed form does not jump at a switch, unless its numbers lose their digits; a plain pendulum may.
    jumps = plan.residuals() | dict.fromkeys(MAY_JUMP if gait.planner == LIPM else (), 0.0)
    largest = max(np.nan_to_num(list(jumps.values()), nan=math.inf).tolist())
    if not largest <= RESIDUAL_LIMIT:
        raise MathematicalRefusal(
            "the gait's numbers are too far apart to be computed: by rounding the plan jumps by "
            f"{largest:.1e} of its own scale at a switch, more than {RESIDUAL_LIMIT:g}",
            reason="ill_conditioned",
            value=largest,
            limit=RESIDUAL_LIMIT,
            unit="1",
            way_out="bring gait.com_height, gait.step_length, gait.step_width and gait.c_y nearer to each "
            "other, and gait.single_support_ratio away from 0 and 1, or raise gait.switching_velocity",
        )
    return plan


def _mirrored(law: AffineLaw) -> AffineLaw:
    """A lateral law for the other stance foot."""
    return replace(law, even=-law.even, odd=-law.odd, zmp_offset=-law.zmp_offset)


def _assemble(gait: GaitParameters, mass: float) -> CentroidalPlan:
    """Plan of the closed form over its footsteps."""
    constants, (single_x, double_x), (single, double) = step_laws(gait)
    t_ss, t_ds = constants.single_support_duration, constants.double_support_duration
    step, length, w = t_ss + t_ds, gait.step_length, 0.5 * gait.step_width
    weight = mass * GRAVITY

    # L_x(t + T) = -L_x(t): half of what one single support adds; double support adds nothing.
    travel = position_integral(single.rate, single.even, single.odd, -0.5 * t_ss, 0.5 * t_ss)
    gained_x = weight * ((single.force_slope - 1.0) * float(travel) + single.zmp_offset * t_ss)
    # L_y returns to its start at every switch; its mean over a step is taken off.
    drift_s, drift_d = (
        (law.force_slope - 1.0) * odd_double_integral(law.rate, law.odd, law.duration)
        for law in (single_x, double_x)
    )
    start_y = weight * (drift_s + drift_d) / step

    laws = ((single, double), (_mirrored(single), _mirrored(double)))
    phases: list[CentroidalPhase] = []
    for k in range(gait.steps):
        sign = 1.0 if k % 2 == 0 else -1.0
        single_y, double_y = laws[k % 2]
        start, x, gain = k * step, k * length, 0.5 * sign * gained_x
        phases += [
            CentroidalPhase(start, t_ss, (x, sign * w), single_x, single_y, (-gain, start_y)),
            CentroidalPhase(start + t_ss, t_ds, (x + 0.5 * length, 0.0), double_x, double_y, (gain, start_y)),
        ]
    return CentroidalPlan(
        mass=mass,
        gravity=GRAVITY,
        com_height=gait.com_height,
        switching_velocity=gait.switching_velocity,
        contacts=gait_contacts(gait, constants, gait.steps),
        phases=tuple(phases),
        constants=constants,
    )


def gait_contacts(gait: GaitParameters, constants: PlanConstants, steps: int) -> Contacts:
    """Contacts of some steps of a gait with the constants of its plan."""
    w, step, t_ss = 0.5 * gait.step_width, constants.step_duration, constants.single_support_duration
    footsteps, switches = [], []
    for k in range(-1, steps + 1):
        x = k * gait.step_length
        footsteps.append(Footstep("right", (x, -w, 0.0)) if k % 2 else Footstep("left", (x, w, 0.0)))
    for k in range(steps):
        switches += [k * step, k * step + t_ss]
    switches.append(switches[-1] + constants.double_support_duration)
    return Contacts(tuple(footsteps), np.array(switches), gait.slopes)

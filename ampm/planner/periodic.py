"""A periodic straight gait in closed form: from parameters to a centroidal plan.

t = 0 is the start of the first single support, on the left foot, whose reference point is at (0, +w).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from ampm.exceptions import InputError, MathematicalRefusal
from ampm.parameters import GRAVITY, GaitParameters
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan, PlanConstants
from ampm.planner.contacts import Contacts, Footstep, Phase
from ampm.planner.pendulum import (
    FrontalPlane,
    SagittalPlane,
    frontal_plane,
    odd_double_integral,
    plain_frontal_plane,
    plain_sagittal_plane,
    sagittal_plane,
    sagittal_time_constant,
)

LEAST_MID_STANCE_SHARE = 0.2
"""Least speed over the foot, as a share of v0: below it the pendulum nearly stops and every error grows."""
RESIDUAL_LIMIT = 1e-9
"""Largest relative jump at a switch that a plan may have."""
CONTINUOUS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "ampm": ("position", "velocity", "acceleration", "zmp", "moment", "angular_momentum"),
        "ipm": ("position", "velocity", "moment", "angular_momentum"),
    }
)
"""Residuals that a plan of each model must keep below :data:`RESIDUAL_LIMIT`. The plain inverted pendulum is
the documented exception: acceleration and ZMP jump at every switch, and its residuals say by how much."""

_LARGEST_ANGLE = 300.0  # k T_SS / 2 whose cosh still has room in a double


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
    try:
        with np.errstate(all="ignore"):  # what overflows is refused below, by its residual
            sagittal, frontal = _solve(gait)
            plan = _assemble(gait, float(mass), sagittal, frontal, float(angular_momentum_y_offset))
            residual = plan.residuals().largest_of(CONTINUOUS[gait.model])
    except (OverflowError, ValueError, ZeroDivisionError):
        residual = math.inf
    if not residual <= RESIDUAL_LIMIT:
        raise MathematicalRefusal(
            f"the gait's numbers are too far apart to be computed: the plan would jump by {residual:.1e} of "
            f"its own scale at a switch, more than {RESIDUAL_LIMIT:g}",
            reason="ill_conditioned",
            value=residual,
            limit=RESIDUAL_LIMIT,
            unit="1",
            way_out="bring gait.com_height, gait.step_length, gait.step_width and gait.c_y nearer to each "
            "other, and gait.single_support_ratio away from 0 and 1",
        )
    return plan


def _solve(gait: GaitParameters) -> tuple[SagittalPlane, FrontalPlane]:
    """Both planes' closed forms, or the refusal that says why there is none."""
    if gait.model == "ipm":
        _check_plain(gait)
    inverse_a_s = 1.0 / gait.a_s
    bracket = gait.c_s - inverse_a_s
    if not bracket > 0.0:
        raise MathematicalRefusal(
            f"gait.c_s - 1/gait.a_s = {bracket:.6g} must be greater than 0: the COM would not be driven off "
            "the stance foot",
            reason="single_support_not_driven",
            value=bracket,
            limit=0.0,
            unit="1",
            way_out=f"raise gait.c_s above {inverse_a_s:.6g}"
            + (f" or gait.a_s above {1.0 / gait.c_s:.6g}" if gait.c_s > 0.0 else ""),
        )
    if not gait.c_y > 0.0:
        raise MathematicalRefusal(
            f"gait.c_y = {gait.c_y:.6g} must be greater than 0: the COM would not be driven back from the "
            "stance foot to the midline",
            reason="c_y_not_positive",
            value=gait.c_y,
            limit=0.0,
            unit="1",
            way_out="choose gait.c_y greater than 0, for example 0.4",
        )
    l_s = 0.5 * gait.step_length * gait.single_support_ratio
    least = l_s / sagittal_time_constant(gait.com_height, bracket, GRAVITY)
    v0 = gait.switching_velocity
    # The mid-stance rule asks for a little more; the way out names the speed that satisfies both.
    enough = least / math.sqrt(1.0 - LEAST_MID_STANCE_SHARE**2)
    slower = "or shorten gait.step_length"
    if not v0 > least:
        raise MathematicalRefusal(
            f"gait.switching_velocity = {v0:.6g} m/s is too slow to pass over the foot: the least is "
            f"l_s/T_s = {least:.6g} m/s",
            reason="switching_velocity_too_low",
            value=v0,
            limit=least,
            unit="m/s",
            way_out=f"raise gait.switching_velocity to {_rounded_up(enough)} m/s {slower}",
        )
    mid_stance = math.sqrt((v0 - least) * (v0 + least))
    floor = LEAST_MID_STANCE_SHARE * v0
    if mid_stance < floor:
        raise MathematicalRefusal(
            f"the COM would pass over the foot at {mid_stance:.6g} m/s, less than {floor:.6g} m/s, "
            f"{LEAST_MID_STANCE_SHARE:.0%} of gait.switching_velocity = {v0:.6g} m/s (it passes at all from "
            f"{least:.6g} m/s)",
            reason="mid_stance_too_slow",
            value=mid_stance,
            limit=floor,
            unit="m/s",
            way_out=f"raise gait.switching_velocity to {_rounded_up(enough)} m/s {slower}",
        )
    if gait.model == "ipm":
        sagittal = plain_sagittal_plane(
            com_height=gait.com_height,
            step_length=gait.step_length,
            single_support_ratio=gait.single_support_ratio,
            switching_velocity=v0,
            gravity=GRAVITY,
        )
    else:
        sagittal = sagittal_plane(
            com_height=gait.com_height,
            step_length=gait.step_length,
            single_support_ratio=gait.single_support_ratio,
            switching_velocity=v0,
            inverse_a_s=inverse_a_s,
            c_s=gait.c_s,
            gravity=GRAVITY,
        )
    angle = 0.5 * math.sqrt(gait.c_y * GRAVITY / gait.com_height) * sagittal.single.duration
    if not angle <= _LARGEST_ANGLE:
        raise MathematicalRefusal(
            f"single support lasts {2.0 * angle:.4g} time constants of the lateral pendulum, more than "
            f"{2.0 * _LARGEST_ANGLE:g}: no side to side motion of that period can be computed",
            reason="single_support_too_long",
            value=2.0 * angle,
            limit=2.0 * _LARGEST_ANGLE,
            unit="1",
            way_out="raise gait.switching_velocity, shorten gait.step_length or lower gait.c_y",
        )
    if gait.model == "ipm":
        return sagittal, plain_frontal_plane(
            com_height=gait.com_height,
            half_width=0.5 * gait.step_width,
            single_support_duration=sagittal.single.duration,
            double_support_duration=sagittal.double.duration,
            gravity=GRAVITY,
        )
    return sagittal, frontal_plane(
        com_height=gait.com_height,
        half_width=0.5 * gait.step_width,
        c_y=gait.c_y,
        single_support_duration=sagittal.single.duration,
        double_support_duration=sagittal.double.duration,
        gravity=GRAVITY,
    )


def _check_plain(gait: GaitParameters) -> None:
    """Refuse slopes that the plain inverted pendulum does not have, rather than ignore them."""
    for key, fixed in (("a_s", math.inf), ("c_s", 1.0), ("c_y", 1.0)):
        value = getattr(gait, key)
        if value != fixed:
            raise MathematicalRefusal(
                f"gait.{key} = {value:.6g} is no choice of the plain inverted pendulum (gait.model = ipm): "
                "its ZMP rests under the foot and its force passes through the COM, so that "
                f"gait.{key} = {fixed:g}",
                reason="not_the_plain_pendulum",
                value=value,
                limit=fixed,
                unit="1",
                way_out=f"set gait.{key} to {fixed:g}, take the preset ipm, or gait.model = ampm",
            )


def _rounded_up(value: float) -> str:
    """``value`` with four digits, never below it."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.ceil(value / unit * (1.0 + 1e-12)) * unit:.4g}"


def _assemble(
    gait: GaitParameters, mass: float, sagittal: SagittalPlane, frontal: FrontalPlane, offset: float
) -> CentroidalPlan:
    """Lay the closed form out over the footsteps."""
    t_ss, t_ds = sagittal.single.duration, sagittal.double.duration
    step, length, w = t_ss + t_ds, gait.step_length, 0.5 * gait.step_width
    weight = mass * GRAVITY

    # L_x(t + T) = -L_x(t): half of what one single support adds; double support adds nothing.
    gained_x = weight * float(frontal.single.evaluate(t_ss).moment_arm_integral)
    # L_y returns to its start at every switch; its mean over a step is taken off.
    drift = (sagittal.single.force_slope - 1.0) * odd_double_integral(
        sagittal.single.rate, sagittal.single.odd, t_ss
    ) + (sagittal.double.force_slope - 1.0) * odd_double_integral(
        sagittal.double.rate, sagittal.double.odd, t_ds
    )
    start_y = weight * drift / step

    laws = ((frontal.single, frontal.double), frontal.mirrored())
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
        phases.append(
            CentroidalPhase(start, t_ss, (x, sign * w), sagittal.single, single_y, (-gained, start_y))
        )
        middle = (x + 0.5 * length, 0.0)
        phases.append(
            CentroidalPhase(start + t_ss, t_ds, middle, sagittal.double, double_y, (gained, start_y))
        )
    constants = PlanConstants(
        l_s=sagittal.l_s,
        l_d=sagittal.l_d,
        inverse_a_s=sagittal.inverse_a_s,
        a_d=sagittal.a_d,
        c_d=sagittal.c_d,
        single_support_duration=t_ss,
        double_support_duration=t_ds,
        s=frontal.s,
        beta=frontal.beta,
        lateral_switching_velocity=frontal.velocity,
        mean_velocity=length / step,
        angular_momentum_y_offset=offset,
    )
    contacts = Contacts(footsteps, tuple(supports))
    return CentroidalPlan(
        mass, GRAVITY, gait.com_height, gait.switching_velocity, contacts, tuple(phases), constants
    )

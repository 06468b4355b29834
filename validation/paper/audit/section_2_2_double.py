"""Section 2.2: the frontal plane's double support."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import sympy as sp

from validation.paper.audit.case import Case
from validation.paper.audit.frontal import (
    C_1,
    C_2,
    OMEGA_D,
    SINGLE,
    SLOPE,
    SPEED,
    T_LS,
    TAU,
    W_D,
    T,
    T_c,
    b,
    beta,
    c_y,
    exponential,
    s,
    v,
    y,
)
from validation.paper.audit.mechanics import H, g, m, moment_x, of_law, t
from validation.paper.audit.rows import Evidence, claim, symbolic, zero


def law(case: Case) -> Iterator[Evidence]:
    """From the ZMP of the double support to Eq. 7 and its c_3."""
    normal, momentum = case.normal, case.momentum
    constants, width = normal.constants, normal.half_width
    beta_, s_ = constants.beta, constants.s
    lateral, foot = normal.switch.com[0, 1], 0.5 * normal.gait.step_width
    at_foot = sp.solve(sp.Eq(SLOPE * beta, beta + s), SLOPE)[0]
    yield Evidence(
        "2.2",
        "z_y",
        symbolic(
            "printed",
            "slope less the one that puts the ZMP at the foot at y = beta",
            beta / (beta + s) - at_foot,
        ),
        zero("printed", "jump of the ZMP at the switch", beta_ / width * lateral - foot, "m"),
        symbolic("corrected", "the same", (beta + s) / beta - at_foot),
        zero("corrected", "jump of the ZMP at the switch", width / beta_ * lateral - foot, "m"),
    )
    middle = momentum.plan.sample([momentum.t_ss, momentum.t_ss + 0.5 * momentum.t_ds])
    moments, levels = np.abs(middle.moment[:, 0]), np.abs(middle.angular_momentum[:, 0])
    yield Evidence(
        "2.2",
        "towards the origin",
        claim(
            "printed",
            "growth of |L_x| from the switch to the midline, to be negative",
            levels[1] - levels[0],
            "N m s",
            levels[1] < levels[0],
            momentum.name,
        ),
        claim(
            "corrected",
            "growth of |M_x| from the switch to the midline, to be negative",
            moments[1] - moments[0],
            "N m",
            moments[1] < moments[0],
            momentum.name,
        ),
    )
    c_3 = sp.Symbol("c_3", real=True)
    zmp = (beta + s) / beta * y
    before = -g / H * c_y * s  # at y = beta: the foot pulls the COM back as in single support
    matched = sp.solve(sp.Eq((g / H * c_3 * (y - zmp)).subs(y, beta), before), c_3)[0]
    printed_c_3 = (beta + (1 - c_y) * s) / beta
    yield Evidence(
        "2.2",
        "Eq. 7",
        symbolic("printed", "c_3 that continues the force, less c_y", matched - c_y),
        symbolic(
            "printed",
            "M_x - m g (c_y - 1)(y - z_y) with that c_3",
            moment_x(zmp, y, g / H * c_y * (y - zmp)) - m * g * (c_y - 1) * (y - zmp),
        ),
    )
    slope = (beta_ + (1.0 - normal.gait.c_y) * s_) / beta_
    wanted = -normal.gait.c_y * normal.g_over_h * s_
    yield Evidence(
        "2.2",
        "c_3",
        symbolic("printed", "c_3 less the one that continues the force, a_cogy = c_y", printed_c_3 - matched),
        claim("printed", "c_3, to be negative", slope, "1", slope < 0.0),
        zero(
            "printed",
            "jump of y'' at the switch with Eq. 7",
            normal.g_over_h * slope * (beta_ - width) - wanted,
            "m/s^2",
            scale=normal.plan.gravity,
        ),
        zero(
            "printed",
            "jump of y'' at the switch with Eq. 7",
            momentum.g_over_h * (-_printed_c_3(momentum) + momentum.gait.c_y) * momentum.constants.s,
            "m/s^2",
            momentum.name,
            scale=normal.plan.gravity,
        ),
        symbolic("corrected", "c_3 y - z_y - c_y (y - z_y)", printed_c_3 * y - zmp - c_y * (y - zmp)),
        zero(
            "corrected",
            "jump of y'' at the switch with c_3 y - z_y",
            normal.g_over_h * (slope * beta_ - width) - wanted,
            "m/s^2",
            scale=normal.plan.gravity,
        ),
    )


def _printed_c_3(numbers: Any) -> float:
    constants = numbers.constants
    return float((constants.beta + (1.0 - numbers.gait.c_y) * constants.s) / constants.beta)


def solution(case: Case) -> Iterator[Evidence]:
    """From the general solution to the ground force."""
    normal = case.normal
    constants = normal.constants
    rate = -g / H * c_y * s / beta
    t_c = 1.0 / math.sqrt(normal.g_over_h)
    wanted = -(normal.w_d**2) * constants.beta
    pulled = normal.switch.com_acceleration[0, 1]  # left foot: the COM, left of the midline, is caught
    general = C_1 * sp.cos(t * W_D) + C_2 * sp.sin(t * W_D)
    yield Evidence(
        "2.2",
        "double support, b",
        symbolic(
            "printed",
            "law of the double support, its own T_c in both terms",
            of_law(general - b * W_D**2, rate),
        ),
        zero(
            "printed",
            "y(t_2) + y(t_3), zero by symmetry, with b the feet's half distance and b/T_c^2 as a number",
            -2.0 * normal.half_width / t_c**2,
            "m",
        ),
        symbolic("corrected", "law of the double support", of_law(general, rate)),
        zero("corrected", "y(t_2) + y(t_3)", _ends_of_double(case), "m"),
    )
    printed = C_1 * sp.cos(t / T_c) + C_2 * sp.sin(t / T_c)
    yield Evidence(
        "2.2",
        "double support, T_c",
        symbolic("printed", "law of the double support", of_law(printed, rate)),
        zero(
            "printed",
            "jump of y'' at the switch",
            -constants.beta / t_c**2 - pulled,
            "m/s^2",
            scale=normal.plan.gravity,
        ),
        symbolic("corrected", "law of the double support", of_law(general, rate)),
        zero("corrected", "jump of y'' at the switch", wanted - pulled, "m/s^2", scale=normal.plan.gravity),
    )
    end, speed = -normal.switch.com[0, 1], -normal.switch.com_velocity[0, 1]
    yield Evidence(
        "2.2",
        "double support, cos",
        symbolic(
            "printed",
            "distance from the midline at t_2, less what Eq. 6 leaves of s + beta",
            exponential(beta + s - (s + beta - SINGLE.subs(t, T))),
        ),
        zero(
            "printed",
            "jump of the COM at the switch, distances from the midline",
            constants.beta + constants.s - abs(end),
            "m",
        ),
        symbolic("corrected", "the same", exponential(beta - (s + beta - SINGLE.subs(t, T)))),
        zero("corrected", "jump of the COM at the switch", -constants.beta - end, "m"),
    )
    yield Evidence(
        "2.2",
        "double support, sin",
        symbolic(
            "printed",
            "speed at t_2 less that of Eq. 6 at T, right rate; v_ex = s tau",
            s * TAU * OMEGA_D - s * TAU / T_LS,
        ),
        zero("printed", "jump of the lateral speed, right rate", normal.v_ex * normal.w_d - speed, "m/s"),
        zero(
            "printed",
            "jump of the lateral speed, T_c as printed",
            normal.v_ex / t_c - speed,
            "m/s",
        ),
        symbolic("corrected", "speed at t_2 less that of Eq. 6 at T", exponential(SPEED / W_D * W_D - SPEED)),
        zero(
            "corrected",
            "jump of the lateral speed",
            constants.lateral_switching_velocity / normal.w_d * normal.w_d - speed,
            "m/s",
        ),
    )
    yield Evidence(
        "2.2",
        "double support, signs",
        symbolic(
            "printed",
            "y(t_2) v + y'(t_2) beta, zero if the COG comes from its foot at speed v",
            _outward(1),
        ),
        zero(
            "printed",
            "jump of the lateral velocity towards the midline, else corrected",
            -constants.lateral_switching_velocity - speed,
            "m/s",
        ),
        symbolic("corrected", "the same", _outward(-1)),
        zero(
            "corrected",
            "jump of the lateral velocity towards the midline",
            constants.lateral_switching_velocity - speed,
            "m/s",
        ),
    )
    force = constants.beta + constants.s
    yield Evidence(
        "2.2",
        "double support, F_y",
        symbolic("printed", "F_y - m y'' at t_2, magnitudes", -m / T_c**2 * (beta + s) - m * rate * beta),
        zero(
            "printed",
            "jump of |F_y| at the switch",
            normal.plan.mass * force / t_c**2 - abs(normal.switch.force[0, 1]),
            "N",
            scale=normal.plan.weight,
        ),
        symbolic("corrected", "the same", -m * W_D**2 * beta - m * rate * beta),
        zero(
            "corrected",
            "jump of |F_y| at the switch",
            normal.plan.mass * normal.w_d**2 * constants.beta - abs(normal.switch.force[0, 1]),
            "N",
            scale=normal.plan.weight,
        ),
    )


def _outward(sign: int) -> Any:
    """Zero if position and velocity at t_2 are as -beta and v; ``sign`` is that of the cosine."""
    path = sign * beta * sp.cos(t * W_D) + v / W_D * sp.sin(t * W_D)
    return path.subs(t, 0) * v + sp.diff(path, t).subs(t, 0) * beta


def _ends_of_double(case: Case) -> float:
    """Sum of the COM's y at both ends of the first double support [m]."""
    normal = case.normal
    return float(normal.plan.sample([normal.t_ss, normal.constants.step_duration]).com[:, 1].sum())

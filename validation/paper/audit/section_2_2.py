"""Section 2.2: the frontal plane."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import sympy as sp

from validation.paper.audit import section_2_2_double
from validation.paper.audit.case import Case
from validation.paper.audit.frontal import SINGLE, T_LS, TAU, V_EX, T, T_l, c_y, exponential, s, y
from validation.paper.audit.mechanics import H, acceleration_towards, g, m, moment_x, of_law, t
from validation.paper.audit.rows import Evidence, symbolic, zero


def rows(case: Case) -> Iterator[Evidence]:
    """Section 2.2, from top to bottom."""
    yield from _single(case)
    yield from section_2_2_double.law(case)
    yield from section_2_2_double.solution(case)
    yield from _closing(case)


def _single(case: Case) -> Iterator[Evidence]:
    normal = case.normal
    constants, width = normal.constants, normal.half_width
    lateral = normal.plan.sample([0.0, normal.t_ss, constants.step_duration]).com[:, 1]
    yield Evidence(
        "2.2",
        "feet",
        zero("printed", "s + beta less half the feet's distance", constants.s + constants.beta - width, "m"),
        zero(
            "printed",
            "COM's travel in double support less 2 beta",
            lateral[1] - lateral[2] - 2.0 * constants.beta,
            "m",
        ),
    )
    yield Evidence(
        "2.2",
        "way and back",
        symbolic(
            "printed",
            "y(T - t) - y(t); speed at T/2",
            (
                exponential(SINGLE.subs(t, T - t) - SINGLE),
                exponential(sp.diff(SINGLE, t).subs(t, T / 2)),
            ),
        ),
    )
    yield Evidence(
        "2.2",
        "Eq. 5",
        symbolic(
            "printed",
            "force line from the foot to c_y y",
            acceleration_towards(0, c_y * y) / g - c_y * y / H,
        ),
    )
    yield Evidence(
        "2.2",
        "Eq. 6",
        symbolic("printed", "Eq. 5; y(0) - s", (of_law(SINGLE, g / H * c_y), SINGLE.subs(t, 0) - s)),
    )
    yield Evidence(
        "2.2",
        "v_ex",
        symbolic(
            "printed",
            "y(T) - s; v_ex - s tanh(T/(2 T_ls))",
            (exponential(SINGLE.subs(t, T) - s), exponential(V_EX - s * sp.tanh(T / (2 * T_l)))),
        ),
    )
    speed = constants.lateral_switching_velocity
    start = -sp.diff(SINGLE, t).subs(t, 0)
    yield Evidence(
        "2.2",
        "v_ex, meaning",
        symbolic("printed", "-y'(0) - v_ex, tau = tanh(T/(2 T_ls))", s * TAU / T_LS - s * TAU),
        zero("printed", "lateral speed at the switch less v_ex as a number", speed - normal.v_ex, "m/s"),
        symbolic("corrected", "-y'(0) T_ls - v_ex", exponential(start * T_l - V_EX)),
        zero(
            "corrected",
            "lateral speed at the switch less v_ex/T_ls",
            speed - normal.v_ex / normal.t_l,
            "m/s",
        ),
    )
    yield Evidence(
        "2.2",
        "single support, F_y",
        symbolic("printed", "F_y - m y'', y_0 = s", m / T_l**2 * SINGLE - m * sp.diff(SINGLE, t, 2)),
    )
    state = normal.switch
    moment, height, mass = state.moment[0, 0], normal.gait.com_height, normal.plan.mass
    from_foot = state.com[0, 1] - state.zmp[0, 1]
    acceleration = state.com_acceleration[0, 1]
    weight = normal.plan.weight
    vertical = sp.Symbol("F_z", real=True)
    held = sp.solve(sp.Eq(vertical - m * g, 0), vertical)[0]  # Newton: the height does not change
    yield Evidence(
        "2.2",
        "F_z",
        symbolic("printed", "vertical force on a body at constant height, less F_z", held + m * g),
        zero(
            "printed",
            "vertical force of the plan less F_z",
            state.force[0, 2] + weight,
            "N",
            scale=weight,
        ),
        symbolic("corrected", "the same", held - m * g),
        zero(
            "corrected",
            "vertical force of the plan less F_z",
            state.force[0, 2] - weight,
            "N",
            scale=weight,
        ),
    )
    rising = g / H * c_y * y
    yield Evidence(
        "2.2",
        "single support, r_x",
        symbolic(
            "printed",
            "r_x - ((p - c) x F)_x, F_z = -m g",
            y * (-m * g) - H * m * rising - moment_x(0, y, rising),
        ),
        zero(
            "printed",
            "mismatch at the switch",
            from_foot * -weight - height * mass * acceleration - moment,
            "N m",
            scale=weight,
        ),
        symbolic(
            "corrected",
            "M_x - ((p - c) x F)_x, F_z = m g",
            H * m * rising - y * m * g - moment_x(0, y, rising),
        ),
        zero(
            "corrected",
            "mismatch at the switch",
            height * mass * acceleration - from_foot * weight - moment,
            "N m",
            scale=weight,
        ),
    )


def _closing(case: Case) -> Iterator[Evidence]:
    normal, momentum = case.normal, case.momentum
    yield Evidence(
        "2.2",
        "double support, moment",
        zero(
            "printed",
            "M_x - m g (c_y - 1)(y - z_y), largest over a stride",
            _moment_mismatch(case),
            "N m",
            momentum.name,
            scale=momentum.plan.weight,
        ),
    )
    gained = momentum.plan.sample([0.0, momentum.t_ss]).angular_momentum[:, 0]
    whole = momentum.stride.angular_momentum[[0, -1], 0]
    shape = sp.integrate(m * g * (c_y - 1) * sp.cosh(t), (t, -T, T))
    yield Evidence(
        "2.2",
        "symmetry",
        symbolic("printed", "integral of M_x over a single support, y ~ cosh(t)", shape),
        zero("printed", "L_x gained in one single support", gained[1] - gained[0], "N m s", momentum.name),
        zero(
            "corrected",
            "L_x gained in two steps",
            whole[1] - whole[0],
            "N m s",
            momentum.name,
            scale=momentum.plan.mass * momentum.gait.com_height,
        ),
    )
    free = 0.5 * normal.half_width
    yield Evidence(
        "2.2",
        "s and beta",
        zero(
            "printed",
            "lateral double support less the sagittal one, s = beta",
            _duration(case, free) - normal.t_ds,
            "s",
        ),
        zero(
            "corrected",
            "lateral double support less the sagittal one",
            _duration(case, normal.constants.beta) - normal.t_ds,
            "s",
        ),
    )


def _moment_mismatch(case: Case) -> float:
    momentum = case.momentum
    stride = momentum.stride
    formula = momentum.plan.weight * (momentum.gait.c_y - 1.0) * (stride.com[:, 1] - stride.zmp[:, 1])
    return float(np.abs(stride.moment[:, 0] - formula).max())


def _duration(case: Case, beta_: float) -> float:
    """Duration of the lateral double support of ``normal`` with another beta [s]."""
    normal = case.normal
    s_ = normal.half_width - beta_
    speed = s_ / normal.t_l * math.tanh(normal.t_ss / (2.0 * normal.t_l))
    w_d = math.sqrt(normal.gait.c_y * normal.g_over_h * s_ / beta_)
    return 2.0 / w_d * math.atan(beta_ * w_d / speed)

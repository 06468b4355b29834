"""Section 2.2: the frontal plane."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import sympy as sp

from validation.audit.case import Case
from validation.audit.mechanics import H, acceleration_towards, g, m, moment_x, of_law, t
from validation.audit.rows import Row, claim, symbolic, zero

y, b, C_1, C_2 = sp.symbols("y b C_1 C_2", real=True)
s, beta, c_y, T, v = sp.symbols("s beta c_y T v", positive=True)
T_l, T_c = sp.sqrt(H / (c_y * g)), sp.sqrt(H / g)
V_EX = (s * sp.cosh(T / T_l) - s) / sp.sinh(T / T_l)
SINGLE = s * sp.cosh(t / T_l) - V_EX * sp.sinh(t / T_l)
"""Eq. 6: COM from the stance foot, towards the midline."""
W_D = sp.sqrt(g * c_y * s / (H * beta))
SPEED = sp.diff(SINGLE, t).subs(t, T)
"""Lateral speed at the end of the single support."""
TAU, T_LS, OMEGA_D = sp.symbols("tau T_ls omega_d", positive=True)
"""tanh(T/(2 T_ls)) and the rates as letters, for residuals that a reader can take in."""
SLOPE = sp.Symbol("z_y", real=True)


def rows(case: Case) -> Iterator[Row]:
    """Section 2.2, from top to bottom."""
    yield from _single(case)
    yield from _double_law(case)
    yield from _double_solution(case)
    yield from _closing(case)


def _single(case: Case) -> Iterator[Row]:
    normal = case.normal
    constants, width = normal.constants, normal.half_width
    yield Row(
        "2.2",
        "Fig. 5, axes",
        "the coordinate systems are those of Kajita et al.",
        why="Another paper's; Figure 5 is a drawing. Its caption is taken at its word: origin at the ZMP "
        "in single support, at the centre in double support.",
    )
    lateral = normal.plan.sample([0.0, normal.t_ss, constants.step_duration]).com[:, 1]
    yield Row(
        "2.2",
        "feet",
        "the feet are 2 s + 2 beta apart; the COG travels 2 beta in double support",
        checks=(
            zero(
                "printed", "s + beta less half the feet's distance", constants.s + constants.beta - width, "m"
            ),
            zero(
                "printed",
                "COM's travel in double support less 2 beta",
                lateral[1] - lateral[2] - 2.0 * constants.beta,
                "m",
            ),
        ),
    )
    yield Row(
        "2.2",
        "way and back",
        "in single support the COG travels until it stops, and returns by the same path",
        checks=(
            symbolic(
                "printed",
                "y(T - t) - y(t); speed at T/2",
                (
                    _exponential(SINGLE.subs(t, T - t) - SINGLE),
                    _exponential(sp.diff(SINGLE, t).subs(t, T / 2)),
                ),
            ),
        ),
    )
    yield Row(
        "2.2",
        "Eq. 5",
        "y'' : (z'' + g) = c_y y : H",
        checks=(
            symbolic(
                "printed",
                "force line from the foot to c_y y",
                acceleration_towards(0, c_y * y) / g - c_y * y / H,
            ),
        ),
        why="c_y is the user's choice above 0; at 0 nothing drives the COM back.",
    )
    yield Row(
        "2.2",
        "Eq. 6",
        "y = s cosh(t/T_ls) - v_ex sinh(t/T_ls), T_ls = sqrt(H/(c_y g))",
        checks=(
            symbolic("printed", "Eq. 5; y(0) - s", (of_law(SINGLE, g / H * c_y), SINGLE.subs(t, 0) - s)),
        ),
    )
    yield Row(
        "2.2",
        "v_ex",
        "v_ex = (-s + s cosh(T/T_ls))/sinh(T/T_ls), from y(T) = s, T = t_2 - t_0 from the sagittal plane",
        checks=(
            symbolic(
                "printed",
                "y(T) - s; v_ex - s tanh(T/(2 T_ls))",
                (_exponential(SINGLE.subs(t, T) - s), _exponential(V_EX - s * sp.tanh(T / (2 * T_l)))),
            ),
        ),
        why="t counts from t_0 here, and from t_2 in the double support.",
    )
    speed = constants.lateral_switching_velocity
    start = -sp.diff(SINGLE, t).subs(t, 0)
    yield Row(
        "2.2",
        "v_ex, meaning",
        "v_ex is the velocity when the single support phase starts",
        "a length, T_ls times that velocity",
        checks=(
            symbolic("printed", "-y'(0) - v_ex, tau = tanh(T/(2 T_ls))", s * TAU / T_LS - s * TAU),
            zero("printed", "lateral speed at the switch less v_ex as a number", speed - normal.v_ex, "m/s"),
            symbolic("corrected", "-y'(0) T_ls - v_ex", _exponential(start * T_l - V_EX)),
            zero(
                "corrected",
                "lateral speed at the switch less v_ex/T_ls",
                speed - normal.v_ex / normal.t_l,
                "m/s",
            ),
        ),
        errata=("E6",),
    )
    yield Row(
        "2.2",
        "single support, F_y",
        "F_y = (m/T_ls^2)(y_0 cosh(t/T_ls) - v_ex sinh(t/T_ls))",
        checks=(
            symbolic("printed", "F_y - m y'', y_0 = s", m / T_l**2 * SINGLE - m * sp.diff(SINGLE, t, 2)),
        ),
        why="y_0 is section 1.2's name for the start, which is s here.",
    )
    state = normal.switch
    moment, height, mass = state.moment[0, 0], normal.gait.com_height, normal.plan.mass
    from_foot = state.com[0, 1] - state.zmp[0, 1]
    acceleration = state.com_acceleration[0, 1]
    weight = normal.plan.weight
    vertical = sp.Symbol("F_z", real=True)
    held = sp.solve(sp.Eq(vertical - m * g, 0), vertical)[0]  # Newton: the height does not change
    yield Row(
        "2.2",
        "F_z",
        "F_z = -m g (in both phases)",
        "F_z = m g, on the body, as in section 2",
        checks=(
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
        ),
        errata=("E11",),
        why="F_y above it is the force on the body, so this cannot be the force on the floor.",
    )
    rising = g / H * c_y * y
    yield Row(
        "2.2",
        "single support, r_x",
        "r_x = y F_z - H F_y",
        "M_x = H F_y - y F_z",
        checks=(
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
        ),
        errata=("E11",),
        why="The printed moment does not even vanish at c_y = 1, where the force passes through the COM.",
    )


def _double_law(case: Case) -> Iterator[Row]:
    normal, momentum = case.normal, case.momentum
    constants, width = normal.constants, normal.half_width
    beta_, s_ = constants.beta, constants.s
    lateral, foot = normal.switch.com[0, 1], 0.5 * normal.gait.step_width
    at_foot = sp.solve(sp.Eq(SLOPE * beta, beta + s), SLOPE)[0]
    yield Row(
        "2.2",
        "z_y",
        "z_y = beta/(beta + s) y",
        "z_y = (beta + s)/beta y",
        checks=(
            symbolic(
                "printed",
                "slope less the one that puts the ZMP at the foot at y = beta",
                beta / (beta + s) - at_foot,
            ),
            zero("printed", "jump of the ZMP at the switch", beta_ / width * lateral - foot, "m"),
            symbolic("corrected", "the same", (beta + s) / beta - at_foot),
            zero("corrected", "jump of the ZMP at the switch", width / beta_ * lateral - foot, "m"),
        ),
        errata=("E7",),
    )
    middle = momentum.plan.sample([momentum.t_ss, momentum.t_ss + 0.5 * momentum.t_ds])
    moments, levels = np.abs(middle.moment[:, 0]), np.abs(middle.angular_momentum[:, 0])
    yield Row(
        "2.2",
        "towards the origin",
        "in double support rotational momentum decreases as the COG approaches the origin",
        "the rotational moment decreases; the angular momentum is largest there",
        checks=(
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
        ),
        errata=("E22",),
        why="'Rotational momentum' stands for moment in several places of sections 2 and 2.2; on the normal "
        "gait (c_y = 1) both are zero.",
    )
    c_3 = sp.Symbol("c_3", real=True)
    zmp = (beta + s) / beta * y
    before = -g / H * c_y * s  # at y = beta: the foot pulls the COM back as in single support
    matched = sp.solve(sp.Eq((g / H * c_3 * (y - zmp)).subs(y, beta), before), c_3)[0]
    printed_c_3 = (beta + (1 - c_y) * s) / beta
    yield Row(
        "2.2",
        "Eq. 7",
        "y'' : g = c_3 (y - z_y) : H",
        checks=(
            symbolic("printed", "c_3 that continues the force, less c_y", matched - c_y),
            symbolic(
                "printed",
                "M_x - m g (c_y - 1)(y - z_y) with that c_3",
                moment_x(zmp, y, g / H * c_y * (y - zmp)) - m * g * (c_y - 1) * (y - zmp),
            ),
        ),
        why="With c_3 = c_y, and the ZMP of E7. (With the ZMP as printed, the same motion needs "
        "c_3 = -c_y (beta + s)/beta, which is negative: perhaps the origin of the sign printed next.)",
    )
    slope = (beta_ + (1.0 - normal.gait.c_y) * s_) / beta_
    wanted = -normal.gait.c_y * normal.g_over_h * s_
    yield Row(
        "2.2",
        "c_3",
        "c_3 = (beta + (1 - a_cogy) s)/beta < 0",
        "c_3 = c_y in Eq. 7; or this c_3, with a_cogy = c_y, in y'' : g = (c_3 y - z_y) : H",
        checks=(
            symbolic(
                "printed", "c_3 less the one that continues the force, a_cogy = c_y", printed_c_3 - matched
            ),
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
        ),
        errata=("E8",),
        why="a_cogy is defined nowhere. At c_y = 1 the printed c_3 is 1 and only its sign is wrong; it is "
        "the whole bracket that is negative.",
    )


def _printed_c_3(numbers: Any) -> float:
    constants = numbers.constants
    return float((constants.beta + (1.0 - numbers.gait.c_y) * constants.s) / constants.beta)


def _double_solution(case: Case) -> Iterator[Row]:
    normal = case.normal
    constants = normal.constants
    rate = -g / H * c_y * s / beta
    t_c = 1.0 / math.sqrt(normal.g_over_h)
    wanted = -(normal.w_d**2) * constants.beta
    pulled = normal.switch.com_acceleration[0, 1]  # left foot: the COM, left of the midline, is caught
    general = C_1 * sp.cos(t * W_D) + C_2 * sp.sin(t * W_D)
    yield Row(
        "2.2",
        "double support, b",
        "y = C_1 cos + C_2 sin - b/T_c^2",
        "y = C_1 cos + C_2 sin",
        checks=(
            symbolic(
                "printed",
                "law of the double support, its own T_c in both terms",
                of_law(general - b * W_D**2, rate),
            ),
            zero(
                "printed",
                "y(t_2) + y(t_3) with b the feet's half distance, zero by symmetry",
                -2.0 * normal.half_width / t_c**2,
                "m",
            ),
            symbolic("corrected", "law of the double support", of_law(general, rate)),
            zero("corrected", "y(t_2) + y(t_3)", _ends_of_double(case), "m"),
        ),
        errata=("E10",),
        why="b belongs to section 2, is no part of this law, and b/T_c^2 is no length.",
    )
    printed = C_1 * sp.cos(t / T_c) + C_2 * sp.sin(t / T_c)
    yield Row(
        "2.2",
        "double support, T_c",
        "T_c = sqrt(H/g), as defined in section 1.2",
        "1/omega_d = sqrt(H beta/(g c_y s))",
        checks=(
            symbolic("printed", "law of the double support", of_law(printed, rate)),
            zero(
                "printed",
                "jump of y'' at the switch",
                -constants.beta / t_c**2 - pulled,
                "m/s^2",
                scale=normal.plan.gravity,
            ),
            symbolic("corrected", "law of the double support", of_law(general, rate)),
            zero(
                "corrected", "jump of y'' at the switch", wanted - pulled, "m/s^2", scale=normal.plan.gravity
            ),
        ),
        errata=("E15",),
    )
    end, speed = -normal.switch.com[0, 1], -normal.switch.com_velocity[0, 1]
    yield Row(
        "2.2",
        "double support, cos",
        "y = (beta + s) cos((t - t_2)/T_c) + ...",
        "y = -beta cos((t - t_2) omega_d) + ...",
        checks=(
            symbolic(
                "printed",
                "distance from the midline at t_2, less what Eq. 6 leaves of s + beta",
                _exponential(beta + s - (s + beta - SINGLE.subs(t, T))),
            ),
            zero(
                "printed",
                "jump of the COM at the switch, distances from the midline",
                constants.beta + constants.s - abs(end),
                "m",
            ),
            symbolic("corrected", "the same", _exponential(beta - (s + beta - SINGLE.subs(t, T)))),
            zero("corrected", "jump of the COM at the switch", -constants.beta - end, "m"),
        ),
        errata=("E9",),
    )
    yield Row(
        "2.2",
        "double support, sin",
        "... + v_ex sin((t - t_2)/T_c)  (typeset v_e x)",
        "... + (v/omega_d) sin((t - t_2) omega_d)",
        checks=(
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
            symbolic(
                "corrected", "speed at t_2 less that of Eq. 6 at T", _exponential(SPEED / W_D * W_D - SPEED)
            ),
            zero(
                "corrected",
                "jump of the lateral speed",
                constants.lateral_switching_velocity / normal.w_d * normal.w_d - speed,
                "m/s",
            ),
        ),
        errata=("E6",),
        why="At c_y = 1 section 1.2's T_c is T_ls, and E15 hides E6: at any other c_y, and with the right "
        "rate, the speed jumps.",
    )
    yield Row(
        "2.2",
        "double support, signs",
        "both terms with the same sign: + cos, + sin",
        "opposite signs: the COG moves from one foot over the midline to the other",
        checks=(
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
        ),
        errata=("E23",),
        why="Whichever way y points, a COG that starts on one side and moves away from the midline does not "
        "cross it within this phase.",
    )
    force = constants.beta + constants.s
    yield Row(
        "2.2",
        "double support, F_y",
        "F_y = -(m/T_c^2)((beta + s) cos((t - t_2)/T_c) + v_ex sin((t - t_2)/T_c))",
        "F_y = -m omega_d^2 (-beta cos((t - t_2) omega_d) + (v/omega_d) sin((t - t_2) omega_d))",
        checks=(
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
        ),
        errata=("E6", "E9", "E15", "E23"),
        why="It is m y'' of the printed trajectory, and inherits its misprints.",
    )


def _outward(sign: int) -> Any:
    """Zero if position and velocity at t_2 are as -beta and v; ``sign`` is that of the cosine."""
    path = sign * beta * sp.cos(t * W_D) + v / W_D * sp.sin(t * W_D)
    return path.subs(t, 0) * v + sp.diff(path, t).subs(t, 0) * beta


def _ends_of_double(case: Case) -> float:
    """Sum of the COM's y at both ends of the first double support [m]."""
    normal = case.normal
    return float(normal.plan.sample([normal.t_ss, normal.constants.step_duration]).com[:, 1].sum())


def _closing(case: Case) -> Iterator[Row]:
    normal, momentum = case.normal, case.momentum
    yield Row(
        "2.2",
        "double support, moment",
        "the moment follows from Eq. 7 as in the sagittal plane",
        checks=(
            zero(
                "printed",
                "M_x - m g (c_y - 1)(y - z_y), largest over a stride",
                _moment_mismatch(case),
                "N m",
                momentum.name,
                scale=momentum.plan.weight,
            ),
        ),
    )
    gained = momentum.plan.sample([0.0, momentum.t_ss]).angular_momentum[:, 0]
    whole = momentum.stride.angular_momentum[[0, -1], 0]
    shape = sp.integrate(m * g * (c_y - 1) * sp.cosh(t), (t, -T, T))
    yield Row(
        "2.2",
        "symmetry",
        "because of the symmetry with respect to time, nothing is tuned to compensate the angular momentum",
        "because left and right mirror each other: what one single support adds, the next takes off",
        checks=(
            symbolic("printed", "integral of M_x over a single support, y ~ cosh(t)", shape),
            zero(
                "printed", "L_x gained in one single support", gained[1] - gained[0], "N m s", momentum.name
            ),
            zero(
                "corrected",
                "L_x gained in two steps",
                whole[1] - whole[0],
                "N m s",
                momentum.name,
                scale=momentum.plan.mass * momentum.gait.com_height,
            ),
        ),
        errata=("E24",),
        why="In single support y is even in time, so the moment keeps its sign (zero on the normal gait).",
    )
    free = 0.5 * normal.half_width
    yield Row(
        "2.2",
        "s and beta",
        "s and beta are given with the feet; nothing determines beta",
        "rho atan(rho/tau) = T_DS/(2 T_ls), tau = tanh(T_SS/(2 T_ls)), beta/s = rho^2",
        checks=(
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
        ),
        errata=("E13",),
        why="Both durations come from the sagittal plane, so one of s, beta, c_y must give way. The "
        "condition has exactly one root.",
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


def _exponential(expression: Any) -> Any:
    """Hyperbolic functions as exponentials, in which sympy sees what cancels."""
    return sp.simplify(expression.rewrite(sp.exp))

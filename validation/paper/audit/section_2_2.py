"""Section 2.2: the frontal plane."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import sympy as sp

from validation.paper.audit.case import Case, Numbers
from validation.paper.audit.mechanics import H, acceleration_towards, g, m, moment_x, of_law, t
from validation.paper.audit.rows import Rows

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
"""tanh(T/(2 T_ls)) and the rates as letters, for short residuals."""
SLOPE = sp.Symbol("z_y", real=True)
RATE = -g / H * c_y * s / beta
"""Of the double support's law, y'' over y."""
GENERAL = C_1 * sp.cos(t * W_D) + C_2 * sp.sin(t * W_D)
"""Solution of the double support's law."""


def exponential(expression: Any) -> Any:
    """Hyperbolic functions as exponentials, which sympy simplifies."""
    return sp.simplify(expression.rewrite(sp.exp))


def check(case: Case, rows: Rows) -> None:
    """Section 2.2, from top to bottom."""
    _single(case.normal, rows)
    _single_force(case.normal, rows)
    _double_law(case, rows)
    _double_constants(case.normal, rows)
    _double_ends(case.normal, rows)
    _closing(case, rows)


def _single(normal: Numbers, rows: Rows) -> None:
    constants = normal.constants
    lateral = normal.plan.sample([0.0, normal.t_ss, constants.step_duration]).com[:, 1]
    feet = rows["feet"]
    apart = constants.s + constants.beta - normal.half_width
    feet.zero("s + beta less half the feet's distance", "m", apart)
    travel = lateral[1] - lateral[2] - 2.0 * constants.beta
    feet.zero("COM's travel in double support less 2 beta", "m", travel)
    rows["way and back"].symbolic(
        "y(T - t) - y(t); speed at T/2",
        (exponential(SINGLE.subs(t, T - t) - SINGLE), exponential(sp.diff(SINGLE, t).subs(t, T / 2))),
    )
    rows["Eq. 5"].symbolic(
        "force line from the foot to c_y y", acceleration_towards(0, c_y * y) / g - c_y * y / H
    )
    rows["Eq. 6"].symbolic("Eq. 5; y(0) - s", (of_law(SINGLE, g / H * c_y), SINGLE.subs(t, 0) - s))
    rows["v_ex"].symbolic(
        "y(T) - s; v_ex - s tanh(T/(2 T_ls))",
        (exponential(SINGLE.subs(t, T) - s), exponential(V_EX - s * sp.tanh(T / (2 * T_l)))),
    )
    meaning, speed = rows["v_ex, meaning"], constants.lateral_switching_velocity
    meaning.symbolic("-y'(0) - v_ex, tau = tanh(T/(2 T_ls))", s * TAU / T_LS - s * TAU)
    meaning.zero("lateral speed at the switch less v_ex as a number", "m/s", speed - normal.v_ex)
    start = -sp.diff(SINGLE, t).subs(t, 0)
    meaning.symbolic("-y'(0) T_ls - v_ex", corrected=exponential(start * T_l - V_EX))
    apart = speed - normal.v_ex / normal.t_l
    meaning.zero("lateral speed at the switch less v_ex/T_ls", "m/s", corrected=apart)


def _single_force(normal: Numbers, rows: Rows) -> None:
    rows["single support, F_y"].symbolic(
        "F_y - m y'', y_0 = s", m / T_l**2 * SINGLE - m * sp.diff(SINGLE, t, 2)
    )
    state, weight, signs = normal.switch, normal.plan.weight, (-1, 1)  # of the printed, the corrected F_z
    vertical = sp.Symbol("F_z", real=True)
    held = sp.solve(sp.Eq(vertical - m * g, 0), vertical)[0]  # Newton's law at constant height
    force = rows["F_z"].symbolic(
        "vertical force on a body at constant height, less F_z", *(held - sign * m * g for sign in signs)
    )
    apart = (state.force[0, 2] - sign * weight for sign in signs)
    force.zero("vertical force of the plan less F_z", "N", *apart)
    rising, moment = g / H * c_y * y, rows["single support, r_x"]
    printed = y * (-m * g) - H * m * rising - moment_x(0, y, rising)
    moment.symbolic("r_x - ((p - c) x F)_x, F_z = -m g", printed)
    corrected = H * m * rising - y * m * g - moment_x(0, y, rising)
    moment.symbolic("M_x - ((p - c) x F)_x, F_z = m g", corrected=corrected)
    from_foot = state.com[0, 1] - state.zmp[0, 1]
    inertial = normal.gait.com_height * normal.plan.mass * state.com_acceleration[0, 1]
    apart = (sign * inertial - from_foot * weight - state.moment[0, 0] for sign in signs)
    moment.zero("mismatch at the switch", "N m", *apart)


def _printed_c_3(numbers: Numbers) -> float:
    constants = numbers.constants
    return float((constants.beta + (1.0 - numbers.gait.c_y) * constants.s) / constants.beta)


def _double_law(case: Case, rows: Rows) -> None:
    """From the ZMP of the double support to Eq. 7 and its c_3."""
    normal, momentum = case.normal, case.momentum
    constants, width = normal.constants, normal.half_width
    at_foot = sp.solve(sp.Eq(SLOPE * beta, beta + s), SLOPE)[0]
    slopes = (beta / (beta + s), (beta + s) / beta)
    zmp_slope = rows["z_y"].symbolic(
        "slope less the one that puts the ZMP at the foot at y = beta", *(slope - at_foot for slope in slopes)
    )
    numbers = (constants.beta / width, width / constants.beta)
    jumps = (slope * normal.switch.com[0, 1] - 0.5 * normal.gait.step_width for slope in numbers)
    zmp_slope.zero("jump of the ZMP at the switch", "m", *jumps)
    middle = momentum.plan.sample([momentum.t_ss, momentum.t_ss + 0.5 * momentum.t_ds])
    moments = np.abs(middle.moment[:, 0])
    towards = rows["towards the origin"]
    grown = moments[1] - moments[0]
    towards.sign("negative", "growth of |M_x| from the switch to the midline", "N m", grown, gait="momentum")
    c_3 = sp.Symbol("c_3", real=True)
    zmp = (beta + s) / beta * y
    before = -g / H * c_y * s  # at y = beta: the foot pulls the COM back as in single support
    matched = sp.solve(sp.Eq((g / H * c_3 * (y - zmp)).subs(y, beta), before), c_3)[0]
    equation = rows["Eq. 7"].symbolic("c_3 that continues the force, less c_y", matched - c_y)
    equation.symbolic(
        "M_x - m g (c_y - 1)(y - z_y) with that c_3",
        moment_x(zmp, y, g / H * c_y * (y - zmp)) - m * g * (c_y - 1) * (y - zmp),
    )
    printed, slope = (beta + (1 - c_y) * s) / beta, _printed_c_3(normal)
    wanted = -normal.gait.c_y * normal.g_over_h * constants.s
    third = rows["c_3"]
    third.symbolic("c_3 less the one that continues the force, a_cogy = c_y", printed - matched)
    third.sign("negative", "c_3", "1", slope)
    jump = normal.g_over_h * slope * (constants.beta - width) - wanted
    third.zero("jump of y'' at the switch with Eq. 7", "m/s^2", jump)
    jump = momentum.g_over_h * (-_printed_c_3(momentum) + momentum.gait.c_y) * momentum.constants.s
    third.zero("jump of y'' at the switch with Eq. 7", "m/s^2", jump, gait="momentum")
    third.symbolic("c_3 y - z_y - c_y (y - z_y)", corrected=printed * y - zmp - c_y * (y - zmp))
    jump = normal.g_over_h * (slope * constants.beta - width) - wanted
    third.zero("jump of y'' at the switch with c_3 y - z_y", "m/s^2", corrected=jump)


def _double_constants(normal: Numbers, rows: Rows) -> None:
    """The general solution, its offset b and its time constant."""
    constants, t_c = normal.constants, 1.0 / math.sqrt(normal.g_over_h)
    offset = rows["double support, b"]
    law = "law of the double support"
    offset.symbolic(f"{law}, its own T_c in both terms", of_law(GENERAL - b * W_D**2, RATE))
    offset.zero(
        "y(t_2) + y(t_3), zero by symmetry, with b the feet's half distance and b/T_c^2 as a number",
        "m",
        -2.0 * normal.half_width / t_c**2,
    )
    offset.symbolic(law, corrected=of_law(GENERAL, RATE))
    ends = normal.plan.sample([normal.t_ss, constants.step_duration]).com[:, 1]
    offset.zero("y(t_2) + y(t_3)", "m", corrected=float(ends.sum()))
    pulled = normal.switch.com_acceleration[0, 1]  # left foot: the COM, left of the midline, is caught
    own_rate = C_1 * sp.cos(t / T_c) + C_2 * sp.sin(t / T_c)
    period = rows["double support, T_c"].symbolic(law, of_law(own_rate, RATE), of_law(GENERAL, RATE))
    jumps = (-constants.beta / t_c**2 - pulled, -(normal.w_d**2) * constants.beta - pulled)
    period.zero("jump of y'' at the switch", "m/s^2", *jumps)


def _double_ends(normal: Numbers, rows: Rows) -> None:
    """Place, speed and force at the ends of the double support."""
    constants, t_c = normal.constants, 1.0 / math.sqrt(normal.g_over_h)
    end, speed = -normal.switch.com[0, 1], -normal.switch.com_velocity[0, 1]
    left = s + beta - SINGLE.subs(t, T)
    cosine = rows["double support, cos"].symbolic(
        "distance from the midline at t_2, less what Eq. 6 leaves of s + beta",
        exponential(beta + s - left),
        exponential(beta - left),
    )
    jumps = constants.beta + constants.s - abs(end), -constants.beta - end
    cosine.zero("jump of the COM at the switch, distances from the midline", "m", *jumps)
    sine = rows["double support, sin"].symbolic(
        "speed at t_2 less that of Eq. 6 at T, right rate; v_ex = s tau", s * TAU * OMEGA_D - s * TAU / T_LS
    )
    jump = normal.v_ex * normal.w_d - speed
    sine.zero("jump of the lateral speed, right rate", "m/s", jump)
    sine.zero("jump of the lateral speed, T_c as printed", "m/s", normal.v_ex / t_c - speed)
    kept = exponential(SPEED / W_D * W_D - SPEED)
    sine.symbolic("speed at t_2 less that of Eq. 6 at T", corrected=kept)
    jump = constants.lateral_switching_velocity / normal.w_d * normal.w_d - speed
    sine.zero("jump of the lateral speed", "m/s", corrected=jump)
    signs = rows["double support, signs"].symbolic(
        "y(t_2) v + y'(t_2) beta, zero if the COG comes from its foot at speed v", _outward(1), _outward(-1)
    )
    turned = (sign * constants.lateral_switching_velocity - speed for sign in (-1, 1))
    signs.zero("jump of the lateral velocity towards the midline", "m/s", *turned)
    lateral = rows["double support, F_y"].symbolic(
        "F_y - m y'' at t_2, magnitudes",
        -m / T_c**2 * (beta + s) - m * RATE * beta,
        -m * W_D**2 * beta - m * RATE * beta,
    )
    forces = (
        normal.plan.mass * (constants.beta + constants.s) / t_c**2,
        normal.plan.mass * normal.w_d**2 * constants.beta,
    )
    apart = (force - abs(normal.switch.force[0, 1]) for force in forces)
    lateral.zero("jump of |F_y| at the switch", "N", *apart)


def _outward(sign: int) -> Any:
    """Zero if position and velocity at t_2 are as -beta and v; ``sign`` is that of the cosine."""
    path = sign * beta * sp.cos(t * W_D) + v / W_D * sp.sin(t * W_D)
    return path.subs(t, 0) * v + sp.diff(path, t).subs(t, 0) * beta


def _closing(case: Case, rows: Rows) -> None:
    normal, momentum = case.normal, case.momentum
    stride, weight = momentum.stride, momentum.plan.weight
    formula = weight * (momentum.gait.c_y - 1.0) * (stride.com[:, 1] - stride.zmp[:, 1])
    apart = float(np.abs(stride.moment[:, 0] - formula).max())
    rows["double support, moment"].zero(
        "M_x - m g (c_y - 1)(y - z_y), largest over a stride", "N m", apart, gait="momentum"
    )
    gained = momentum.plan.sample([0.0, momentum.t_ss]).angular_momentum[:, 0]
    whole = stride.angular_momentum[[0, -1], 0]
    symmetry = rows["symmetry"].symbolic(
        "integral of M_x over a single support, y ~ cosh(t)",
        sp.integrate(m * g * (c_y - 1) * sp.cosh(t), (t, -T, T)),
    )
    symmetry.zero("L_x gained in one single support", "N m s", gained[1] - gained[0], gait="momentum")
    gain = whole[1] - whole[0]
    symmetry.zero("L_x gained in two steps", "N m s", corrected=gain, gait="momentum")
    durations = (_duration(normal, width) for width in (0.5 * normal.half_width, normal.constants.beta))
    rows["s and beta"].zero(
        "lateral double support less the sagittal one, printed with s = beta",
        "s",
        *(duration - normal.t_ds for duration in durations),
    )


def _duration(normal: Numbers, beta_: float) -> float:
    """Duration of the lateral double support of ``normal`` with another beta [s]."""
    s_ = normal.half_width - beta_
    speed = s_ / normal.t_l * math.tanh(normal.t_ss / (2.0 * normal.t_l))
    w_d = math.sqrt(normal.gait.c_y * normal.g_over_h * s_ / beta_)
    return 2.0 / w_d * math.atan(beta_ * w_d / speed)

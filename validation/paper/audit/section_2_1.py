"""Section 2.1: the sagittal plane."""

from __future__ import annotations

import numpy as np
import sympy as sp

from validation.paper.audit.case import Case, Numbers
from validation.paper.audit.mechanics import H, acceleration_towards, g, moment_y, of_law, t
from validation.paper.audit.rows import Rows

x, c_s, c_d, A, B, C_1, C_2 = sp.symbols("x c_s c_d A B C_1 C_2", real=True)
a_s, a_d, l_s, l_d, v_0, k = sp.symbols("a_s a_d l_s l_d v_0 k", positive=True)
BRACKET_S, BRACKET_D = sp.symbols("p q", positive=True)
"""c_s - 1/a_s and 1/a_d - c_d."""
FORCE_CONDITION = sp.Eq((c_s - 1 / a_s) * l_s, -(c_d - 1 / a_d) * l_d)
"""Eqs. 2 and 3 at the switch: the same acceleration from both sides."""
ZMP_CONDITION = sp.Eq(l_s / a_s + l_d / a_d, l_s + l_d)
"""The same ZMP from both sides: l_s/a_s ahead of the foot is l_d/a_d behind the middle of the feet."""


def check(case: Case, rows: Rows) -> None:
    """Section 2.1, from top to bottom."""
    _figure_4(case, rows)
    _laws(rows)
    _continuity(case, rows)
    _symmetry(case, rows)


def _figure_4(case: Case, rows: Rows) -> None:
    normal = case.normal
    constants, half = normal.constants, 0.5 * normal.gait.step_length
    start, switch, end = normal.plan.sample([0.0, normal.t_ss, constants.step_duration]).zmp[:, 0]
    roll, lag = constants.l_s * constants.inverse_a_s, constants.l_d / constants.a_d
    in_place = np.array([start + roll, switch - roll, switch - half + lag, end - half - lag])
    rows["Fig. 4, positions"].zero("largest mismatch of Z_0, Z_1, Z_0'", "m", np.abs(in_place).max())
    rows["Fig. 4, Z_1"].zero("l_s/a_s + l_d/a_d - l_s - l_d", "m", roll + lag - half)
    jumps = switch - start, switch - (half - lag)
    rows["Fig. 4, ZMP"].zero("jump of the ZMP at the switch", "m", *jumps)


def _laws(rows: Rows) -> None:
    for number, slope, force in ((2, a_s, c_s), (3, a_d, c_d)):
        ratio = acceleration_towards(x / slope, force * x) / g
        rows[f"Eq. {number}"].symbolic("force line from x/a to c x", ratio - x * (force - 1 / slope) / H)
    T_s, T_d = sp.sqrt(H / (BRACKET_S * g)), sp.sqrt(H / (BRACKET_D * g))
    single = C_1 * sp.cosh(t / T_s) + C_2 * sp.sinh(t / T_s)
    double = C_1 * sp.cos(t / T_d) + C_2 * sp.sin(t / T_d)
    rows["single support"].symbolic("Eq. 2, p = c_s - 1/a_s", of_law(single, g / H * BRACKET_S))
    rows["double support"].symbolic("Eq. 3, q = 1/a_d - c_d", of_law(double, -g / H * BRACKET_D))
    bracket_d = sp.solve(FORCE_CONDITION, c_d)[0] - 1 / a_d
    rows["signs"].symbolic("(c_d - 1/a_d)/(c_s - 1/a_s) + l_s/l_d", bracket_d / (c_s - 1 / a_s) + l_s / l_d)


def force_slope(numbers: Numbers, *, printed: bool) -> float:
    """c_d that Eq. 4 asks for, as printed or corrected [1]."""
    constants, given = numbers.constants, numbers.gait.c_s
    both = constants.l_s + constants.l_d
    if printed:
        return constants.l_d / (both - constants.l_s / given)
    return (both - given * constants.l_s) / constants.l_d


def acceleration_jump(numbers: Numbers, slope: float, inverse_a_d: float) -> float:
    """Jump of the COM's acceleration into a double support with these slopes [m/s^2]."""
    constants = numbers.constants
    before = numbers.g_over_h * (numbers.gait.c_s - constants.inverse_a_s) * constants.l_s
    return numbers.g_over_h * (slope - inverse_a_d) * -constants.l_d - before


def _continuity(case: Case, rows: Rows) -> None:
    normal, momentum = case.normal, case.momentum
    inverse = sp.Symbol("i", real=True)
    conditions = [condition.subs(a_d, 1 / inverse) for condition in (FORCE_CONDITION, ZMP_CONDITION)]
    derived = sp.solve(conditions, [c_d, inverse], dict=True)[0][c_d]
    equation = rows["Eq. 4"]
    equation.symbolic(
        "l_s/c_s + l_d/c_d - l_s - l_d with the c_d of a continuous force and ZMP",
        l_s / c_s + l_d / derived - l_s - l_d,
    )
    equation.symbolic(
        "c_s l_s + c_d l_d - l_s - l_d with the same c_d", corrected=c_s * l_s + derived * l_d - l_s - l_d
    )
    for numbers in (normal, momentum):
        jumps = (
            acceleration_jump(numbers, force_slope(numbers, printed=printed), 1.0 / numbers.constants.a_d)
            for printed in (True, False)
        )
        label = f"jump of x'' at the switch, c_s = {numbers.gait.c_s:g}"
        equation.zero(label, "m/s^2", *jumps, gait=numbers.name)
    single_only = sp.solve(FORCE_CONDITION, c_d)[0]
    with_zmp = single_only.subs(a_d, sp.solve(ZMP_CONDITION, a_d)[0])
    derivation = rows["Eq. 4, derivation"]
    derivation.symbolic(
        "c_s l_s + c_d l_d - l_s - l_d with the c_d of Eqs. 2 and 3 alone",
        c_s * l_s + single_only * l_d - l_s - l_d,
    )
    derivation.symbolic("the same with the ZMP's condition", corrected=c_s * l_s + with_zmp * l_d - l_s - l_d)
    alone = acceleration_jump(normal, force_slope(normal, printed=False), normal.constants.inverse_a_s)
    suffices = rows["Eq. 4 suffices"]
    suffices.zero("jump of x'' with Eq. 4 (corrected) alone and a_d = a_s", "m/s^2", alone)
    for numbers in (normal, momentum):
        suffices.zero(
            "jump of x'' with both conditions", "m/s^2", corrected=numbers.largest_jump, gait=numbers.name,
        )  # fmt: skip


def _symmetry(case: Case, rows: Rows) -> None:
    momentum = case.momentum
    half = sp.Symbol("T", positive=True)
    odd = B * sp.sinh(k * t)
    arm = moment_y(odd / a_s, odd, acceleration_towards(odd / a_s, c_s * odd))
    caught = B * sp.sin(k * t)
    arm_d = moment_y(caught / a_d, caught, acceleration_towards(caught / a_d, c_d * caught))
    step = momentum.constants.step_duration
    ends = momentum.plan.sample([0.0, momentum.t_ss, step]).angular_momentum[:, 1]
    symmetry = rows["symmetry"].symbolic(
        "integral of M_y over a phase from -T to T, both phases",
        (sp.integrate(arm, (t, -half, half)), sp.integrate(arm_d, (t, -half, half))),
    )
    change = np.abs(np.diff(ends)).max()
    symmetry.zero("largest change of L_y over a phase", "N m s", change, gait="momentum")
    rows["nothing to tune"].zero("net change of L_y over a step", "N m s", ends[2] - ends[0], gait="momentum")

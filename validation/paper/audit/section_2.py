"""Section 2: the general law with a moving ZMP and a force that misses the COM."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp

from validation.paper.audit.case import Case, Numbers
from validation.paper.audit.mechanics import H, g, m, moment_y, of_law, t
from validation.paper.audit.rows import Rows

a, b, d, x, y, x_0, v_0, w_1, w_2 = sp.symbols("a b d x y x_0 v_0 omega_1 omega_2", real=True)
c, c_y = sp.symbols("c c_y", positive=True)
C_1, C_2, t_1, t_2, t_3 = sp.symbols("C_1 C_2 t_1 t_2 t_3", real=True)
T_e = sp.sqrt(H / (c * g))
MINUS, PLUS = C_1 * sp.exp(-t / T_e), C_2 * sp.exp(t / T_e)
COM = MINUS + PLUS - d / c
"""The paper's solution of Eq. 1."""
CONSTANTS = {C_1: (x_0 + d / c - v_0 * T_e) / 2, C_2: (x_0 + d / c + v_0 * T_e) / 2}
TRUE_MOMENT = moment_y(a * COM + b, COM, g / H * (c * COM + d))


def moment_formula(sign: int) -> Any:
    """The paper's r, with the sign of d/c that is printed (+1) or corrected (-1)."""
    rest = (a - 1) * (MINUS + PLUS + sign * d / c) + b
    return -m * H / T_e**2 * (MINUS + PLUS) - m * g * rest


def momentum_formula(sign: int) -> Any:
    """The bracket of the paper's omega as a function of t, with the printed (+1) or corrected (-1) sign."""
    turning = (-MINUS + PLUS) * (-H / T_e - g * T_e * (a - 1))
    return m * (turning - g * (sign * (a - 1) * d / c + b) * t)


def check(case: Case, rows: Rows) -> None:
    """Section 2, from top to bottom."""
    _law(case, rows)
    _momentum(case, rows)


def _law(case: Case, rows: Rows) -> None:
    rows["moving ZMP"].symbolic(
        "M_y less -m g ((a + c - 1) x + b + d)",
        moment_y(a * x + b, x, g / H * (c * x + d)) + m * g * ((a + c - 1) * x + b + d),
    )
    force, vector = sp.Matrix([m * g / H * (c * x + d), m * g]), sp.Matrix([c * x + d, H])
    parallel = rows["Fig. 3, force"]
    parallel.symbolic("force times vector, zero for a normal", force.dot(vector))
    across = force[0] * vector[1] - force[1] * vector[0]
    parallel.symbolic("force across vector, zero for a parallel", corrected=across)
    acceleration = g / H * (c * x + d)
    force_y = m * g / H * c_y * y
    sample = case.normal.switch.force[0]
    wanted = case.normal.switch.com_acceleration[0, 0] / case.normal.plan.gravity
    ratio = rows["force ratio"]
    ratio.symbolic("F_x/F_y - (c x + d)/H", m * acceleration / force_y - (c * x + d) / H)
    ratio.zero("F_x/F_y - x''/g at the first switch", "1", sample[0] / sample[1] - wanted)
    ratio.symbolic("F_x/F_z - (c x + d)/H", corrected=m * acceleration / (m * g) - (c * x + d) / H)
    ratio.zero("F_x/F_z - x''/g at the first switch", "1", corrected=sample[0] / sample[2] - wanted)
    rows["Eq. 1"].symbolic(
        "force parallel to (c x + d, H) with F_z = m g", m * g * (c * x + d) / H / m - acceleration
    )
    rows["Eq. 1, solution"].symbolic("x'' - (g/H)(c x + d)", of_law(COM, g / H * c, g / H * d))
    start = COM.subs(CONSTANTS)
    ends = (start.subs(t, 0) - x_0, sp.diff(start, t).subs(t, 0) - v_0)
    rows["C_1, C_2"].symbolic("position and velocity at t = 0", ends)
    rows["F_x, F_z"].symbolic("F_x - m x''", m / T_e**2 * (MINUS + PLUS) - m * sp.diff(COM, t, 2))


def second_step(numbers: Numbers) -> dict[Any, float]:
    """Section 2's constants for the second single support, written from the world's origin."""
    gait, constants = numbers.gait, numbers.constants
    ahead, slope = gait.step_length, constants.inverse_a_s
    bracket = gait.c_s - slope
    return {
        a: slope,
        b: ahead * (1.0 - slope),
        c: bracket,
        d: -ahead * bracket,
        x_0: ahead - constants.l_s,
        v_0: gait.switching_velocity,
        H: gait.com_height,
        g: numbers.plan.gravity,
        m: numbers.plan.mass,
    }


def _on_gait(formula: Any, numbers: Numbers, times: Any) -> Any:
    values = second_step(numbers)
    found = sp.lambdify(t, formula.subs(CONSTANTS).subs(values), "numpy")(times)
    return np.broadcast_to(found, np.shape(times))  # a formula may be the same at all times


def _momentum(case: Case, rows: Rows) -> None:
    normal, signs = case.normal, (1, -1)  # of the printed and the corrected form
    times = np.linspace(0.0, normal.t_ss * (1.0 - 1e-9), 201)
    step = normal.plan.sample(normal.constants.step_duration + times)
    apart = [
        np.abs(_on_gait(moment_formula(sign), normal, times) - step.moment[:, 1]).max() for sign in signs
    ]
    moment = rows["moment r"]
    moment.symbolic("r - ((p - c) x F)_y", *(moment_formula(sign) - TRUE_MOMENT for sign in signs))
    where = "mismatch in the second single support, written in world axes"
    moment.zero(where, "N m", *apart)
    gained = step.angular_momentum[-1, 1] - step.angular_momentum[0, 1]
    off = [
        float(np.diff(_on_gait(momentum_formula(sign), normal, times[[0, -1]]))[0] - gained) for sign in signs
    ]
    rates = (sp.diff(momentum_formula(sign), t) - TRUE_MOMENT for sign in signs)
    omega = rows["momentum omega"].symbolic("d omega/dt - ((p - c) x F)_y", *rates)
    where = "mismatch over the second single support, in world axes"
    omega.zero(where, "N m s", *off)
    start = float(case.momentum.stride.angular_momentum[0, 1])
    meaning = rows["meaning of omega"].symbolic(
        "omega_{t1,t3} - omega_{t1,t2} - omega_{t2,t3}",
        _generated(t_1, t_3, w_1) - _generated(t_1, t_2, w_1) - _generated(t_2, t_3, w_2),
    )
    meaning.zero("'generated' over no time at all, at the first instant", "N m s", start, gait="momentum")
    meaning.symbolic(
        "the same without omega_1",
        corrected=_generated(t_1, t_3, 0) - _generated(t_1, t_2, 0) - _generated(t_2, t_3, 0),
    )
    rows["what follows"].against(
        "sections 2.1 and 2.2, which follow, are headed sagittal plane and frontal plane"
    )


def _generated(start: Any, end: Any, before: Any) -> Any:
    formula = momentum_formula(-1)
    return formula.subs(t, end) - formula.subs(t, start) + before

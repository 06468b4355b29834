"""The frontal plane's formulas, as sections 2.2's rows share them."""

from __future__ import annotations

from typing import Any

import sympy as sp

from validation.paper.audit.mechanics import H, g, t

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


def exponential(expression: Any) -> Any:
    """Hyperbolic functions as exponentials, in which sympy sees what cancels."""
    return sp.simplify(expression.rewrite(sp.exp))

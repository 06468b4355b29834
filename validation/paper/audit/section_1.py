"""Abstract and section 1: claims, coordinates, the plain inverted pendulum."""

from __future__ import annotations

import time

import numpy as np
import sympy as sp

from ampm.planner.periodic import plan_gait
from validation.paper.audit.case import Case
from validation.paper.audit.mechanics import (
    H,
    acceleration_towards,
    g,
    m,
    moment,
    moment_x,
    moment_y,
    of_law,
    t,
)
from validation.paper.audit.rows import Rows

x, y, z, c, mu, x_0, v_0 = sp.symbols("x y z c mu x_0 v_0", real=True)
IPM_STEPS = 10
"""Steps of the plain pendulum that the audit itself walks in physics."""
REAL_TIME_SHARE = 0.01
"""A plan is called real-time if planning takes less than this share of the walk's duration."""


def check(case: Case, rows: Rows) -> None:
    """Abstract, sections 1, 1.1 and 1.2, from top to bottom."""
    _claims(case, rows)
    _pendulum(case, rows)


def _claims(case: Case, rows: Rows) -> None:
    normal = case.normal
    rows["C2 at the switches"].zero(
        "largest jump of the COM's acceleration over all switches", "m/s^2", normal.largest_jump
    )
    demanded, turned = mu * x, -m * g * (c - 1) * x
    rows["angular momentum"].symbolic(
        "M_y demanded as mu x, less M_y at c = 1 - mu/(m g)", demanded - turned.subs(c, 1 - mu / (m * g))
    )
    rows["IPM"].symbolic("moment about the COM at a = 0, c = 1", moment_y(0, x, acceleration_towards(0, x)))
    rows["bottom-up"].zero(
        "constant of L_y that the body asks for, less the plan's own zero mean", "N m s", case.body.constant
    )
    best = min(_seconds_to_plan(case) for _ in range(5))
    rows["real time, COG"].claim(
        "printed",
        f"planning takes less than {REAL_TIME_SHARE:.0%} of the walk's duration",
        best < REAL_TIME_SHARE * normal.plan.duration,
    )
    jump = rows["beyond the IPM, jump"]
    what = "largest jump of an IPM with the same steps, its double support at constant velocity"
    jump.sign("positive", what, "m/s^2", case.ipm.largest_jump, gait="ipm")
    jump.zero("largest jump of the AMPM", "m/s^2", normal.largest_jump)
    ended = case.outcome("ipm", IPM_STEPS)
    rows["beyond the IPM, stability"].claim(
        "printed",
        f"{IPM_STEPS} steps of the IPM in physics, with that jump at every switch, to be lost",
        not ended.completed,
        str(ended.name),
        gait="ipm",
    )


def _seconds_to_plan(case: Case) -> float:
    start = time.perf_counter()
    plan_gait(case.normal.gait, case.normal.plan.mass)
    return time.perf_counter() - start


def _pendulum(case: Case, rows: Rows) -> None:
    e = np.eye(3)
    apart = float(np.abs(np.cross(e[2], e[0]) - e[1]).max())
    rows["Fig. 1, axes"].zero("e_z x e_x - e_y, with y to the left", "1", apart, gait="")
    largest = float(np.abs(case.ipm.stride.moment).max())
    rows["Fig. 2"].zero("largest moment about the COM over a stride", "N m", largest, gait="ipm")
    fall_x = sp.solve(moment_y(0, x, mu), mu)[0]
    fall_y = sp.solve(moment_x(0, y, mu), mu)[0]
    rows["IPM, law"].symbolic("against zero moment about the COM", (fall_x - g / H * x, fall_y - g / H * y))
    lift = sp.Symbol("zdd", real=True)
    falling = sp.solve(moment((0, 0, 0), (x, y, z), (m * mu, 0, m * (g + lift)))[1], mu)[0]
    rows["planes"].symbolic("dx''/dy at constant height", sp.diff(falling.subs({lift: 0, z: H}), y))
    period = sp.sqrt(H / g)
    fall = x_0 * sp.cosh(t / period) + v_0 * period * sp.sinh(t / period)
    rows["IPM, solution"].symbolic(
        "law; position and velocity at t = 0",
        (of_law(fall, g / H), fall.subs(t, 0) - x_0, sp.diff(fall, t).subs(t, 0) - v_0),
    )
    rows["ZMP"].symbolic(
        "moment (x, y) of three forces on a flat floor about the centre of F_z", _moment_about_centre()
    )


def _moment_about_centre() -> list[sp.Expr]:
    total, points, forces = 0, [], []
    for i in range(3):
        points.append((*sp.symbols(f"x_{i + 1} y_{i + 1}", real=True), 0))
        forces.append(sp.symbols(f"F_x{i + 1} F_y{i + 1} F_z{i + 1}", real=True))
        total += forces[i][2]
    centre = [sum(points[i][k] * forces[i][2] for i in range(3)) / total for k in (0, 1)]
    turned = sp.zeros(3, 1)
    for point, force in zip(points, forces, strict=True):
        turned += moment(point, (*centre, 0), force)
    return [turned[0], turned[1]]

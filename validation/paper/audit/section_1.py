"""Abstract and section 1: claims, coordinates, the plain inverted pendulum."""

from __future__ import annotations

import time
from collections.abc import Iterator

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
from validation.paper.audit.rows import Evidence, claim, symbolic, zero

x, y, z, c, mu, x_0, v_0 = sp.symbols("x y z c mu x_0 v_0", real=True)
IPM_STEPS = 10
"""Steps of the plain pendulum that the audit itself walks in physics."""
REAL_TIME_SHARE = 0.01
"""A plan is called real-time here if it takes less than this share of the time it is walked in."""


def rows(case: Case) -> Iterator[Evidence]:
    """Abstract, sections 1, 1.1 and 1.2, from top to bottom."""
    yield from _claims(case)
    yield from _pendulum(case)


def _claims(case: Case) -> Iterator[Evidence]:
    normal = case.normal
    yield Evidence(
        "abstract",
        "C2 at the switches",
        zero(
            "printed",
            "largest jump of the COM's acceleration over all switches",
            normal.plan.residuals().acceleration * normal.plan.gravity,
            "m/s^2",
        ),
    )
    arm = (c - 1) * x
    yield Evidence(
        "abstract",
        "angular momentum",
        symbolic(
            "printed",
            "M_y demanded as mu x, less M_y at c = 1 - mu/(m g)",
            mu * x - (-m * g * arm).subs(c, 1 - mu / (m * g)),
        ),
    )
    yield Evidence(
        "1",
        "IPM",
        symbolic(
            "printed", "moment about the COM at a = 0, c = 1", moment_y(0, x, acceleration_towards(0, x))
        ),
    )
    constant = case.body.motion.report.angular_momentum_y_offset
    yield Evidence(
        "1",
        "bottom-up",
        zero(
            "printed",
            "constant of L_y that the body asks for, less the plan's own zero mean",
            constant,
            "N m s",
        ),
    )
    best = min(_seconds_to_plan(case) for _ in range(5))
    share = f"{REAL_TIME_SHARE:.0%}"
    yield Evidence(
        "1",
        "real time, COG",
        claim(
            "printed",
            f"planning takes less than {share} of the walk's duration",
            None,
            "",
            best < REAL_TIME_SHARE * normal.plan.duration,
        ),
    )
    jump = case.ipm.plan.residuals().acceleration * case.ipm.plan.gravity
    yield Evidence(
        "1",
        "beyond the IPM, jump",
        claim(
            "printed",
            "largest jump of an IPM with the same steps, its double support at constant velocity",
            jump,
            "m/s^2",
            jump > 0.0,
            "ipm",
        ),
        zero(
            "printed",
            "largest jump of the AMPM",
            normal.plan.residuals().acceleration * normal.plan.gravity,
            "m/s^2",
        ),
    )
    ended = case.outcome("ipm", IPM_STEPS)
    yield Evidence(
        "1",
        "beyond the IPM, stability",
        claim(
            "printed",
            f"{IPM_STEPS} steps of the IPM in physics, with that jump at every switch, to be lost",
            str(ended.name),
            "",
            not ended.completed,
            "ipm",
        ),
    )


def _seconds_to_plan(case: Case) -> float:
    start = time.perf_counter()
    plan_gait(case.normal.gait, case.normal.plan.mass)
    return time.perf_counter() - start


def _pendulum(case: Case) -> Iterator[Evidence]:
    e = np.eye(3)
    yield Evidence(
        "1.1",
        "Fig. 1, axes",
        zero(
            "printed",
            "e_z x e_x - e_y, with y to the left",
            float(np.abs(np.cross(e[2], e[0]) - e[1]).max()),
            "1",
            gait="",
        ),
    )
    stride = case.ipm.stride
    yield Evidence(
        "1.2",
        "Fig. 2",
        zero(
            "printed",
            "largest moment about the COM over a stride",
            float(np.abs(stride.moment).max()),
            "N m",
            "ipm",
            scale=case.ipm.plan.weight,
        ),
    )
    fall_x = sp.solve(moment_y(0, x, mu), mu)[0]
    fall_y = sp.solve(moment_x(0, y, mu), mu)[0]
    yield Evidence(
        "1.2",
        "IPM, law",
        symbolic("printed", "against zero moment about the COM", (fall_x - g / H * x, fall_y - g / H * y)),
    )
    lift = sp.Symbol("zdd", real=True)
    falling = sp.solve(moment((0, 0, 0), (x, y, z), (m * mu, 0, m * (g + lift)))[1], mu)[0]
    yield Evidence(
        "1.2",
        "planes",
        symbolic("printed", "dx''/dy at constant height", sp.diff(falling.subs({lift: 0, z: H}), y)),
    )
    period = sp.sqrt(H / g)
    fall = x_0 * sp.cosh(t / period) + v_0 * period * sp.sinh(t / period)
    yield Evidence(
        "1.2",
        "IPM, solution",
        symbolic(
            "printed",
            "law; position and velocity at t = 0",
            (of_law(fall, g / H), fall.subs(t, 0) - x_0, sp.diff(fall, t).subs(t, 0) - v_0),
        ),
    )
    yield Evidence(
        "1.2",
        "ZMP",
        symbolic(
            "printed",
            "moment (x, y) of three forces on a flat floor about the centre of F_z",
            _moment_about_centre(),
        ),
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

"""Section 4: summary."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
import sympy as sp

from validation.paper.audit.case import Case, Numbers
from validation.paper.audit.mechanics import acceleration_towards
from validation.paper.audit.rows import Evidence, against, claim, symbolic, zero
from validation.paper.audit.section_2_3 import SWITCH, cubic_jump

x, y, a_s, c_s, c_y = sp.symbols("x y a_s c_s c_y", real=True)
FASTER = 1.1
"""Speed at the switches, as a share of the demo's, with which the frontal plane is solved again."""

VARIETY = tuple(product((0.7, 1.0, 1.3), repeat=2))
"""c_y and c_s of plans that must differ from each other."""


def _apart(one: Numbers, other: Numbers) -> float:
    """Largest difference of L_x or L_y over a stride, each over its own [N m s]."""
    return float(np.abs(one.stride.angular_momentum[:, :2] - other.stride.angular_momentum[:, :2]).max())


def rows(case: Case) -> Iterator[Evidence]:
    """Section 4, from top to bottom."""
    normal = case.normal
    yield Evidence(
        "4",
        "name",
        against("sections 1 and 2 call them Inverted Pendulum Mode and Enhanced Inverted Pendulum Model"),
    )
    largest = np.abs(case.momentum.stride.moment).max(axis=0)
    yield Evidence(
        "4",
        "moment",
        *(
            claim("printed", f"largest M_{axis}, to be greater than 0", value, "N m", value > 0.0, "momentum")
            for axis, value in zip("xy", largest, strict=True)
        ),
    )
    law = acceleration_towards(x / a_s, c_s * x)
    yield Evidence(
        "4",
        "C2 throughout, COG",
        zero(
            "printed",
            "largest jump of x'' and y'' over all switches of the plan",
            normal.plan.residuals().acceleration * normal.plan.gravity,
            "m/s^2",
        ),
        why="In an endless gait, with the corrected equations. Not for a start: "
        f"x'' = {sp.factor(law / x)} x is zero at rest only at x = 0, where it stays.".replace("*", " "),
    )
    yield Evidence(
        "4",
        "C2 throughout, joints",
        zero(
            "printed",
            "jump of hip and knee at lift-off with the swing foot of section 2.3",
            case.body.joint_jump(cubic_jump(case)),
            "rad/s^2",
        ),
        zero(
            "corrected",
            "the same with the feet here",
            case.body.joint_jump(None),
            "rad/s^2",
            scale=10.0,
            rounding=SWITCH,
        ),
    )
    lateral = acceleration_towards(0, c_y * y)
    beta = normal.constants.beta
    moved = case.varied(switching_velocity=FASTER * normal.gait.switching_velocity).constants.beta
    yield Evidence(
        "4",
        "independence",
        symbolic("printed", "d x''/dy and d y''/dx", (sp.diff(law, y), sp.diff(lateral, x))),
        zero("printed", f"change of beta with v_0 times {FASTER:g}", moved - beta, "m"),
        symbolic("corrected", "d x''/dy and d y''/dx", (sp.diff(law, y), sp.diff(lateral, x))),
    )
    kinds = [case.varied(c_y=c_y_, c_s=c_s_) for c_y_, c_s_ in VARIETY]
    apart = min(_apart(one, other) for one, other in combinations(kinds, 2))
    yield Evidence(
        "4",
        "variety",
        claim(
            "printed",
            "least difference of two of nine plans (c_y and c_s from 0.7 to 1.3) in L_x or L_y, "
            "to be greater than 0",
            apart,
            "N m s",
            apart > 0.0,
        ),
    )
    yield Evidence(
        "4",
        "posture",
        zero(
            "printed",
            "constant of L_y, which COG and ZMP leave open, less the plan's own zero mean",
            case.body.motion.report.angular_momentum_y_offset,
            "N m s",
        ),
        zero(
            "printed",
            "directions that the printed cost leaves open",
            float(case.body.flat_directions()),
            "1",
        ),
        zero(
            "corrected",
            "largest difference of the mirrored return with both",
            case.body.motion.report.residual,
            "rad",
        ),
    )

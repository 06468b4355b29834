"""Section 4: summary."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import sympy as sp

from validation.paper.audit.case import Case, Numbers
from validation.paper.audit.mechanics import acceleration_towards
from validation.paper.audit.rows import Rows
from validation.paper.audit.section_2_3 import SWITCH, cubic_jump

x, y, a_s, c_s, c_y = sp.symbols("x y a_s c_s c_y", real=True)
FASTER = 1.1
"""Speed at the switches, as a share of the demo's, with which the frontal plane is solved again."""

VARIETY = tuple(product((0.7, 1.0, 1.3), repeat=2))
"""c_y and c_s of plans that must differ from each other."""


def _apart(one: Numbers, other: Numbers) -> float:
    """Largest difference of L_x or L_y over a stride, each over its own [N m s]."""
    return float(np.abs(one.stride.angular_momentum[:, :2] - other.stride.angular_momentum[:, :2]).max())


def check(case: Case, rows: Rows) -> None:
    """Section 4, from top to bottom."""
    normal = case.normal
    rows["name"].against(
        "sections 1 and 2 call them Inverted Pendulum Mode and Enhanced Inverted Pendulum Model"
    )
    moment = rows["moment"]
    for axis, value in zip("xy", np.abs(case.momentum.stride.moment).max(axis=0), strict=True):
        moment.sign("positive", f"largest M_{axis}", "N m", value, gait="momentum")
    law = acceleration_towards(x / a_s, c_s * x)
    throughout = rows["C2 throughout, COG"]
    throughout.why = "In an endless gait, with the corrected equations. Not for a start: "
    throughout.why += f"x'' = {sp.factor(law / x)} x is zero at rest only at x = 0, where it stays.".replace(
        "*", " "
    )
    throughout.zero("largest jump of x'' and y'' over all switches of the plan", "m/s^2", normal.largest_jump)
    joints = rows["C2 throughout, joints"]
    joints.zero(
        "jump of hip and knee at lift-off with the swing foot of section 2.3", "rad/s^2",
        case.body.joint_jump(cubic_jump(case)),
    )  # fmt: skip
    jump = case.body.joint_jump(None)
    joints.zero("the same with the feet here", "rad/s^2", corrected=jump, within=SWITCH)
    lateral = acceleration_towards(0, c_y * y)
    moved = case.varied(switching_velocity=FASTER * normal.gait.switching_velocity).constants.beta
    mixed = (sp.diff(law, y), sp.diff(lateral, x))
    independence = rows["independence"].symbolic("d x''/dy and d y''/dx", mixed, mixed)
    independence.zero(f"change of beta with v_0 times {FASTER:g}", "m", moved - normal.constants.beta)
    kinds = [case.varied(c_y=c_y_, c_s=c_s_) for c_y_, c_s_ in VARIETY]
    rows["variety"].sign(
        "positive",
        "least difference of two of nine plans (c_y and c_s from 0.7 to 1.3) in L_x or L_y",
        "N m s",
        min(_apart(one, other) for one, other in combinations(kinds, 2)),
    )
    posture = rows["posture"]
    what = "constant of L_y, which COG and ZMP leave open, less the plan's own zero mean"
    posture.zero(what, "N m s", case.body.constant)
    flat = case.body.flat_directions
    posture.zero("directions that the printed cost leaves open", "1", flat)
    residual = case.body.motion.report.residual
    posture.zero("largest difference of the mirrored return with both", "rad", corrected=residual)

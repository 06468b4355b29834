"""Section 2.3: feet, Jacobians, the posture form, integration."""

from __future__ import annotations

import math

import numpy as np
import sympy as sp

from validation.paper.audit.body import PAPER_ROWS
from validation.paper.audit.case import Case
from validation.paper.audit.mechanics import t
from validation.paper.audit.rows import Rows

k, d, T, travel, lift_speed = sp.symbols("k d T D v", positive=True)
DRIFT_STEPS = 3
FEEDBACK_STEPS = 40
PITCH_TOLERANCE = 2e-3
"""Of the trunk's mean pitch after so many steps with feedback [rad]: a tenth of a degree."""
CONSTANT_TOLERANCE = 2e-3
"""Of the constant of L_y found by feedback [N m s]: half a percent."""
DIFFERENCES = 1e-6
"""Error of a rate by central differences [SI]."""
SWITCH = 1e-5
"""Allowed change of a path within a nanosecond on either side of a switch [SI]."""


def check(case: Case, rows: Rows) -> None:
    """Section 2.3, from top to bottom."""
    _defined(case, rows)
    _feet(case, rows)
    _jacobians(case, rows)
    _constraints(case, rows)
    _posture(case, rows)
    _integration(case, rows)


def cubic(start_speed: sp.Expr, end_speed: sp.Expr) -> sp.Expr:
    """The cubic over a swing of duration T and travel D with given speeds at both ends."""
    parts = sp.symbols("p0:4")
    path = sum(part * t**i for i, part in enumerate(parts))
    speed = sp.diff(path, t)
    ends = (path.subs(t, 0), path.subs(t, T) - travel)
    found = sp.solve([*ends, speed.subs(t, 0) - start_speed, speed.subs(t, T) - end_speed], parts)
    return path.subs(found)


def cubic_jump(case: Case) -> float:
    """Jump of the swing foot's forward acceleration on ``normal`` with the printed cubic [m/s^2]."""
    normal = case.normal
    values = {T: normal.t_ss, travel: 2.0 * normal.gait.step_length, lift_speed: normal.lift_speed}
    return float(sp.diff(cubic(lift_speed, sp.Integer(0)), t, 2).subs(t, 0).subs(values))


def _defined(case: Case, rows: Rows) -> None:
    body, defined = case.body, rows["what is defined"]
    drift, kept = (body.trunk_drift(constant, DRIFT_STEPS) for constant in (0.0, body.constant))
    gained = f"trunk pitch gained in {DRIFT_STEPS} steps"
    defined.zero(f"{gained} with mean L_y zero", "rad", drift, within=1e-6)
    found = abs(body.constant) > 1e-3
    defined.claim("corrected", "constant of L_y that closes the posture", found, body.constant, "N m s")
    defined.zero(f"{gained} with that constant", "rad", corrected=kept, within=1e-6)


def _feet(case: Case, rows: Rows) -> None:
    normal, body = case.normal, case.body
    rows["Fig. 6, body"].why = (
        "Its masses, lengths and joints are not printed, nor whether the root's six count. The body here "
        f"has {body.robot.nv} with them."
    )
    # The left foot, from the middle of one of its single supports to that of the next.
    times = 0.5 * normal.t_ss + np.array([0.0, 2.0 * normal.constants.step_duration])
    advance = np.diff(body.plan.feet.sample(times)[0].position[:, 0])[0] - 2.0 * normal.gait.step_length
    rows["foot steps"].zero("stance foot's advance in two steps less 4 (l_s + l_d)", "m", advance)
    jump_v, jump_a = body.swing_foot_jump()
    paper_v, paper_a = body.swing_foot_jump(swing="paper")
    ankle_v, _ = body.swing_foot_jump(swing="paper", v_swing_of="ankle")
    swing = rows["v_swing"]
    swing.why = (
        "The paper does not say whose velocity. The ball's has rested until then, and jumps. The ankle's is "
        f"l_s/T_swing without a jump if the heel rises at {body.rising_heel:.3g} rad/s at toe off "
        "(foot.v_swing_of = ankle). The cubic's acceleration jumps in both readings (E25)."
    )
    swing.zero("jump of the velocity of a foot that has stood", "m/s", normal.lift_speed)
    swing.zero("the ball's, planned with foot.swing = paper", "m/s", paper_v)
    swing.zero("the ankle's, with foot.v_swing_of = ankle", "m/s", corrected=ankle_v, within=SWITCH)
    swing.zero("jump of the swing foot's velocity at lift-off", "m/s", corrected=jump_v, within=SWITCH)
    path, still = cubic(lift_speed, sp.Integer(0)), cubic(sp.Integer(0), sp.Integer(0))
    rows["landing"].symbolic("speed of the cubic at T", sp.diff(path, t).subs(t, T))
    spline = rows["cubic spline"]
    start = sp.diff(path, t, 2).subs(t, 0)
    spline.symbolic("acceleration at lift-off after standing, D the foot's travel", start)
    spline.symbolic("the same if it leaves from rest", sp.diff(still, t, 2).subs(t, 0))
    spline.zero("jump of the foot's x'' at lift-off", "m/s^2", cubic_jump(case))
    spline.zero("the same of the rolling foot, planned with foot.swing = paper", "m/s^2", paper_a)
    spline.symbolic("quintic: velocity and acceleration at both ends", corrected=_quintic_ends())
    spline.zero("jump of the swing foot's acceleration", "m/s^2", corrected=jump_a, within=SWITCH)


def _quintic_ends() -> list[sp.Expr]:
    share = t / T
    path = travel * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return [sp.diff(path, t, order).subs(t, at) for order in (1, 2) for at in (0, T)]


def _jacobians(case: Case, rows: Rows) -> None:
    body, where = case.body, "against differences along the walk, mid single support"
    mass, speeds, rates = body.robot.mass, body.velocity_errors, body.acceleration_errors
    for place, mismatch, unit, how in (
        ("J_cog", speeds[:3], "m/s", where),
        ("Eq. 8", rates[:3], "m/s^2", where),
        ("R", mass * speeds[3:6], "N m s", "against the sum over all segments"),
        ("Eq. 9", mass * rates[3:6], "N m", where),
        ("Eq. 10", rates[6:], "m/s^2", where),
    ):
        rows[place].zero(how, unit, mismatch.max(), within=DIFFERENCES)
    rows["r, meaning"].against("section 2 calls r the moment [N m] and omega the angular momentum [N m s]")


def _constraints(case: Case, rows: Rows) -> None:
    body, residual = case.body, case.body.motion.report.constraint_acceleration
    rank = float(np.linalg.matrix_rank(body.jacobian) - PAPER_ROWS)
    stacked = rows["Eq. 11"].zero("rank of J_all less its 18 rows, mid single support", "1", rank)
    stacked.zero("largest residual over the step", "m/s^2", residual)
    order, error = rows["order of lambda"], body.permuted_constraints()
    order.zero("largest error of an entry in single support", "SI", error)
    order.zero("largest residual of the project's one order", "SI", corrected=residual)
    heights, blocks = (3, 3, PAPER_ROWS - 6), rows["J_all"]
    apart = float(max(heights) - min(heights))
    blocks.zero("difference of the blocks' heights, which stand side by side", "1", apart)
    apart = float(body.jacobian.shape[1] - body.robot.nv)
    blocks.zero("difference of the blocks' widths, stacked", "1", corrected=apart)
    planned = case.normal.switch.moment.shape[1]
    yaw = float(abs(body.motion.angular_momentum_z).max())
    vertical = rows["r_z in lambda"]
    vertical.why = f"Free here: it swings by {yaw:.3g} N m s about zero on the normal gait."
    vertical.zero("components of r' that the mode plans, less 3", "1", float(planned - 3))
    vertical.zero("components of r' that the mode plans, less 2", "1", corrected=float(planned - 2))


def _posture(case: Case, rows: Rows) -> None:
    body = case.body.run.body
    stiffness, damping = body.posture_stiffness, body.posture_damping
    rate = sp.Symbol("lambda")
    growth = {sign: sp.solve(rate**2 + d * rate + sign * k, rate) for sign in (-1, 1)}
    fastest = {
        sign: max(float(sp.re(root.subs({k: stiffness, d: damping}))) for root in roots)
        for sign, roots in growth.items()
    }
    runaway = max(growth[-1], key=lambda root: float(sp.re(root.subs({k: 1, d: 1}))))
    total, product = sp.simplify(sum(growth[1])), sp.simplify(sp.prod(growth[1]))
    sign = rows["Eq. 12, sign"]
    what = "rate of the free minimiser, to be negative; positive for all k > 0"
    sign.claim("printed", what, runaway.is_negative, runaway)
    sign.sign("negative", f"that rate at k = {stiffness:g}/s^2, d = {damping:g}/s", "1/s", fastest[-1])
    sign.claim("corrected", "sum of both rates, to be negative", total.is_negative, total)
    sign.claim("corrected", "product of both, to be positive", product.is_positive, product)
    sign.sign("negative", "the largest rate", "1/s", corrected=fastest[1])
    column = sp.MatrixSymbol("q", 40, 1)
    heights = (float((left * right).shape[0] - 1) for left, right in ((column, column.T), (column.T, column)))
    rows["Eq. 12, product"].zero("rows of the product less 1", "1", *heights, gait="")
    weights = rows["Eq. 12, weights"]
    weights.zero("directions without any cost", "1", case.body.flat_directions)
    least = case.body.least_curvature()
    weights.sign("positive", "least curvature of the project's cost", "1", corrected=least)


def _integration(case: Case, rows: Rows) -> None:
    report = case.body.motion.report
    residual = report.constraint_acceleration
    rows["QP"].zero("largest residual of Eq. 11 over the step", "m/s^2", residual)
    grows = max(abs(complex(*pair)) for pair in report.multipliers)
    body = case.body.run.body
    stiffness, damping = body.posture_stiffness, body.posture_damping
    runaway = 0.5 * (math.sqrt(damping**2 + 4.0 * stiffness) - damping)
    printed = math.exp(runaway * case.normal.constants.step_duration)
    steps = rows["step by step"]
    steps.why = (
        "Of an endless gait: integrated on with a fixed constant of L_y, the posture leaves the periodic "
        "motion exponentially. With Eq. 12 corrected a deviation doubles in "
        f"{math.log(2.0) / math.log(grows):.0f} steps, so a demo of a few steps need not show it. One number "
        f"fed back per step mends it: from an upright start, {FEEDBACK_STEPS} steps integrated on end on the "
        "periodic motion's constant."
    )
    what = "growth of a deviation per step, to be at most 1: free minimiser of Eq. 12 as printed"
    steps.claim("printed", what, printed <= 1.0, printed, "1")
    steps.claim("printed", "the same of the whole body, Eq. 12 corrected (E14)", grows <= 1.0, grows, "1")
    pitch, constant = case.body.trunk_feedback(FEEDBACK_STEPS)
    what = f"after {FEEDBACK_STEPS} steps with feedback, from upright: trunk's mean pitch"
    steps.zero(what, "rad", corrected=pitch, within=PITCH_TOLERANCE)
    what = "the constant of L_y that it found, less the periodic motion's"
    steps.zero(what, "N m s", corrected=constant - case.body.constant, within=CONSTANT_TOLERANCE)
    steps.zero(
        "one periodic step: largest difference of the mirrored return", "rad", corrected=report.residual
    )

"""Section 2.3: feet, Jacobians, the posture form, integration."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import sympy as sp

from validation.paper.audit.body import PAPER_ROWS
from validation.paper.audit.case import Case
from validation.paper.audit.mechanics import t
from validation.paper.audit.rows import Evidence, against, claim, property_of, symbolic, zero

k, d, T, travel, lift_speed = sp.symbols("k d T D v", positive=True)
DRIFT_STEPS = 3
COM_ROWS, MOMENTUM_ROWS, FEET_ROWS = slice(0, 3), slice(3, 6), slice(6, PAPER_ROWS)
DIFFERENCES = 1e-6
"""What central differences leave of a rate [SI]."""
SWITCH = 1e-5
"""What a path may change within a nanosecond on either side of a switch, of 10 m/s^2."""


def rows(case: Case) -> Iterator[Evidence]:
    """Section 2.3, from top to bottom."""
    yield from _defined(case)
    yield from _feet(case)
    yield from _jacobians(case)
    yield from _constraints(case)
    yield from _posture(case)
    yield from _integration(case)


def cubic(start_speed: sp.Expr, end_speed: sp.Expr) -> sp.Expr:
    """The cubic over a swing of duration T and travel D with given speeds at both ends."""
    parts = sp.symbols("p0:4")
    path = sum(part * t**i for i, part in enumerate(parts))
    speed = sp.diff(path, t)
    found = sp.solve(
        [
            path.subs(t, 0),
            path.subs(t, T) - travel,
            speed.subs(t, 0) - start_speed,
            speed.subs(t, T) - end_speed,
        ],
        parts,
    )
    return path.subs(found)


def cubic_jump(case: Case) -> float:
    """Jump of the swing foot's forward acceleration on ``normal`` with the printed cubic [m/s^2]."""
    normal = case.normal
    values = {
        T: normal.t_ss,
        travel: 2.0 * normal.gait.step_length,
        lift_speed: normal.constants.l_s / normal.t_ss,
    }
    return float(sp.diff(cubic(lift_speed, sp.Integer(0)), t, 2).subs(t, 0).subs(values))


def _defined(case: Case) -> Iterator[Evidence]:
    body = case.body
    constant = body.motion.report.angular_momentum_y_offset
    drift = body.trunk_drift(0.0, DRIFT_STEPS)
    kept = body.trunk_drift(constant, DRIFT_STEPS)
    yield Evidence(
        "2.3",
        "what is defined",
        zero(
            "printed",
            f"trunk pitch gained in {DRIFT_STEPS} steps with mean L_y zero",
            drift,
            "rad",
            rounding=1e-3,
        ),
        claim(
            "corrected",
            "constant of L_y that closes the posture",
            constant,
            "N m s",
            abs(constant) > 1e-3,
        ),
        zero(
            "corrected",
            f"trunk pitch gained in {DRIFT_STEPS} steps with that constant",
            kept,
            "rad",
            rounding=1e-3,
        ),
    )


def _feet(case: Case) -> Iterator[Evidence]:
    normal, body = case.normal, case.body
    yield Evidence(
        "2.3",
        "Fig. 6, body",
        why="Its masses, lengths and joints are not printed, nor whether the root's six count. The body here "
        f"has {body.robot.nv} with them.",
    )
    apart, step = _footsteps(case), normal.gait.step_length
    yield Evidence(
        "2.3",
        "foot steps",
        zero("printed", "stance foot's advance in two steps less 4 (l_s + l_d)", apart - 2.0 * step, "m"),
    )
    speed = normal.constants.l_s / normal.t_ss
    jump_v, jump_a = body.swing_foot_jump()
    paper_v, paper_a = body.swing_foot_jump("paper")
    yield Evidence(
        "2.3",
        "v_swing",
        zero("printed", "jump of the velocity of a foot that has stood", speed, "m/s"),
        zero("printed", "the same as planned with foot.swing = paper", paper_v, "m/s"),
        zero("corrected", "jump of the swing foot's velocity at lift-off", jump_v, "m/s", rounding=SWITCH),
    )
    path = cubic(lift_speed, sp.Integer(0))
    yield Evidence(
        "2.3", "landing", symbolic("printed", "speed of the cubic at T", sp.diff(path, t).subs(t, T))
    )
    still = cubic(sp.Integer(0), sp.Integer(0))
    yield Evidence(
        "2.3",
        "cubic spline",
        symbolic(
            "printed",
            "acceleration at lift-off after standing, D the foot's travel",
            sp.diff(path, t, 2).subs(t, 0),
        ),
        symbolic("printed", "the same if it leaves from rest", sp.diff(still, t, 2).subs(t, 0)),
        zero("printed", "jump of the foot's x'' at lift-off", cubic_jump(case), "m/s^2"),
        zero(
            "printed",
            "the same of the rolling foot, planned with foot.swing = paper",
            paper_a,
            "m/s^2",
        ),
        symbolic("corrected", "quintic: velocity and acceleration at both ends", _quintic_ends()),
        zero(
            "corrected",
            "jump of the swing foot's acceleration",
            jump_a,
            "m/s^2",
            scale=10.0,
            rounding=SWITCH,
        ),
    )


def _footsteps(case: Case) -> float:
    """Advance of the left foot from the middle of one of its single supports to that of the next [m]."""
    normal = case.normal
    middle = 0.5 * normal.t_ss
    left = case.body.feet.sample(np.array([middle, middle + 2.0 * normal.constants.step_duration]))[0]
    return float(left.position[1, 0] - left.position[0, 0])


def _quintic_ends() -> list[sp.Expr]:
    share = t / T
    path = travel * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return [sp.diff(path, t, order).subs(t, at) for order in (1, 2) for at in (0, T)]


def _jacobians(case: Case) -> Iterator[Evidence]:
    body = case.body
    velocities, accelerations = body.velocities, body.accelerations
    where = "against differences along the walk, mid single support"

    def row(place: str, mismatch: float, unit: str, how: str) -> Evidence:
        return Evidence("2.3", place, zero("printed", how, mismatch, unit, rounding=DIFFERENCES))

    yield row(
        "J_cog",
        velocities.mismatch(COM_ROWS),
        "m/s",
        where,
    )
    yield row("Eq. 8", accelerations.mismatch(COM_ROWS), "m/s^2", where)
    yield row(
        "R",
        velocities.mismatch(MOMENTUM_ROWS) * body.robot.mass,
        "N m s",
        "against the sum over all segments",
    )
    yield Evidence(
        "2.3",
        "r, meaning",
        against("section 2 calls r the moment [N m] and omega the angular momentum [N m s]"),
    )
    yield row(
        "Eq. 9",
        accelerations.mismatch(MOMENTUM_ROWS) * body.robot.mass,
        "N m",
        where,
    )
    yield row(
        "Eq. 10",
        accelerations.mismatch(FEET_ROWS),
        "m/s^2",
        where,
    )


def _constraints(case: Case) -> Iterator[Evidence]:
    body, normal = case.body, case.normal
    heights = (3, 3, PAPER_ROWS - 6)
    yield Evidence(
        "2.3",
        "Eq. 11",
        zero(
            "printed",
            "rank of J_all less its 18 rows, mid single support",
            float(_rank(body.jacobian) - PAPER_ROWS),
            "1",
        ),
        zero(
            "printed",
            "largest residual over the step",
            body.motion.report.constraint_acceleration,
            "m/s^2",
            rounding=1e-7,
        ),
    )
    yield Evidence(
        "2.3",
        "order of lambda",
        zero("printed", "largest error of an entry in single support", body.permuted_constraints(), "SI"),
        zero(
            "corrected",
            "largest residual of the project's one order",
            body.motion.report.constraint_acceleration,
            "SI",
            rounding=1e-7,
        ),
    )
    yield Evidence(
        "2.3",
        "J_all",
        zero(
            "printed",
            "difference of the blocks' heights, which stand side by side",
            float(max(heights) - min(heights)),
            "1",
        ),
        zero(
            "corrected",
            "difference of the blocks' widths, stacked",
            float(body.jacobian.shape[1] - body.robot.nv),
            "1",
        ),
    )
    planned = normal.switch.moment.shape[1]
    yield Evidence(
        "2.3",
        "r_z in lambda",
        zero("printed", "components of r' that the mode plans, less 3", float(planned - 3), "1"),
        zero("corrected", "components of r' that the mode plans, less 2", float(planned - 2), "1"),
        why=f"Free here: it swings by {_yaw(case):.3g} N m s about zero on the normal gait.",
    )


def _rank(matrix: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(matrix))


def _yaw(case: Case) -> float:
    return float(abs(case.body.motion.angular_momentum_z).max())


def _posture(case: Case) -> Iterator[Evidence]:
    body = case.body
    run = body.planned.request.run
    stiffness, damping = run.body.posture_stiffness, run.body.posture_damping
    rate = sp.Symbol("lambda")
    growth = {sign: sp.solve(rate**2 + d * rate + sign * k, rate) for sign in (-1, 1)}
    fastest = {
        sign: max(float(sp.re(root.subs({k: stiffness, d: damping}))) for root in roots)
        for sign, roots in growth.items()
    }
    runaway = max(growth[-1], key=lambda root: float(sp.re(root.subs({k: 1, d: 1}))))
    total, product = sp.simplify(sum(growth[1])), sp.simplify(sp.prod(growth[1]))
    yield Evidence(
        "2.3",
        "Eq. 12, sign",
        property_of(
            "printed",
            "rate of the free minimiser, to be negative; positive for all k > 0",
            runaway,
            bool(runaway.is_negative),
        ),
        claim(
            "printed",
            f"that rate at k = {stiffness:g}/s^2, d = {damping:g}/s",
            fastest[-1],
            "1/s",
            fastest[-1] < 0.0,
        ),
        property_of("corrected", "sum of both rates, to be negative", total, bool(total.is_negative)),
        property_of("corrected", "product of both, to be positive", product, bool(product.is_positive)),
        claim("corrected", "the largest rate", fastest[1], "1/s", fastest[1] < 0.0),
    )
    column = sp.MatrixSymbol("q", 40, 1)
    yield Evidence(
        "2.3",
        "Eq. 12, product",
        zero("printed", "rows of the product less 1", float((column * column.T).shape[0] - 1), "1", ""),
        zero("corrected", "rows of the product less 1", float((column.T * column).shape[0] - 1), "1", ""),
    )
    flat = body.flat_directions()
    least = body.least_curvature()
    yield Evidence(
        "2.3",
        "Eq. 12, weights",
        zero("printed", "directions without any cost", float(flat), "1"),
        claim("corrected", "least curvature of the project's cost, to be positive", least, "1", least > 0.0),
    )


def _integration(case: Case) -> Iterator[Evidence]:
    report = case.body.motion.report
    yield Evidence(
        "2.3",
        "QP",
        zero(
            "printed",
            "largest residual of Eq. 11 over the step",
            report.constraint_acceleration,
            "m/s^2",
            rounding=1e-7,
        ),
    )
    grows = max(abs(complex(*pair)) for pair in report.multipliers)
    run = case.body.planned.request.run
    stiffness, damping = run.body.posture_stiffness, run.body.posture_damping
    runaway = 0.5 * (math.sqrt(damping**2 + 4.0 * stiffness) - damping)
    printed = math.exp(runaway * case.normal.constants.step_duration)
    yield Evidence(
        "2.3",
        "step by step",
        claim(
            "printed",
            "growth of a deviation per step, to be at most 1: free minimiser of Eq. 12 as printed",
            printed,
            "1",
            printed <= 1.0,
        ),
        claim(
            "printed",
            "the same of the whole body, Eq. 12 corrected (E14)",
            grows,
            "1",
            grows <= 1.0,
        ),
        zero("corrected", "largest difference of the mirrored return", report.residual, "rad"),
        why="Of an endless gait: integrated on, the posture leaves the periodic motion exponentially. With "
        f"Eq. 12 corrected a deviation doubles in {math.log(2.0) / math.log(grows):.0f} steps, so a demo of "
        "a few steps need not show it.",
    )

"""Section 3: the demos and Figs. 8 to 12."""

from __future__ import annotations

from collections.abc import Iterator

import sympy as sp

from validation.audit.case import Case
from validation.audit.mechanics import H, acceleration_towards, g, m, moment_y
from validation.audit.rows import Check, Row, Verdict, against, claim, symbolic, zero
from validation.audit.section_2_3 import SWITCH, cubic_jump

x, a, c = sp.symbols("x a c", real=True)
C_Y = (0.1, 0.4, 0.7, 1.0)
"""Fig. 11 names the first and the third."""
C_Y_WALKED = (0.1, 0.7, 1.0)
"""Those that the body walks: Fig. 11 and no moment at all."""
C_S = (0.8, 1.0, 1.2)
LONGER = 0.65
"""A longer step than the demo's [m], for the last c_s."""


def rows(case: Case) -> Iterator[Row]:
    """Section 3, from top to bottom."""
    yield from _normal(case)
    yield from _figure_11(case)
    yield from _figure_12(case)


def _normal(case: Case) -> Iterator[Row]:
    normal, body = case.normal, case.body
    force = m * acceleration_towards(a * x, c * x)
    turned = moment_y(a * x, x, acceleration_towards(a * x, c * x))
    yield Row(
        "3",
        "order",
        "first the COG, then ZMP and force from the COG, then the posture",
        checks=(
            symbolic(
                "printed",
                "x - (H F_x + M_y)/F_z - a x: the ZMP from COG, force and moment",
                x - (H * force + turned) / (m * g) - a * x,
            ),
        ),
        why="But for the constant of L_y, which only the posture can tell (E13).",
    )
    yield Row(
        "3",
        "parameters",
        "parameters in equations are set manually",
        why="Height, mass, a_s, share of single support, feet's distance, k, d and key-frames are not "
        "printed: no demo can be repeated number by number.",
    )
    residuals = normal.plan.residuals()
    yield Row(
        "3",
        "Fig. 8",
        "normal gait: step length 0.6 m, initial velocity of single support 1.0 m/s",
        checks=(
            zero("printed", "step length of the preset less 0.6 m", normal.gait.step_length - 0.6, "m"),
            zero(
                "printed",
                "speed at the start of single support less 1 m/s",
                normal.plan.sample(0.0).com_velocity[0, 0] - 1.0,
                "m/s",
            ),
            zero(
                "printed",
                "largest difference of the body's mirrored return",
                body.motion.report.residual,
                "rad",
            ),
        ),
        why="A plan and a periodic motion of the body exist; ampm validate shows what physics makes of them.",
    )
    yield Row(
        "3",
        "Fig. 9",
        "the COG's accelerations, anterior and lateral, are continuous at the switches",
        checks=(
            zero(
                "printed",
                "largest jump over all switches, both axes",
                residuals.acceleration * normal.plan.gravity,
                "m/s^2",
            ),
        ),
        why="The curves' values cannot be compared: the drawing is no table.",
    )
    yield Row(
        "3",
        "Fig. 10",
        "the angular accelerations of hip and knee are continuous as well",
        "they are, if the feet's paths are C2 (E17, E25)",
        checks=(
            zero(
                "printed",
                "jump at lift-off with the swing foot of section 2.3",
                body.joint_jump(cubic_jump(case)),
                "rad/s^2",
            ),
            zero(
                "corrected",
                "jump at lift-off with the feet here",
                body.joint_jump(None),
                "rad/s^2",
                scale=10.0,
                rounding=SWITCH,
            ),
        ),
        errata=("E25",),
        failure=Verdict.CONTRADICTED,
        why="The constraints of Eq. 11 jump with the foot, and hip and knee must follow.",
    )
    yield Row(
        "3",
        "figure numbers",
        "hip and knee are shown in Figure 3; the last demo in Figure 3",
        "in Figures 10 and 12",
        checks=(
            against("Figure 3 is the AMPM's sketch; the captions of Figs. 10 and 12 say what they show"),
        ),
        errata=("E30",),
    )


def _figure_11(case: Case) -> Iterator[Row]:
    plans = [case.varied(c_y=value) for value in C_Y]
    sizes = [plan.momentum_peak_to_peak(0) for plan in plans]
    checks: list[Check] = [
        claim(
            "printed",
            "L_x peak to peak at c_y 0.7 less that at 0.1, to be positive",
            sizes[2] - sizes[0],
            "N m s",
            sizes[2] > sizes[0],
        )
    ]
    checks += [
        claim(
            "corrected",
            f"L_x peak to peak at c_y = {value:g}, less than at any smaller c_y",
            size,
            "N m s",
            all(size < other for other in sizes[:i]),
        )
        for i, (value, size) in enumerate(zip(C_Y, sizes, strict=True))
    ]
    yield Row(
        "3",
        "Fig. 11, direction",
        "the angular momentum is increased by setting c_y from 0.1 to 0.7",
        "it decreases from 0.1 to 0.7, and vanishes at 1",
        checks=tuple(checks),
        errata=("E12",),
        failure=Verdict.CONTRADICTED,
        why="By Eq. 5 the moment scales with 1 - c_y.",
    )
    across = [plan.momentum_peak_to_peak(1) for plan in plans]
    scale = plans[0].plan.mass * plans[0].gait.com_height
    yield Row(
        "3",
        "Fig. 11, axis",
        "c_y changes the angular momentum around the frontal axis",
        "around the anterior axis, as Fig. 11 says",
        checks=(
            zero(
                "printed",
                "change of L_y's peak to peak less that of L_x, c_y 1 to 0.1",
                abs(across[0] - across[-1]) - abs(sizes[0] - sizes[-1]),
                "N m s",
                scale=scale,
            ),
            zero(
                "corrected",
                "change of L_y, the other horizontal axis, c_y 1 to 0.1",
                across[0] - across[-1],
                "N m s",
                scale=scale,
            ),
        ),
        errata=("E31",),
        why="Section 1.1 has no frontal axis; the frontal plane's normal is the anterior one.",
    )
    found = [(value, case.walked(c_y=value)) for value in C_Y if value in C_Y_WALKED]
    rolls = [(value, walked.trunk_roll) for value, walked in found if walked is not None]
    swings = [
        claim(
            "printed",
            f"trunk roll, peak to peak, at c_y = {value:g}, less than at any smaller c_y",
            roll,
            "rad",
            all(roll < other for _, other in rolls[:i]),
        )
        for i, (value, roll) in enumerate(rolls)
    ]
    yield Row(
        "3",
        "Fig. 11, trunk",
        "the model swings its upper body in the frontal plane by the size of the moment",
        checks=tuple(swings) if len(rolls) > 1 else (),
        why="In the inverse kinematics; a smaller c_y is a larger moment.",
    )


def _figure_12(case: Case) -> Iterator[Row]:
    plans = [case.varied(c_s=value) for value in C_S]
    yield Row(
        "3",
        "Fig. 12",
        "the angular momentum around the y-axis is enlarged",
        checks=tuple(
            claim(
                "printed",
                f"L_y peak to peak at c_s = {plan.gait.c_s:g}, more than at c_s = 1",
                plan.momentum_peak_to_peak(1),
                "N m s",
                plan.momentum_peak_to_peak(1) > plans[1].momentum_peak_to_peak(1),
            )
            for plan in plans
            if plan.gait.c_s != 1.0
        ),
        why="c_s of the demo is not printed.",
    )
    low, even, high = (case.walked(c_s=value) for value in C_S)
    swings: tuple[Check, ...] = ()
    if low is not None and even is not None and high is not None:
        swings = (
            claim(
                "printed",
                f"trunk pitch, peak to peak, at c_s = {C_S[0]:g} less that at 1, to be positive",
                low.trunk_pitch - even.trunk_pitch,
                "rad",
                low.trunk_pitch > even.trunk_pitch,
            ),
            claim(
                "corrected",
                f"trunk pitch, peak to peak, at c_s = {C_S[2]:g} less that at 1, to be positive",
                high.trunk_pitch - even.trunk_pitch,
                "rad",
                high.trunk_pitch > even.trunk_pitch,
            ),
        )
    yield Row(
        "3",
        "Fig. 12, trunk",
        "when a large moment is applied around the y-axis, the upper body swings largely (sagittal)",
        "for c_s > 1; a moment of the other sign (c_s < 1) is made by swinging less",
        checks=swings,
        failure=Verdict.CONTRADICTED,
        errata=("E32",),
        why="The legs alone have angular momentum, which the trunk must balance at c_s = 1. In the inverse "
        "kinematics, whose motions this body can walk or not.",
    )
    yield Row(
        "3",
        "Fig. 12, balance",
        "... and the model easily loses its balance",
        why="The plan has no balance to lose, and the paper names no measure; ampm validate walks it.",
    )
    long = case.walked(c_s=C_S[2], step_length=LONGER)
    more = ""
    if high is not None and long is not None:
        steps = f"{long.plan.parameters.step_length:g} m against {high.plan.parameters.step_length:g} m"
        change = long.trunk_pitch - high.trunk_pitch
        more = (
            f" It is not the swing that large steps prevent: at c_s = {C_S[2]:g}, steps of {steps} "
            f"change the trunk's pitch, peak to peak, by {change:+.3f} rad, since the moment grows with l_s."
        )
    yield Row(
        "3",
        "Fig. 12, large steps",
        "in order to prevent this, each step is made large",
        why="Whether large steps help the balance is a matter of physics." + more,
    )

"""Section 3: the demos and Figs. 8 to 12."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import sympy as sp

from validation.paper.audit.case import Case
from validation.paper.audit.mechanics import H, acceleration_towards, g, m, moment_y
from validation.paper.audit.rows import Check, Evidence, against, claim, symbolic, zero
from validation.paper.audit.section_2_3 import SWITCH, cubic_jump

if TYPE_CHECKING:
    from validation.paper.audit.body import BodyEvidence

x, a, c = sp.symbols("x a c", real=True)
C_Y = (0.1, 0.4, 0.7, 1.0)
"""Fig. 11 names the first and the third."""
C_Y_TRUNK = (0.1, 0.7, 0.9, 1.0, 1.1)
"""Where the trunk's roll is looked at: Fig. 11's two, a small moment, none, one of the other sign."""
C_Y_STILLEST = 0.9
"""Among them the one whose moment nearly does what the trunk would have to."""
C_S = (0.8, 1.0, 1.2)
LONGER = 0.65
"""A longer step than the demo's [m], for the last c_s."""
C_S_LONGER = 1.15
"""With the longer step it gives less angular momentum than the last c_s with the demo's."""


def rows(case: Case) -> Iterator[Evidence]:
    """Section 3, from top to bottom."""
    yield from _normal(case)
    yield from _figure_11(case)
    yield from _figure_12(case)


def _normal(case: Case) -> Iterator[Evidence]:
    normal, body = case.normal, case.body
    force = m * acceleration_towards(a * x, c * x)
    turned = moment_y(a * x, x, acceleration_towards(a * x, c * x))
    yield Evidence(
        "3",
        "order",
        symbolic(
            "printed",
            "x - (H F_x + M_y)/F_z - a x: the ZMP from COG, force and moment",
            x - (H * force + turned) / (m * g) - a * x,
        ),
    )
    yield Evidence(
        "3",
        "control",
        *(
            claim(
                "printed",
                f"{name} peak to peak at {key} = {far:g} less that at {near:g}, to be positive",
                change,
                "N m s",
                change > 0.0,
            )
            for name, axis, key, far, near in (("L_x", 0, "c_y", 0.1, 1.0), ("L_y", 1, "c_s", 1.2, 1.0))
            for change in (
                case.varied(**{key: far}).momentum_peak_to_peak(axis)
                - case.varied(**{key: near}).momentum_peak_to_peak(axis),
            )
        ),
    )
    residuals = normal.plan.residuals()
    yield Evidence(
        "3",
        "Fig. 8",
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
    )
    yield Evidence(
        "3",
        "Fig. 9",
        zero(
            "printed",
            "largest jump over all switches, both axes",
            residuals.acceleration * normal.plan.gravity,
            "m/s^2",
        ),
    )
    yield Evidence(
        "3",
        "Fig. 10",
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
    )
    yield Evidence(
        "3",
        "figure numbers",
        against("Figure 3 is the AMPM's sketch; the captions of Figs. 10 and 12 say what they show"),
    )


def _figure_11(case: Case) -> Iterator[Evidence]:
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
    yield Evidence("3", "Fig. 11, direction", *checks)
    across = [plan.momentum_peak_to_peak(1) for plan in plans]
    scale = plans[0].plan.mass * plans[0].gait.com_height
    yield Evidence(
        "3",
        "Fig. 11, axis",
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
    )
    yield _trunk_roll(case)


def _trunk_roll(case: Case) -> Evidence:
    found = {value: case.walked(c_y=value) for value in C_Y_TRUNK}
    rolls = {value: walked.trunk_roll for value, walked in found.items() if walked is not None}
    checks: tuple[Check, ...] = ()
    if len(rolls) == len(C_Y_TRUNK):

        def more(form: Literal["printed", "corrected"], far: float, near: float) -> Check:
            change = rolls[far] - rolls[near]
            what = f"trunk roll, peak to peak, at c_y = {far:g} less that at {near:g}, to be positive"
            return claim(form, what, change, "rad", change > 0.0)

        low, some, still, none, beyond = C_Y_TRUNK
        checks = (
            more("printed", low, some),
            more("printed", some, none),
            more("printed", still, none),
            more("corrected", low, some),
            more("corrected", some, still),
            more("corrected", none, still),
            more("corrected", beyond, none),
        )
    moment = case.varied(c_y=C_Y_STILLEST).momentum_peak_to_peak(0)
    return Evidence(
        "3",
        "Fig. 11, trunk",
        *checks,
        why="A smaller c_y is a larger moment, and between Fig. 11's own two values the sentence is right. "
        f"But at c_y = {C_Y_STILLEST:g} there is a moment (L_x {moment:.3g} N m s peak to peak), and the "
        "trunk swings less than with none: the swinging legs alone have angular momentum, which the trunk "
        "must balance at c_y = 1. The frontal twin of E32. In the inverse kinematics.",
    )


def _figure_12(case: Case) -> Iterator[Evidence]:
    plans = [case.varied(c_s=value) for value in C_S]
    yield Evidence(
        "3",
        "Fig. 12",
        *(
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
    yield Evidence("3", "Fig. 12, trunk", *swings)
    yield _large_steps(case, high)


def _large_steps(case: Case, high: BodyEvidence | None) -> Evidence:
    """Whether longer steps prevent the swing; ``high`` is the demo's step at the last c_s."""
    long = case.walked(c_s=C_S[2], step_length=LONGER)
    less = case.walked(c_s=C_S_LONGER, step_length=LONGER)
    checks: tuple[Check, ...] = ()
    if high is not None and long is not None and less is not None:
        step = high.planned.run.gait.step_length
        saved = case.varied(c_s=C_S_LONGER, step_length=LONGER).momentum_peak_to_peak(1)
        saved -= case.varied(c_s=C_S[2]).momentum_peak_to_peak(1)
        calmer = case.walked(c_s=C_S[1], step_length=step)
        where = f"{LONGER:g} m less that at {step:g} m"
        checks = (
            claim(
                "printed",
                f"trunk pitch, peak to peak, at steps of {where}, c_s = {C_S[2]:g}, to be negative",
                long.trunk_pitch - high.trunk_pitch,
                "rad",
                long.trunk_pitch < high.trunk_pitch,
            ),
            claim(
                "printed",
                f"the same, c_s = {C_S_LONGER:g} at the longer step: L_y {-saved:.2g} N m s less",
                less.trunk_pitch - high.trunk_pitch,
                "rad",
                less.trunk_pitch < high.trunk_pitch,
            ),
        )
        if calmer is not None:
            checks += (
                claim(
                    "corrected",
                    f"trunk pitch, peak to peak, at c_s = {C_S[1]:g} less that at {C_S[2]:g}, to be negative",
                    calmer.trunk_pitch - high.trunk_pitch,
                    "rad",
                    calmer.trunk_pitch < high.trunk_pitch,
                ),
            )
    return Evidence("3", "Fig. 12, large steps", *checks)

"""Section 4: summary."""

from __future__ import annotations

from collections.abc import Iterator

import sympy as sp

from validation.audit.case import Case
from validation.audit.mechanics import acceleration_towards
from validation.audit.rows import Row, Verdict, against, symbolic, zero

x, y, a_s, c_s, c_y = sp.symbols("x y a_s c_s c_y", real=True)
FASTER = 1.1
"""Speed at the switches, as a share of the demo's, with which the frontal plane is solved again."""


def rows(case: Case) -> Iterator[Row]:
    """Section 4, from top to bottom."""
    normal = case.normal
    yield Row(
        "4",
        "name",
        "the Enhanced Inverse Pendulum Model, based on the Inverse Pendulum Model",
        "inverted pendulum, in both",
        checks=(
            against("sections 1 and 2 call them Inverted Pendulum Mode and Enhanced Inverted Pendulum Model"),
        ),
        errata=("E33",),
    )
    law = acceleration_towards(x / a_s, c_s * x)
    yield Row(
        "4",
        "C2 throughout",
        "guarantees C2 continuity during the whole motion",
        checks=(
            zero(
                "printed",
                "largest jump of x'' and y'' over all switches of the plan",
                normal.plan.residuals().acceleration * normal.plan.gravity,
                "m/s^2",
            ),
        ),
        why="Of the COM in an endless gait, with the corrected equations. Not of the joints (Fig. 10), nor "
        f"for a start: x'' = {sp.factor(law / x)} x is zero at rest only at x = 0, where it stays.".replace(
            "*", " "
        ),
    )
    lateral = acceleration_towards(0, c_y * y)
    beta = normal.constants.beta
    moved = case.varied(switching_velocity=FASTER * normal.gait.switching_velocity).constants.beta
    yield Row(
        "4",
        "independence",
        "motion in the sagittal plane and the frontal plane can be calculated independently",
        "the laws are independent; the frontal constants follow from both sagittal durations",
        checks=(
            symbolic("printed", "d x''/dy and d y''/dx", (sp.diff(law, y), sp.diff(lateral, x))),
            zero("printed", f"change of beta with v_0 times {FASTER:g}", moved - beta, "m"),
            symbolic("corrected", "d x''/dy and d y''/dx", (sp.diff(law, y), sp.diff(lateral, x))),
        ),
        errata=("E13",),
        failure=Verdict.CONTRADICTED,
        why="Only one way: the sagittal plane does not feel the frontal one.",
    )
    yield Row(
        "4",
        "future",
        "approximate various kinds of gait and characterise them with these parameters",
        why="An intention.",
    )

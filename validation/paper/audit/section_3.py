"""Section 3: the demos and Figs. 8 to 12."""

from __future__ import annotations

import sympy as sp

from validation.paper.audit.case import Case
from validation.paper.audit.mechanics import H, acceleration_towards, g, m, moment_y
from validation.paper.audit.rows import Rows
from validation.paper.audit.section_2_3 import SWITCH, cubic_jump

x, a, c = sp.symbols("x a c", real=True)
C_Y = (0.1, 0.4, 0.7, 1.0)
"""Fig. 11 names the first and the third."""
C_Y_TRUNK = (0.1, 0.7, 0.9, 1.0, 1.1)
"""Where the trunk's roll is evaluated: Fig. 11's two, a small moment, none, one of the other sign."""
C_Y_TRUNK_PAPER = (0.7, 0.95, 1.0)
"""The same with L_z held at zero, the paper's own row."""
C_Y_STILLEST = 0.9
"""Among them the one with the smallest swing of the trunk."""
C_S = (0.8, 1.0, 1.2)
LONGER = 0.65
"""A longer step than the demo's [m], for the last c_s."""
C_S_LONGER = 1.15
"""With the longer step it gives less angular momentum than the last c_s with the demo's."""


def check(case: Case, rows: Rows) -> None:
    """Section 3, from top to bottom."""
    _normal(case, rows)
    _figure_11(case, rows)
    _trunk_roll(case, rows)
    _figure_12(case, rows)


def _normal(case: Case, rows: Rows) -> None:
    normal, body = case.normal, case.body
    force = m * acceleration_towards(a * x, c * x)
    turned = moment_y(a * x, x, acceleration_towards(a * x, c * x))
    rows["order"].symbolic(
        "x - (H F_x + M_y)/F_z - a x: the ZMP from COG, force and moment",
        x - (H * force + turned) / (m * g) - a * x,
    )
    control = rows["control"]
    for name, axis, key, far, near in (("L_x", 0, "c_y", 0.1, 1.0), ("L_y", 1, "c_s", 1.2, 1.0)):
        sizes = [case.varied(**{key: value}).momentum_peak_to_peak(axis) for value in (far, near)]
        what = f"{name} peak to peak at {key} = {far:g} less that at {near:g}"
        control.sign("positive", what, "N m s", sizes[0] - sizes[1])
    demo, speed = rows["Fig. 8"], normal.plan.sample(0.0).com_velocity[0, 0]
    demo.zero("step length of the preset less 0.6 m", "m", normal.gait.step_length - 0.6)
    demo.zero("speed at the start of single support less 1 m/s", "m/s", speed - 1.0)
    demo.zero("largest difference of the body's mirrored return", "rad", body.motion.report.residual)
    rows["Fig. 9"].zero("largest jump over all switches, both axes", "m/s^2", normal.largest_jump)
    joints, jump = rows["Fig. 10"], body.joint_jump(cubic_jump(case))
    joints.zero("jump at lift-off with the swing foot of section 2.3", "rad/s^2", jump)
    jump, what = body.joint_jump(None), "jump at lift-off with the feet here"
    joints.zero(what, "rad/s^2", corrected=jump, within=SWITCH)
    rows["figure numbers"].against(
        "Figure 3 is the AMPM's sketch; the captions of Figs. 10 and 12 say what they show"
    )


def _figure_11(case: Case, rows: Rows) -> None:
    plans = [case.varied(c_y=value) for value in C_Y]
    sizes = [plan.momentum_peak_to_peak(0) for plan in plans]
    direction, change = rows["Fig. 11, direction"], sizes[2] - sizes[0]
    direction.sign("positive", "L_x peak to peak at c_y 0.7 less that at 0.1", "N m s", change)
    for i, (value, size) in enumerate(zip(C_Y, sizes, strict=True)):
        what = f"L_x peak to peak at c_y = {value:g}, less than at any smaller c_y"
        direction.claim("corrected", what, all(size < other for other in sizes[:i]), size, "N m s")
    across = [plan.momentum_peak_to_peak(1) for plan in plans]
    axis = rows["Fig. 11, axis"]
    apart = abs(across[0] - across[-1]) - abs(sizes[0] - sizes[-1])
    axis.zero("change of L_y's peak to peak less that of L_x, c_y 1 to 0.1", "N m s", apart)
    what, apart = "change of L_y, the other horizontal axis, c_y 1 to 0.1", across[0] - across[-1]
    axis.zero(what, "N m s", corrected=apart)


def _trunk_roll(case: Case, rows: Rows) -> None:
    moment = case.varied(c_y=C_Y_STILLEST).momentum_peak_to_peak(0)
    trunk = rows["Fig. 11, trunk"]
    paper = {c_y: case.walked("zero", c_y=c_y).trunk_swing[0] for c_y in C_Y_TRUNK_PAPER}
    trunk.why = (
        "A smaller c_y is a larger moment, and between Fig. 11's own two values the sentence is right. "
        f"But at c_y = {C_Y_STILLEST:g} there is a moment (L_x {moment:.3g} N m s peak to peak), and the "
        "trunk swings less than with none: the swinging legs alone have angular momentum, which the trunk "
        "must balance at c_y = 1. With the paper's own row, L_z held at zero, the least is at c_y near "
        f"{C_Y_TRUNK_PAPER[1]:g}. The frontal twin of E32. In the inverse kinematics."
    )
    rolls = {value: case.walked(c_y=value).trunk_swing[0] for value in C_Y_TRUNK}
    low, some, still, none, beyond = C_Y_TRUNK
    what = "trunk roll, peak to peak, at c_y = {:g} less that at {:g}"
    for far, near in ((low, some), (some, none), (still, none)):
        trunk.sign("positive", what.format(far, near), "rad", rolls[far] - rolls[near])
    for far, near in ((low, some), (some, still), (none, still), (beyond, none)):
        trunk.sign("positive", what.format(far, near), "rad", corrected=rolls[far] - rolls[near])
    some, still, none = C_Y_TRUNK_PAPER
    for far, near in ((some, still), (none, still)):
        apart = paper[far] - paper[near]
        trunk.sign("positive", f"{what.format(far, near)}, L_z = 0", "rad", corrected=apart)


def _figure_12(case: Case, rows: Rows) -> None:
    plans = [case.varied(c_s=value) for value in C_S]
    momentum = rows["Fig. 12"]
    low, even, high = (plan.momentum_peak_to_peak(1) for plan in plans)
    for c_s, size in ((C_S[0], low), (C_S[2], high)):
        what = f"L_y peak to peak at c_s = {c_s:g}, more than at c_s = 1"
        momentum.claim("printed", what, size > even, size, "N m s")
    bodies = [case.walked(c_s=value) for value in C_S]
    pitches = [body.trunk_swing[1] for body in bodies]
    trunk = rows["Fig. 12, trunk"]
    what = "trunk pitch, peak to peak, at c_s = {:g} less that at 1"
    trunk.sign("positive", what.format(C_S[0]), "rad", pitches[0] - pitches[1])
    trunk.sign("positive", what.format(C_S[2]), "rad", corrected=pitches[2] - pitches[1])
    # Whether longer steps prevent the swing, from the demo's step at the last c_s.
    step, large = bodies[2].run.gait.step_length, rows["Fig. 12, large steps"]
    long, less = (
        case.walked(c_s=c_s, step_length=LONGER).trunk_swing[1] - pitches[2] for c_s in (C_S[2], C_S_LONGER)
    )
    saved = case.varied(c_s=C_S_LONGER, step_length=LONGER).momentum_peak_to_peak(1) - high
    what = f"trunk pitch, peak to peak, at steps of {LONGER:g} m less that at {step:g} m, c_s = {C_S[2]:g}"
    large.sign("negative", what, "rad", long)
    what = f"the same, c_s = {C_S_LONGER:g} at the longer step: L_y {-saved:.2g} N m s less"
    large.sign("negative", what, "rad", less)
    what = f"trunk pitch, peak to peak, at c_s = {C_S[1]:g} less that at {C_S[2]:g}"
    large.sign("negative", what, "rad", corrected=pitches[1] - pitches[2])

"""Every erratum of docs/errata.md, derived again: the printed form fails, the corrected one holds.

Oracles are Newton's law and ``M = (p - c) x F`` about the COM. Nothing of them is taken from the paper.
Numbers are those of the planned gaits ``normal`` (c_s = c_y = 1, which hides several misprints) and
``momentum``.
"""

import csv
import math
import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import sympy as sp
from scipy.linalg import null_space

import ampm
from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.step_reference import step_grid, step_reference
from tests.solved import COARSE, motion_of, walk_of

PAGE = Path(__file__).resolve().parents[1] / "docs" / "errata.md"
DATA = PAGE.parent / "data" / "errata.csv"
G = 9.81

g, H, m, t, T = sp.symbols("g H m t T", positive=True)
x, y, d, b = sp.symbols("x y d b", real=True)
a, c, c_s, c_y, s, beta = sp.symbols("a c c_s c_y s beta", positive=True)


def moment(zmp, com, force):
    """Moment of a force at the ZMP about the COM, ``(p - c) x F``: a column of three."""
    return (sp.Matrix(zmp) - sp.Matrix(com)).cross(sp.Matrix(force))


def zero(expression):
    """Whether an expression vanishes for all values of its symbols."""
    return sp.simplify(sp.sympify(expression).rewrite(sp.exp)) == 0


@cache
def planned(name="normal", **changed):
    """A planned gait under the paper's names, with the first numbers of its first double support."""
    run = ampm.load_run(name, gait=changed)
    plan = ampm.plan(run)
    k, gait = plan.constants, run.gait
    t_ss, t_ds = k.single_support_duration, k.double_support_duration
    w_c = math.sqrt(G / gait.com_height)  # 1/T_c of section 1.2
    w_l = math.sqrt(gait.c_y) * w_c  # 1/T_ls
    symbols = {"t_ss": t_ss, "t_ds": t_ds, "s": k.s, "beta": k.beta, "l_s": k.l_s, "l_d": k.l_d}
    symbols |= {"H": gait.com_height, "c_s": gait.c_s, "c_y": gait.c_y}
    symbols |= {"w_c": w_c, "w_l": w_l, "w_d": w_l * math.sqrt(k.s / k.beta)}
    symbols["v_ex"] = k.s * math.tanh(0.5 * w_l * t_ss)  # the paper's formula, by the half angle
    switch = {key: values[0] for key, values in vars(plan.sample([t_ss])).items()}
    stride = plan.sample(np.linspace(0.0, 2.0 * (t_ss + t_ds), 801))
    return SimpleNamespace(plan=plan, k=k, stride=stride, **symbols, **switch)


def listed():
    """Errata of page and data: number to cells (where, printed, corrected; of claims also the verdict)."""
    rows = re.findall(r"^\| (E\d+) \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    with DATA.open(encoding="utf-8", newline="") as file:
        data = {number: cells for number, _, *cells in list(csv.reader(file))[1:]}
    return data | {number: cells.replace("\\", "").split(" | ") for number, cells in rows}


def test_every_listed_erratum_has_a_test_and_every_test_is_listed():
    tested = {name.split("_")[1].upper() for name in globals() if re.match(r"test_e\d+_", name)}
    tested |= WORDS.keys() | {number for number, *_ in FORMULAS} | OFF.keys()
    assert tested == listed().keys()


WORDS = {
    "E21": ("lateral", {"sagittal": "2.1 ... the sagittal plane", "frontal": "2.2 ... the frontal plane"}),
    "E30": ("Figure 3", {"10": "Figure 10: ... the hip joint", "12": "Figure 12: The trajectory"}),
    "E33": ("Inverse", {"inverted": "Enhanced Inverted Pendulum Model"}),
}
"""Errata that only another place of the paper shows: the wrong word, and right ones with caption."""


@pytest.mark.parametrize("number", WORDS)
def test_errata_of_words_contradict_another_place_of_the_paper(number):
    wrong, elsewhere = WORDS[number]
    _, printed, corrected = listed()[number]
    assert wrong in printed
    assert wrong not in corrected
    assert all(right in corrected for right in elsewhere)


FORCE = sp.Matrix([m * g / H * (c * x + d), m * g / H * c_y * y, m * g])  # Newton's law at z = H

T_e = sp.sqrt(H / (c * g))
C_1, C_2 = sp.symbols("C_1 C_2", real=True)
FALLING, RISING = C_1 * sp.exp(-t / T_e), C_2 * sp.exp(t / T_e)
COM = FALLING + RISING - d / c
M_y = moment((a * COM + b, 0, 0), (COM, 0, H), (m * sp.diff(COM, t, 2), 0, m * g))[1]


def of_section_2(sign):
    """The paper's r and omega, ``d/c`` with the printed (+1) or the corrected (-1) sign."""
    r = -m * H / T_e**2 * (FALLING + RISING) - m * g * ((a - 1) * (FALLING + RISING + sign * d / c) + b)
    turned = (RISING - FALLING) * (-H / T_e - g * T_e * (a - 1))
    return r, m * (turned - g * ((a - 1) * sign * d / c + b) * t)


(R_PRINTED, OMEGA_PRINTED), (R, OMEGA) = map(of_section_2, (1, -1))

l_s, l_d, a_s, a_d, c_d = sp.symbols("l_s l_d a_s a_d c_d", positive=True)
# From the same force on the same ZMP, seen from the stance foot and from the middle of the feet.
A_D = sp.solve(sp.Eq(l_s / a_s, l_s + l_d - l_d / a_d), a_d)[0]
C_D = sp.solve(sp.Eq((c_s - 1 / a_s) * l_s, -(c_d - 1 / A_D) * l_d), c_d)[0]

ROOT = sp.sqrt(c_y * g / H)  # 1/T_ls
V_EX = (s * sp.cosh(T * ROOT) - s) / sp.sinh(T * ROOT)
SINGLE = s * sp.cosh(t * ROOT) - V_EX * sp.sinh(t * ROOT)
"""Eq. 6: distance of the COM from the stance foot, towards the midline."""
SPEED = -sp.diff(SINGLE, t).subs(t, 0)
Z_Y, C_3 = (beta + s) / beta * y, (beta + (1 - c_y) * s) / beta
CONTINUED = -c_y * s / (y - Z_Y).subs(y, beta)
"""``c_3`` of a force that goes on as in single support: ``y'' = -g/H c_y s`` at y = beta."""
R_X = moment((0, 0, 0), (0, y, H), (0, FORCE[1], m * g))[0]
R_X_PRINTED = y * (-m * g) - H * FORCE[1]


SWING = C_1 * sp.cos(a * t) + C_2 * sp.sin(a * t)
FORMULAS = [
    ("E1", FORCE[0] / FORCE[2] - (c * x + d) / H, FORCE[0] / FORCE[1] - (c * x + d) / H),
    ("E2", R - M_y, R_PRINTED - M_y),
    ("E3", sp.diff(OMEGA, t) - M_y, sp.diff(OMEGA_PRINTED, t) - M_y),
    ("E4", c_s * l_s + C_D * l_d - l_s - l_d, l_s / c_s + l_d / C_D - l_s - l_d),
    ("E6", SPEED / ROOT - V_EX, SPEED - V_EX),
    # At the switch the ZMP is at the foot, and the COM is beta from the midline.
    ("E7", Z_Y.subs(y, beta) - (beta + s), beta / (beta + s) * beta - (beta + s)),
    ("E8", CONTINUED - c_y, CONTINUED - C_3),
    ("E9", s + beta - SINGLE.subs(t, T) - beta, s + beta - SINGLE.subs(t, T) - (beta + s)),
    # For a path of the frequency a the curvature is -a^2 times the path.
    ("E10", sp.diff(SWING, t, 2) + a**2 * SWING, sp.diff(SWING, t, 2) + a**2 * (SWING - b * a**2)),
    ("E11", H * FORCE[1] - y * m * g - R_X, R_X_PRINTED - R_X),
    ("E11", R_X.subs(c_y, 1), R_X_PRINTED.subs(c_y, 1)),  # where the force passes through the COM
    ("E11", R_X + (y * m * g - H * FORCE[1]), R_X - (y * m * g - H * FORCE[1])),  # with F_z alone corrected
    # Parallel to (c x + d, H): a normal vector would be at right angles to it.
    ("E19", FORCE[0] * H - FORCE[2] * (c * x + d), FORCE[0] * (c * x + d) + FORCE[2] * H),
    ("E26", sp.diff(OMEGA, t) - R, OMEGA - R),  # section 2: r is the moment, the rate of omega
]
"""What vanishes with the corrected formula, and with the printed one."""


@pytest.mark.parametrize(("number", "corrected", "printed"), FORMULAS)
def test_what_the_corrected_formula_fulfils_the_printed_one_does_not(number, corrected, printed):
    assert zero(corrected)
    assert not zero(printed)


def test_the_formulas_around_them_are_right():
    assert zero(sp.diff(COM, t, 2) - g / H * (c * COM + d))
    assert zero(SINGLE.subs(t, T) - s)  # with the paper's own v_ex
    assert zero(l_s / a_s + l_d / A_D - l_s - l_d)  # Eq. 4 with a for c: the ZMP's


def jump(p, c_d):
    """x'' after the switch [m/s^2]."""
    return G / p.H * (c_d - 1.0 / p.k.a_d) * -p.l_d


def rolled(p, sign):
    """Place of the ZMP at an end of the single support [m]."""
    return p.plan.contacts.footsteps[1].position[0] + sign * p.l_s * p.k.inverse_a_s


def at_switch(p):
    """At the first switch: the planned number, by the corrected and by the printed form."""
    y, (forward, aside) = p.com[1], p.com_acceleration[:2]
    c_3 = (p.beta + (1.0 - p.c_y) * p.s) / p.beta
    printed_c_d = p.l_d / (p.l_s + p.l_d - p.l_s / p.c_s)
    return {
        "E1": (p.force[0] / p.force[2], forward / G, p.force[0] / p.force[1]),
        "E4": (forward, jump(p, (p.l_s + p.l_d - p.c_s * p.l_s) / p.l_d), jump(p, printed_c_d)),
        "E5": (p.zmp[0], rolled(p, 1.0), rolled(p, -1.0)),
        "E6": (abs(p.com_velocity[1]), p.v_ex * p.w_l, p.v_ex),
        "E7": (p.zmp[1], (p.beta + p.s) / p.beta * y, p.beta / (p.beta + p.s) * y),
        "E8": (aside, -G / p.H * p.c_y * p.s, -G / p.H * c_3 * p.s),
        "E11": (p.force[2], p.plan.mass * G, -p.plan.mass * G),
        "E15": (aside, -(p.w_d**2) * y, -(p.w_c**2) * y),
    }


OFF = {"E1": 1.0, "E4": 0.2, "E5": 0.1, "E6": 0.05, "E7": 0.05, "E8": 1.0, "E11": 1.0, "E15": 0.1}
"""How far the printed form is off."""
SAME = {"E4", "E8"}
"""Forms that agree where c_s = c_y = 1."""


@pytest.mark.parametrize("name", ["normal", "momentum"])
@pytest.mark.parametrize("number", OFF)
def test_the_plan_has_the_corrected_number_at_its_first_switch(number, name):
    planned_one, corrected, printed = at_switch(planned(name))[number]
    assert corrected == pytest.approx(planned_one)
    assert (abs(printed - planned_one) > OFF[number]) == (name == "momentum" or number not in SAME)


def test_e8_has_another_place_for_c_3_where_it_is_not_negative():
    assert zero(g / H * (C_3 * y - Z_Y) - g / H * c_y * (y - Z_Y))  # (c_3 y - z_y) : H
    assert C_3.subs(c_y, 1) == 1


def test_e20_omega_is_the_momentum_at_the_end_not_what_was_generated():
    at = [OMEGA.subs(t, time) for time in (0, T, 2 * T)]
    parts, whole = np.diff(at), at[2] - at[0]
    assert zero(parts.sum() - whole)  # what is generated adds up, without omega_1
    assert not zero((parts + b).sum() - (whole + b))  # but not with it


@pytest.mark.parametrize("name", ["normal", "momentum"])
def test_e23_cosine_and_sine_have_opposite_signs_as_it_crosses_the_midline(name):
    """The form that E6, E9, E10, E15 and E23 lead to, away from the foot positive, is the plan's."""
    p = planned(name)
    times = np.linspace(0.0, p.t_ds, 41)
    path = -p.beta * np.cos(p.w_d * times) + p.v_ex * p.w_l / p.w_d * np.sin(p.w_d * times)
    position = p.plan.sample(p.t_ss + times * (1.0 - 1e-9)).com[:, 1]
    assert -path * np.sign(position[0]) == pytest.approx(position, abs=1e-7)
    assert p.com[1] * p.com_velocity[1] < 0.0  # it comes from its foot
    assert path[-1] == pytest.approx(-path[0])
    for sign, crosses in ((1, False), (-1, True)):
        path = sign * beta * sp.cos(a * t) + s / a * sp.sin(a * t)  # a and s: any positive numbers
        assert (path * sp.diff(path, t)).subs(t, 0).is_negative == crosses


def test_e24_l_x_closes_by_the_mirror_image_not_by_symmetry_in_time():
    even = sp.cosh(t * ROOT)  # lateral distance from the foot, from the middle of a single support
    M_x = moment((0, 0, 0), (0, even, H), (0, m * g / H * c_y * even, m * g))[0]
    gained = sp.simplify(sp.integrate(M_x, (t, -T, T)))
    assert not zero(gained)
    assert zero(gained.subs(c_y, 1))
    gait = planned("momentum")
    assert abs(np.diff(gait.plan.sample([0.0, gait.t_ss]).angular_momentum[:, 0])[0]) > 10.0
    assert gait.stride.angular_momentum[-1, 0] == pytest.approx(gait.stride.angular_momentum[0, 0])


def test_e14_sign_of_the_spring_in_eq_12():
    k, damping = sp.symbols("k d", positive=True)
    rate = sp.Symbol("lambda")
    printed, corrected = (sp.solve(rate**2 + damping * rate + sign * k, rate) for sign in (-1, 1))
    assert zero(sp.prod(printed) + k)  # one rate is positive for all k, d: the minimiser runs away
    assert zero(sp.prod(corrected) - k)  # positive product, negative sum: both rates decay
    assert zero(sum(corrected) + damping)
    error = np.ones((40, 1))
    assert (error @ error.T).shape != (error.T @ error).shape == (1, 1)  # (...)(...)^T is not a number


@cache
def walk():
    """A walk, its periodic step and the state in the middle of the single support."""
    at, motion = walk_of(COARSE), motion_of(COARSE)
    k = int(np.argmin(np.abs(motion.time - 0.5 * at.plan.constants.single_support_duration)))
    rows = at.robot.jacobian(motion.q[k]).jacobian[:18]  # of Eq. 11; those of the toes follow
    state = {"q": motion.q[k], "v": motion.v[k], "acceleration": motion.acceleration[k], "jacobian": rows}
    return SimpleNamespace(run=at.run, plan=at.plan, robot=at.robot, motion=motion, **state)


def test_e16_eqs_10_and_11_order_the_feet_differently():
    """What J_f q'' + J_f' q' gives, against second differences of the feet's own poses."""
    at, h = walk(), 1e-4
    steps = (step * at.v + 0.5 * step**2 * at.acceleration for step in (-h, 0.0, h))
    before, here, after = (at.robot.jacobian(pin.integrate(at.robot.model, at.q, step)) for step in steps)
    linear = (after.sole - 2.0 * here.sole + before.sole) / h**2
    turns = ([pin.log3(pose.sole_turn[f] @ here.sole_turn[f].T) for f in (0, 1)] for pose in (before, after))
    angular = np.sum(list(turns), axis=0) / h**2
    given = (at.jacobian @ at.acceleration + at.robot.drift(at.q, at.v)[:18])[6:]
    assert given == pytest.approx(np.hstack([linear, angular]).ravel(), abs=1e-2)  # lambda: left, right
    assert np.abs(given - np.concatenate([*linear, *angular])).max() > 1.0  # Eq. 10: positions, rotations


def test_e17_a_foot_at_rest_cannot_leave_at_l_s_over_t_swing():
    plan, sole = walk().plan, walk().robot.description.sole
    foot, constants = plan.feet.sample(plan.constants.step_duration)[0], plan.constants
    forward = np.sin(foot.pitch) * foot.pitch_velocity  # of the reference point, per distance behind a point
    assert foot.velocity[:, 0] - sole.ball_x * forward == pytest.approx(0.0, abs=1e-6)  # the ball stands
    wanted = constants.l_s / constants.single_support_duration
    assert wanted > 0.4  # [m/s]: with this speed of the ball the foot would jump
    up = (sole.ball_x - sole.ankle_x) * np.sin(foot.pitch) + sole.ankle_height * np.cos(foot.pitch)
    assert wanted / up == pytest.approx(3.7, abs=0.1)  # as the ankle's, of a heel that rises at 3.7 rad/s


def test_e25_a_cubic_cannot_begin_and_end_without_acceleration():
    """Two rests are six conditions; a cubic has four coefficients."""
    D, v_0 = sp.symbols("D v_0", positive=True)
    parts = sp.symbols("p0:4")
    cubic = sum(part * t**i for i, part in enumerate(parts))
    rests = [(0, 0, 0), (0, T, D), (1, 0, v_0), (1, T, 0)]
    ends = [sp.diff(cubic, t, order).subs(t, at) - value for order, at, value in rests]
    acceleration = sp.diff(cubic.subs(sp.solve(ends, parts)), t, 2).subs(t, 0)
    assert zero(acceleration - (6 * D / T**2 - 4 * v_0 / T))


def test_e26_one_letter_for_moment_and_angular_momentum():
    at = walk()
    oracle = pin.computeCentroidalMomentum(at.robot.model, at.robot.model.createData(), at.q, at.v).angular
    assert at.robot.mass * (at.jacobian[3:6] @ at.v) == pytest.approx(oracle, abs=1e-8)  # 2.3: R q' is not


def test_e27_nothing_plans_r_z():
    """A ground reaction at the ZMP may have a twisting moment, which no formula of the paper gives."""
    assert planned().stride.moment.shape[1] == 2
    assert np.ptp(motion_of(COARSE).angular_momentum_z) > 0.1  # free here: it is what the body makes of it


def test_e28_the_blocks_are_stacked():
    rows = walk().jacobian
    blocks = rows[:3], rows[3:6], rows[6:]
    with pytest.raises(ValueError, match="dimension"):
        np.hstack(blocks)  # (J_cog, R, J_f): of unequal height


def test_e18_some_weight_is_needed_on_every_coordinate():
    at = walk()
    free = null_space(at.jacobian)  # accelerations that Eq. 11 leaves open
    named = np.concatenate([np.arange(3, 6), at.robot.trunk_joints])  # loins and chest, in the widest sense
    assert free.shape[1] - np.linalg.matrix_rank(free[named]) > 5  # directions without a cost
    weights = InverseKinematics(at.robot, at.run).body.weight[:, None]
    assert np.linalg.eigvalsh(free.T @ (weights * free)).min() > 1e-6


def continued(steps, constant):
    """Mean trunk pitch of each step after the periodic one [rad]; ``constant`` of L_y by those so far."""
    at = walk()
    ik, reference = InverseKinematics(at.robot, at.run), step_reference(at.plan, step_grid(at.plan, 0.004))
    q, v = at.motion.q[0], at.motion.v[0]
    pitches: list[float] = []
    for _ in range(steps):
        offset = constant(pitches) / at.robot.mass
        step = ik.integrate(reference.with_angular_momentum((0.0, offset)), q, v)
        q, v = at.robot.mirror_q(step.q[-1], -at.motion.step_length), at.robot.mirror_v(step.v[-1])
        pitches.append(float(np.trapezoid(step.trunk_pitch, reference.time) / reference.time[-1]))
    return np.array(pitches)


def test_e13_the_plan_leaves_the_constant_of_l_y_open():
    """The moment is odd in each phase: it fixes L_y but for a constant, on which the posture depends."""
    report = walk().motion.report
    constant = report.angular_momentum_y_offset
    assert continued(2, lambda _: constant) == pytest.approx(np.full(2, report.mean_trunk_pitch), abs=1e-5)
    assert abs(continued(2, lambda _: 0.0)[-1] - report.mean_trunk_pitch) > 0.1  # the mean of a plan alone


def test_e29_integrated_step_by_step_the_posture_is_unstable_for_long_walks():
    report = walk().motion.report
    growth = max(abs(complex(*pair)) for pair in report.multipliers)
    assert 1.0 < growth < 1.2  # of a deviation in one step: a short demo need not show it
    off = report.angular_momentum_y_offset + 1e-3

    def feedback(pitches):  # the mean trunk pitch corrects the constant once a step
        errors = [0.0, *(pitch - report.mean_trunk_pitch for pitch in pitches)]
        return off - 2.0 * errors[-1] - 0.5 * sum(errors)

    ways = lambda _: off, feedback
    fixed, corrected = (np.abs(continued(24, way) - report.mean_trunk_pitch) for way in ways)
    assert (np.diff(fixed) > 0.0).all()
    assert fixed[-1] / fixed[-2] == pytest.approx(growth, abs=0.05)
    assert corrected[-1] < 1e-3 * corrected.max()


def momentum_range(axis, **changed):
    """Peak to peak of L_x (0) or L_y (1) over a stride [N m s]."""
    return float(np.ptp(planned("normal", **changed).stride.angular_momentum[:, axis]))


def test_e12_l_x_falls_with_c_y():
    M_x = moment((0, 0, 0), (0, y, H), (0, m * g / H * c_y * y, m * g))[0]
    assert zero(M_x - m * g * (c_y - 1) * y)
    sizes = [momentum_range(0, c_y=value) for value in (0.1, 0.4, 0.7, 1.0)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 3.0 * sizes[2] > 10.0
    assert sizes[3] == pytest.approx(0.0, abs=1e-9)


def test_e31_c_y_changes_the_momentum_about_the_anterior_axis():
    assert momentum_range(0, c_y=0.1) - momentum_range(0, c_y=1.0) > 10.0
    assert momentum_range(1, c_y=0.1) == pytest.approx(momentum_range(1, c_y=1.0), abs=1e-9)


@cache
def trunk_swing(**changed):
    """Peak to peak of the trunk's roll and pitch over a stride of the inverse kinematics [rad]."""
    settings = (COARSE, *(f"gait.{key}={value}" for key, value in changed.items()))
    up = walk_of(*settings).robot.trunk_rotations(motion_of(*settings).q)[:, :, 2]
    roll, pitch = np.arctan2(-up[:, 1], up[:, 2]), np.arctan2(up[:, 0], up[:, 2])
    return 2.0 * float(np.abs(roll).max()), float(np.ptp(pitch))  # the next step mirrors this one


def test_e32_the_trunk_swings_largely_for_one_sign_of_the_moment():
    less, none, more = (trunk_swing(c_s=value)[1] for value in (0.8, 1.0, 1.2))
    assert momentum_range(1, c_s=0.8) > 1.0  # a moment, too
    assert less < none - 0.05 < none + 0.05 < more


def test_e34_the_trunk_takes_the_moment_less_that_of_the_legs():
    roll = {value: trunk_swing(c_y=value)[0] for value in (0.1, 0.7, 0.9, 1.0, 1.1)}
    assert roll[0.1] > roll[0.7] > roll[0.9]  # the paper's own values: as it says
    assert roll[0.9] < roll[1.0] < roll[1.1]  # but a little moment swings the trunk less than none

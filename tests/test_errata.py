"""Every erratum of docs/errata.md, derived again: the printed form fails, the corrected one holds.

Oracles are Newton's law, ``M = (p - c) x F`` about the COM, and numerical integration. Nothing of them is
taken from the paper. Numbers are those of the planned gaits ``normal`` (c_s = c_y = 1, which hides several
misprints) and ``momentum``.
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
from scipy.integrate import solve_ivp
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
    """A planned gait under the paper's names, and the plan at its first switch to double support."""
    run = ampm.load_run(name, gait=changed)
    plan = ampm.plan(run)
    k, gait = plan.constants, run.gait
    t_ss, t_ds = k.single_support_duration, k.double_support_duration
    w_c = math.sqrt(G / gait.com_height)  # 1/T_c of section 1.2
    w_l = math.sqrt(gait.c_y) * w_c  # 1/T_ls
    symbols = {"t_ss": t_ss, "t_ds": t_ds, "s": k.s, "beta": k.beta, "H": gait.com_height}
    symbols |= {"w_c": w_c, "w_l": w_l, "w_d": w_l * math.sqrt(k.s / k.beta)}
    symbols["v_ex"] = k.s * math.tanh(0.5 * w_l * t_ss)  # the paper's formula, by the half angle
    stride = plan.sample(np.linspace(0.0, 2.0 * (t_ss + t_ds), 801))
    return SimpleNamespace(plan=plan, k=k, gait=gait, switch=plan.sample([t_ss]), stride=stride, **symbols)


def integrated(law, start, times):
    """Positions and velocities, shape (2, n), of ``u'' = law(u)`` from a state, at ``times``."""

    def rates(_, u):
        return u[1], law(u[0])

    return solve_ivp(rates, (0.0, times[-1]), start, t_eval=times, rtol=1e-11, atol=1e-13).y


def listed():
    """Errata of page and data: number to cells (where, printed, corrected; of claims also the verdict)."""
    rows = re.findall(r"^\| (E\d+) \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    with DATA.open(encoding="utf-8", newline="") as file:
        data = {number: cells for number, _, *cells in list(csv.reader(file))[1:]}
    return data | {number: cells.replace("\\", "").split(" | ") for number, cells in rows}


def test_every_listed_erratum_has_a_test_and_every_test_is_listed():
    tested = {name.split("_")[1].upper() for name in globals() if re.match(r"test_e\d+_", name)}
    assert tested | set(WORDS) == set(listed())
    assert not tested & set(WORDS)


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
    for right, quoted in elsewhere.items():
        assert right in corrected
        assert right.lower() in quoted.lower()
        assert wrong not in quoted


def test_e1_the_ratio_is_of_the_vertical_force():
    force = sp.Matrix([m * g / H * (c * x + d), m * g / H * c_y * y, m * g])  # Newton's law at z = H
    assert zero(force[0] / force[2] - (c * x + d) / H)
    assert not zero(force[0] / force[1] - (c * x + d) / H)
    at = planned().switch
    ratio = at.com_acceleration[0, 0] / G
    assert at.force[0, 0] / at.force[0, 2] == pytest.approx(ratio)
    assert abs(at.force[0, 0] / at.force[0, 1] - ratio) > 1.0


def test_e19_the_force_itself_is_parallel():
    force, vector = sp.Matrix([m * g / H * (c * x + d), m * g]), sp.Matrix([c * x + d, H])
    assert zero(force[0] * vector[1] - force[1] * vector[0])
    assert not zero(force.dot(vector))  # a normal vector would be at right angles to it


LAW = SimpleNamespace(a=0.3, b=0.02, c=0.8, d=0.05, H=0.88, m=60.0, x_0=-0.2, v_0=1.1)
"""A law of section 2 with nothing zero [SI]."""


def of_section_2(sign):
    """The paper's r and omega over time, ``d/c`` with the printed (+1) or the corrected (-1) sign."""
    k, T_e = LAW, math.sqrt(LAW.H / (LAW.c * G))
    C_1, C_2 = (0.5 * (k.x_0 + k.d / k.c + side * k.v_0 * T_e) for side in (-1.0, 1.0))

    def r(t):
        both = C_1 * np.exp(-t / T_e) + C_2 * np.exp(t / T_e)
        return -k.m * k.H / T_e**2 * both - k.m * G * ((k.a - 1.0) * (both + sign * k.d / k.c) + k.b)

    def omega(t):
        turned = (-C_1 * np.exp(-t / T_e) + C_2 * np.exp(t / T_e)) * (-k.H / T_e - G * T_e * (k.a - 1.0))
        return k.m * (turned - G * ((k.a - 1.0) * sign * k.d / k.c + k.b) * t)

    return r, omega


def true_moment(times):
    """M_y by the integrated motion, ``-(p_x - x) m g - H m x''`` [N m]."""

    def law(u):
        return G / LAW.H * (LAW.c * u + LAW.d)

    position = integrated(law, [LAW.x_0, LAW.v_0], times)[0]
    return -LAW.H * LAW.m * law(position) - (LAW.a * position + LAW.b - position) * LAW.m * G


def test_e2_sign_of_d_over_c_in_the_moment():
    times = np.linspace(0.0, 0.5, 101)
    assert of_section_2(-1)[0](times) == pytest.approx(true_moment(times), abs=1e-6)
    off = of_section_2(1)[0](times) - true_moment(times)
    assert off == pytest.approx(2.0 * LAW.m * G * (1.0 - LAW.a) * LAW.d / LAW.c, abs=1e-6)


def test_e3_sign_of_d_over_c_in_the_angular_momentum():
    times = np.linspace(0.0, 0.5, 2001)
    gained = np.trapezoid(true_moment(times), times)
    for sign, holds in ((-1, True), (1, False)):
        omega = of_section_2(sign)[1]
        assert (abs(omega(0.5) - omega(0.0) - gained) < 1e-4) == holds


def test_e20_omega_is_the_momentum_at_the_end_not_what_was_generated():
    omega = of_section_2(-1)[1]
    parts = np.diff([omega(time) for time in (0.0, 0.2, 0.5)])
    whole, before = omega(0.5) - omega(0.0), 3.0  # omega_1 at t = 0 [N m s]
    assert whole == pytest.approx(parts.sum())  # what is generated adds up, without omega_1
    assert abs(whole + before - (parts + before).sum()) > 1.0  # but not with it


@pytest.mark.parametrize("name", ["normal", "momentum"])
def test_e4_eq_4_is_inverted(name):
    """From the same force on the same ZMP, seen from the stance foot and from the middle of the feet."""
    l_s, l_d, a_s, a_d, c_d = sp.symbols("l_s l_d a_s a_d c_d", positive=True)
    same_zmp = sp.Eq(l_s / a_s, l_s + l_d - l_d / a_d)
    same_force = sp.Eq((c_s - 1 / a_s) * l_s, -(c_d - 1 / a_d) * l_d)
    true_a_d = sp.solve(same_zmp, a_d)[0]
    true = sp.solve(same_force.subs(a_d, true_a_d), c_d)[0]
    assert zero(c_s * l_s + true * l_d - l_s - l_d)
    assert not zero(l_s / c_s + l_d / true - l_s - l_d)
    assert zero(l_s / a_s + l_d / true_a_d - l_s - l_d)  # Eq. 4 with a for c: the ZMP's
    gait = planned(name)
    k, both = gait.k, gait.k.l_s + gait.k.l_d
    printed, corrected = k.l_d / (both - k.l_s / gait.gait.c_s), (both - gait.gait.c_s * k.l_s) / k.l_d
    before = gait.plan.sample([gait.t_ss - 1e-9]).com_acceleration[0, 0]
    jump = [G / gait.H * (slope - 1.0 / k.a_d) * -k.l_d - before for slope in (printed, corrected)]
    assert jump[1] == pytest.approx(0.0, abs=1e-6)
    assert (abs(jump[0]) > 0.2) == (name == "momentum")  # at c_s = 1 both forms agree
    assert k.c_d == pytest.approx(corrected)


def test_e5_double_support_begins_with_the_zmp_at_z_1():
    gait = planned()
    stance, roll = gait.plan.contacts.footsteps[1].position[0], gait.k.l_s * gait.k.inverse_a_s
    z_0, z_1 = stance - roll, stance + roll
    beside = gait.plan.sample([gait.t_ss - 1e-9, gait.t_ss + 1e-9]).zmp[:, 0]
    assert beside == pytest.approx(np.full(2, z_1), abs=1e-6)
    assert z_1 - z_0 > 0.1


ROOT = sp.sqrt(c_y * g / H)  # 1/T_ls
V_EX = (s * sp.cosh(T * ROOT) - s) / sp.sinh(T * ROOT)
SINGLE = s * sp.cosh(t * ROOT) - V_EX * sp.sinh(t * ROOT)
"""Eq. 6: distance of the COM from the stance foot, towards the midline."""


def test_e6_v_ex_is_a_length():
    assert zero(SINGLE.subs(t, T) - s)  # with the paper's own v_ex
    speed = -sp.diff(SINGLE, t).subs(t, 0)
    assert zero(speed / ROOT - V_EX)
    assert not zero(speed - V_EX)
    gait, speed = planned(), abs(planned().switch.com_velocity[0, 1])
    assert gait.v_ex * gait.w_l == pytest.approx(speed)
    assert abs(gait.v_ex - speed) > 0.1


def test_e7_slope_of_the_lateral_zmp():
    corrected, printed = (beta + s) / beta, beta / (beta + s)
    assert zero(corrected * beta - (beta + s))  # at the switch the ZMP is at the foot
    assert not zero(printed * beta - (beta + s))
    gait = planned()
    com, zmp = gait.switch.com[0, 1], gait.switch.zmp[0, 1]
    assert (gait.beta + gait.s) / gait.beta * com == pytest.approx(zmp)
    assert abs(gait.beta / (gait.beta + gait.s) * com - zmp) > 0.05


def test_e8_c_3_is_c_y_or_belongs_in_another_place():
    """The force of double support continues that of single support: ``y'' = -g/H c_y s`` at y = beta."""
    zmp, printed = (beta + s) / beta * y, (beta + (1 - c_y) * s) / beta
    continued = -c_y * s / (y - zmp).subs(y, beta)
    assert zero(continued - c_y)
    assert not zero(continued - printed)
    assert zero(g / H * (printed * y - zmp) - g / H * c_y * (y - zmp))  # its other place: (c_3 y - z_y) : H
    assert printed.subs(c_y, 1) == 1  # and not negative
    gait = planned("momentum")
    form = printed.subs({beta: gait.beta, s: gait.s, c_y: gait.gait.c_y})
    wanted = gait.switch.com_acceleration[0, 1]
    assert -G / gait.H * gait.gait.c_y * gait.s == pytest.approx(wanted)
    assert abs(-G / gait.H * form * gait.s - wanted) > 1.0


def double_support(gait):
    """Lateral position and velocity by numerical integration of Eq. 7 with c_3 = c_y from the switch."""
    rate = G / gait.H * gait.gait.c_y * (1.0 - (gait.beta + gait.s) / gait.beta)
    times = np.linspace(0.0, gait.t_ds, 41)
    start = [gait.switch.com[0, 1], gait.switch.com_velocity[0, 1]]
    return times, integrated(lambda u: rate * u, start, times)


@pytest.mark.parametrize("name", ["normal", "momentum"])
def test_double_support_as_corrected(name):
    """The form that E6, E9, E10, E15 and E23 lead to, away from the foot positive, is the true motion."""
    gait = planned(name)
    times, (position, velocity) = double_support(gait)
    speed = gait.v_ex * gait.w_l
    path = -gait.beta * np.cos(gait.w_d * times) + speed / gait.w_d * np.sin(gait.w_d * times)
    assert -path * np.sign(position[0]) == pytest.approx(position, abs=1e-8)
    sample = gait.plan.sample(gait.t_ss + times * (1.0 - 1e-9))
    assert sample.com[:, 1] == pytest.approx(position, abs=1e-7)
    assert sample.com_velocity[:, 1] == pytest.approx(velocity, abs=1e-7)


def test_e9_amplitude_of_the_cosine():
    distance = s + beta - SINGLE.subs(t, T)  # from the midline, at the end of Eq. 6
    assert zero(distance - beta)
    assert not zero(distance - (beta + s))


def test_e10_no_offset():
    w, first, second = sp.symbols("omega_d C_1 C_2", positive=True)
    path = first * sp.cos(w * t) + second * sp.sin(w * t)
    assert zero(sp.diff(path, t, 2) + w**2 * path)
    shifted = path - b * w**2
    assert not zero(sp.diff(shifted, t, 2) + w**2 * shifted)


def test_e11_the_force_on_the_body_points_upwards():
    assert planned().switch.force[0, 2] == pytest.approx(planned().plan.mass * G)
    F_y = m * g / H * c_y * y
    true = moment((0, 0, 0), (0, y, H), (0, F_y, m * g))[0]  # F_z = m g, as z'' = 0
    assert zero(H * F_y - y * m * g - true)
    printed = y * (-m * g) - H * F_y
    assert not zero(printed - true)
    assert zero(y * m * g - H * F_y + true)  # with F_z alone corrected, r_x has the wrong sign
    assert not zero(printed.subs(c_y, 1))  # where the force passes through the COM


def test_e15_time_constant_of_double_support():
    for gait in (planned("normal"), planned("momentum")):
        end, pulled = gait.switch.com[0, 1], gait.switch.com_acceleration[0, 1]  # as in single support
        assert -(gait.w_d**2) * end == pytest.approx(pulled)
        assert abs(-(gait.w_c**2) * end - pulled) > 0.1


def test_e23_cosine_and_sine_have_opposite_signs():
    position, velocity = double_support(planned())[1]
    assert position[0] * velocity[0] < 0.0  # it comes from its foot and crosses the midline
    assert position[-1] == pytest.approx(-position[0])
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
    parts = sp.symbols("p0:6")

    def path(degree, conditions):
        curve = sum(part * t**i for i, part in enumerate(parts[: degree + 1]))
        ends = [sp.diff(curve, t, order).subs(t, at) - value for order, at, value in conditions]
        return curve.subs(sp.solve(ends, parts[: degree + 1]))

    rests = [(0, 0, 0), (0, T, D), (1, 0, v_0), (1, T, 0)]
    assert zero(sp.diff(path(3, rests), t, 2).subs(t, 0) - (6 * D / T**2 - 4 * v_0 / T))
    quintic = path(5, [*rests, (2, 0, 0), (2, T, 0)])
    assert all(zero(sp.diff(quintic, t, 2).subs(t, at)) for at in (0, T))


def test_e26_one_letter_for_moment_and_angular_momentum():
    r, omega = of_section_2(-1)
    rate = (omega(0.3 + 1e-6) - omega(0.3 - 1e-6)) / 2e-6
    assert r(0.3) == pytest.approx(rate, rel=1e-6)  # section 2: r is the moment, the rate of omega
    at = walk()
    oracle = pin.computeCentroidalMomentum(at.robot.model, at.robot.model.createData(), at.q, at.v).angular
    assert at.robot.mass * (at.jacobian[3:6] @ at.v) == pytest.approx(oracle, abs=1e-8)  # 2.3: R q' is not


def test_e27_nothing_plans_r_z():
    """A ground reaction at the ZMP may have a twisting moment, which no formula of the paper gives."""
    tau = sp.Symbol("tau", real=True)
    M = moment((a, b, 0), (x, y, H), (c, d, m * g)) + sp.Matrix([0, 0, tau])
    assert [part.has(tau) for part in M] == [False, False, True]
    assert planned().stride.moment.shape[1] == 2
    assert np.ptp(motion_of(COARSE).angular_momentum_z) > 0.1  # free here: it is what the body makes of it


def test_e28_the_blocks_are_stacked():
    rows = walk().jacobian
    blocks = rows[:3], rows[3:6], rows[6:]
    with pytest.raises(ValueError, match="dimension"):
        np.hstack(blocks)  # (J_cog, R, J_f): of unequal height
    stacked = np.hstack([block.T for block in blocks]).T
    assert stacked @ walk().v == pytest.approx(np.concatenate([block @ walk().v for block in blocks]))


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
        step = ik.integrate(reference.with_angular_momentum_y(offset), q, v)
        q, v = at.robot.mirror_q(step.q[-1], -at.motion.step_length), at.robot.mirror_v(step.v[-1])
        pitches.append(float(np.trapezoid(step.trunk_pitch, reference.time) / reference.time[-1]))
    return np.array(pitches)


def test_e13_the_plan_leaves_the_constant_of_l_y_open():
    """The moment is odd in each phase: it fixes L_y but for a constant, on which the posture depends."""
    M_y = moment((a * x, 0, 0), (x, 0, H), (m * g / H * (c_s - a) * x, 0, m * g))[1]
    for odd in (sp.sinh(beta * t), sp.sin(beta * t)):
        assert zero(sp.integrate(M_y.subs(x, odd), (t, -T, T)))  # so L_y closes for every constant
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

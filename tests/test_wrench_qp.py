"""The condensed QP: its force map against cross products, its cost term by term, and limits that it keeps."""

import numpy as np
import pytest

from ampm.compiled import records
from ampm.control import forces as contact_forces
from ampm.control import wrench_qp
from ampm.control.forces import (
    ANGULAR,
    LARGEST_NORMAL,
    LARGEST_PUSHED,
    LEAST_NORMAL,
    TWIST_ARM,
    point_forces,
    share_forces,
    without_closed,
    wrench_map,
)
from ampm.control.records import POINT
from ampm.control.wrench_qp import MOMENTUM_SLACK, TWIST_SHARE, CondensedForm, fill_qp
from ampm.qp import QPSettings

POINTS = 6
FOOT = POINTS + 3
FORCES = 2 * FOOT
LINES = np.tile(np.repeat([0, 1, 2], 2), (2, 1))
SEEDS = range(4)
FRICTION = 0.6
UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # a wrench that carries the weight
X = np.array([-0.1, -0.1, 0.08, 0.08, 0.15, 0.15])
Y = np.array([0.03, -0.03, 0.045, -0.045, 0.03, -0.03])


def stance(seed):
    """Sole points about the COM and openings of two feet on the floor, one half open; force unknowns."""
    rng = np.random.default_rng(seed)
    arm = np.empty((2, POINTS, 3))
    for foot, (x, y) in enumerate([(0.1, 0.09), (-0.2, -0.09)]):
        arm[foot] = np.column_stack([X + x, Y + y, np.full(POINTS, -0.88)])
    arm += rng.normal(scale=0.01, size=arm.shape)
    opening = np.concatenate([np.ones(POINTS), np.repeat(rng.uniform(0.0, 1.0, 3), 2)])
    return arm, opening, rng.normal(size=FORCES)


class ForceMap:
    """Points with their shares, and the net wrench of the unknowns."""

    def __init__(self, arm, opening):
        self.points = records(2 * POINTS, POINT)
        self.points["foot"], self.points["line"] = np.repeat([0, 1], POINTS), LINES.ravel()
        self.wrench = np.ones((6, FORCES))
        self.update(arm, opening)

    def update(self, arm, opening):
        self.points["arm"], self.points["limit"] = arm.reshape(-1, 3), opening
        share_forces(2, self.points, np.zeros(FORCES), False)
        wrench_map(2, self.points, self.wrench)

    def point_forces(self, phi):
        forces = np.empty((2 * POINTS, 3))
        point_forces(2, self.points, phi, 1.0, forces)
        return forces.reshape(2, POINTS, 3)


def force_map(seed):
    arm, opening, phi = stance(seed)
    return ForceMap(arm, opening), arm, opening, phi


@pytest.mark.parametrize("seed", SEEDS)
def test_wrench_is_that_of_the_point_forces(seed):
    forces, arm, _, phi = force_map(seed)
    point = forces.point_forces(phi)
    moment = ANGULAR * np.cross(arm, point).sum(axis=(0, 1))
    np.testing.assert_allclose(forces.wrench @ phi, [*point.sum(axis=(0, 1)), *moment], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_unknowns_mean_what_they_are_called(seed):
    forces, arm, opening, phi = force_map(seed)
    point, by_foot = forces.point_forces(phi), phi.reshape(2, FOOT)
    np.testing.assert_allclose(point[:, :, 2], by_foot[:, :POINTS], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(point[:, :, :2].sum(axis=1), by_foot[:, 6:8], rtol=0.0, atol=1e-12)
    share = np.maximum(opening.reshape(2, POINTS), 1e-3)
    share /= share.sum(axis=1, keepdims=True)
    for foot in (0, 1):  # a unit twist is a pure moment about the vertical
        unit = np.zeros(FORCES)
        unit[FOOT * foot + 8] = 1.0
        twist = forces.point_forces(unit)[foot]
        np.testing.assert_allclose(twist.sum(axis=0), 0.0, rtol=0.0, atol=1e-14)
        assert np.cross(arm[foot], twist).sum(axis=0)[2] == pytest.approx(TWIST_ARM)
        unit = np.zeros(FORCES)
        unit[FOOT * foot + 6] = 1.0
        np.testing.assert_allclose(forces.point_forces(unit)[foot, :, 0], share[foot], rtol=0.0, atol=1e-14)


def test_off_the_plan_a_foot_twists_about_its_load():
    arm, _, phi = stance(0)
    forces = ForceMap(arm, np.ones(2 * POINTS))
    whole = forces.points["lever"][2:4].copy()
    phi[:FOOT] = 0.0
    phi[2:4] = 0.5  # all at the ball
    share_forces(2, forces.points, phi, True)
    np.testing.assert_allclose(forces.points["share"][:6], [0, 0, 0.5, 0.5, 0, 0], atol=2e-3)
    half_width = 0.5 * np.linalg.norm(arm[0, 2] - arm[0, 3])
    np.testing.assert_allclose(forces.points["lever"][2:4], half_width, rtol=0.02)
    assert (whole > half_width).all()
    assert (forces.points["largest"] == LARGEST_PUSHED).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_forces_at_closed_points_are_dropped_within_the_friction(seed):
    def still_open(phi, opening):
        points = records(2 * POINTS, POINT)
        points["limit"] = opening
        return without_closed(2, points, phi)

    rng = np.random.default_rng(seed)
    phi, opening = rng.uniform(0.1, 1.0, FORCES), np.ones(2 * POINTS)
    phi[[6, 7, 8, 15, 16, 17]] *= 0.1
    np.testing.assert_array_equal(still_open(phi, opening), phi)
    opening[[0, 1, 8]] = 0.0
    kept = still_open(phi, opening).reshape(2, FOOT)
    assert kept[0, 0] == kept[0, 1] == kept[1, 2] == 0.0
    before = phi.reshape(2, FOOT)
    ratio = before[:, POINTS:] / before[:, :POINTS].sum(axis=1, keepdims=True)
    np.testing.assert_allclose(kept[:, POINTS:] / kept[:, :POINTS].sum(axis=1, keepdims=True), ratio)
    assert (still_open(phi, np.zeros(12)) == 0.0).all()
    assert (still_open(np.zeros(18), np.ones(12)) == 0.0).all()


# ---------------------------------------------------------------------------------------------------- the QP


def condensed(solver="daqp", tolerance=1e-9):
    settings = QPSettings(tolerance=tolerance, max_iterations=20_000)
    return CondensedForm(solver, settings, FRICTION, LINES)


def fill(form, forces, wanted=UPRIGHT, landing=None, load=0.4, yaw=(0.2, -0.03)):
    if landing is not None:
        forces.points["least"] = np.maximum(forces.points["least"], landing)
        forces.points["largest"] = np.maximum(forces.points["largest"], forces.points["least"])
    curvature, gradient = yaw
    costs, limits = (form.P, form.q), (form.A, form.lower, form.upper)
    given = load, curvature, gradient, FRICTION
    fill_qp(2, forces.points, forces.wrench, wanted, *given, *costs, *limits)


def build(form, seed, wanted=UPRIGHT, landing=None, load=0.4, yaw=(0.2, -0.03)):
    forces, arm, opening, _ = force_map(seed)
    fill(form, forces, wanted, landing, load, yaw)
    return forces, arm, opening


@pytest.mark.parametrize("seed", SEEDS)
def test_wanted_wrench_is_given_where_it_can_be(seed):
    """That of forces shared as planned: hardly any slack, but for the yaw, which has little weight."""
    rng = np.random.default_rng(seed)
    forces, _, opening, _ = force_map(seed)
    share = np.maximum(opening.reshape(2, POINTS)[:, :4], 1e-3)
    phi = np.zeros((2, FOOT))
    phi[:, :4] = np.array([[0.6], [0.4]]) * share / share.sum(axis=1, keepdims=True)
    phi[:, 6:8] = 0.02 * rng.normal(size=(2, 2))
    wanted = forces.wrench @ phi.ravel()
    form = condensed()
    build(form, seed, wanted)
    solution = form.solve()
    assert solution.solved
    given = forces.wrench @ solution.x[:FORCES]
    np.testing.assert_allclose(given[:5], wanted[:5], atol=5e-4)
    np.testing.assert_allclose(given - MOMENTUM_SLACK * solution.x[FORCES:], wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_forces_stay_within_friction_and_ramps_whatever_is_asked(seed, solver):
    rng = np.random.default_rng(100 + seed)
    form = condensed(solver, 1e-6)
    for _ in range(5):
        _, arm, opening = build(form, seed, UPRIGHT + rng.normal(size=6))
        solution = form.solve()
        assert solution.solved
        slack = 1e-5
        for foot, phi in enumerate(solution.x[:FORCES].reshape(2, FOOT)):
            normal, total = phi[:POINTS], phi[:POINTS].sum()
            ramp = opening[POINTS * foot : POINTS * (foot + 1)]
            assert (normal >= LEAST_NORMAL * ramp - slack).all()
            assert (normal <= np.maximum(LARGEST_NORMAL, LEAST_NORMAL) * ramp + slack).all()
            assert np.hypot(*phi[6:8]) <= np.abs(phi[6:8]).sum() <= FRICTION * total + slack
            share = np.maximum(ramp, 1e-3) / np.maximum(ramp, 1e-3).sum()
            lever = np.linalg.norm(arm[foot, :, :2] - share @ arm[foot, :, :2], axis=1)
            assert abs(phi[8]) * TWIST_ARM <= TWIST_SHARE * FRICTION * normal @ lever + slack


def test_closed_feet_carry_nothing_and_landing_points_what_they_sense():
    form = condensed()
    forces = ForceMap(stance(0)[0], np.array([1.0] * 6 + [0.0] * 6))
    fill(form, forces, load=0.0, yaw=(0.1, 0.0))
    np.testing.assert_allclose(form.solve().x[FOOT : 2 * FOOT], 0.0, rtol=0.0, atol=1e-9)
    landing = np.zeros(12)
    landing[6:8] = 0.03, 0.05
    fill(form, forces, landing=landing, load=0.0, yaw=(0.1, 0.0))
    np.testing.assert_allclose(form.solve().x[FOOT : FOOT + POINTS], landing[6:], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("load", [0.0, 0.3, 1.0])
def test_load_goes_where_it_is_planned_if_the_wrench_leaves_it_open(load):
    """With the wanted moment of that very load, both agree to the last gram."""
    form = condensed()
    arm = stance(0)[0]
    forces = ForceMap(arm, np.ones(12))
    normal = np.zeros((2, 6, 3))
    normal[0, :4, 2], normal[1, :4, 2] = 0.25 * (1.0 - load), 0.25 * load
    wanted = np.zeros(6)
    wanted[:3], wanted[3:] = normal.sum(axis=(0, 1)), ANGULAR * np.cross(arm, normal).sum(axis=(0, 1))
    fill(form, forces, wanted, load=load, yaw=(0.1, 0.0))
    by_foot = form.solve().x[:FORCES].reshape(2, FOOT)[:, :POINTS].sum(axis=1)
    np.testing.assert_allclose(by_foot, [1.0 - load, load], atol=0.03)


@pytest.mark.parametrize("seed", SEEDS)
def test_matrices_are_the_documented_cost(seed):
    """The cost of any point, written out term by term."""
    rng = np.random.default_rng(seed)
    form, load, curvature, gradient = condensed(), 0.4, 0.2, -0.03
    forces, _, opening = build(form, seed, load=load, yaw=(curvature, gradient))

    def cost(x):
        phi, slack = x[:FORCES].reshape(2, FOOT), x[FORCES:]
        normal, tangent = phi[:, :POINTS], phi[:, POINTS:]
        loads = np.array([1.0 - load, load])
        total = 0.5 * (slack**2).sum()
        total += 0.5 * wrench_qp.TANGENT_COST * ((tangent**2).sum(axis=1) / loads).sum()
        total += 0.5 * contact_forces.NORMAL_COST * (normal[:, :4] ** 2).sum()
        total += 0.5 * wrench_qp.TIP_COST * (normal[:, 4:] ** 2).sum()
        shares = np.maximum(opening.reshape(2, POINTS)[:, :4], 1e-3)
        shares /= shares.sum(axis=1, keepdims=True)
        planned = np.array([1.0 - load, load])
        total -= contact_forces.NORMAL_COST * (planned[:, None] * shares * normal[:, :4]).sum()
        total += 0.5 * wrench_qp.LOAD_COST * (normal[1].sum() - load) ** 2
        yaw = forces.wrench[5].reshape(2, FOOT)[:, POINTS:].ravel() @ tangent.ravel()
        total += wrench_qp.YAW_COST * (0.5 * curvature * yaw**2 + gradient * yaw)
        return total

    def quadratic(x):
        return 0.5 * x @ form.P @ x + form.q @ x

    constant = cost(np.zeros(24))
    for _ in range(5):
        x = rng.normal(size=24)
        assert quadratic(x) + constant == pytest.approx(cost(x), rel=1e-12)
    np.testing.assert_allclose(form.P, form.P.T, rtol=0.0, atol=1e-15)
    assert np.linalg.eigvalsh(form.P).min() > 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_form_keeps_its_sparsity_and_nothing_of_the_tick_before(seed):
    """But the twist's linear force, which is zero but for rounding."""
    form, other = condensed(), condensed()
    forces, _, opening, _ = force_map(seed)
    fill(form, ForceMap(stance(seed)[0], 1.0 - opening), 0.5 * UPRIGHT, np.full(12, 0.02), 0.9, (0.3, 0.1))
    for one in (form, other):
        fill(one, forces)
    for name in ("P", "q", "A", "lower", "upper"):
        np.testing.assert_array_equal(getattr(form, name), getattr(other, name))
    assert not form.P[~form.P_mask()].any()
    assert np.abs(form.A[~form.A_mask()]).max() < 1e-15

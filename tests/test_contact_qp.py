"""The QP of the contact forces: what it gives, and limits that it keeps. Its matrices: ``test_tick``."""

import numpy as np
import pytest

from ampm.compiled import refer
from ampm.control.contact_qp import L_Z, MOMENTUM_SLACK, TWIST_SHARE, fill_qp
from ampm.control.controller import TrackingController
from ampm.control.forces import LARGEST_NORMAL, LEAST_NORMAL, TWIST_ARM, share_forces, wrench_map
from ampm.controller_parameters import ControllerParameters
from ampm.parameters import RunParameters, SolverParameters
from tests.solved import COARSE, walk_of

POINTS = 6
FOOT = POINTS + 3
FORCES = 2 * FOOT
SEEDS = range(4)
FRICTION = 0.6
NONE = np.zeros(FORCES)
UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # a wrench that carries the weight
X = np.array([-0.1, -0.1, 0.08, 0.08, 0.15, 0.15])
Y = np.array([0.03, -0.03, 0.045, -0.045, 0.03, -0.03])


def stance(seed):
    """Sole points about the COM and openings of two feet on the floor, one half open."""
    rng = np.random.default_rng(seed)
    arm = np.empty((2, POINTS, 3))
    for foot, (x, y) in enumerate([(0.1, 0.09), (-0.2, -0.09)]):
        arm[foot] = np.column_stack([X + x, Y + y, np.full(POINTS, -0.88)])
    arm += rng.normal(scale=0.01, size=arm.shape)
    return arm, np.concatenate([np.ones(POINTS), np.repeat(rng.uniform(0.0, 1.0, 3), 2)])


def made(tolerance=1e-10):
    """Workspace and QP of a controller."""
    solver = SolverParameters(tolerance=tolerance, max_iterations=20_000)
    run = RunParameters(controller=ControllerParameters(friction=FRICTION), solver=solver)
    controller = TrackingController(walk_of(COARSE).robot, run)
    return controller.workspace, controller.contact_qp


def stand(work, arm, opening):
    """Give points their shares; net wrench per unknown, shape (6, U)."""
    work.body.points["arm"], work.body.points["limit"] = arm.reshape(-1, 3), opening
    share_forces(work.body.points, np.zeros(FORCES), False)
    wrench_map(work.body.points, work.contact.wrench_map)
    return work.contact.wrench_map


def fill(work, momentum, forces=NONE):
    """Fill in the QP, with curvature and gradient of the posture's cost over the vertical moment."""
    work.contact.forces[:], work.contact.wrench[:], work.wanted.right_load[0] = forces, momentum, 0.4
    work.tasks.system[L_Z, 20 + L_Z], work.tasks.system[L_Z, 26] = 0.2, -0.03
    fill_qp(refer(work))


@pytest.mark.parametrize("seed", SEEDS)
def test_wanted_wrench_is_given_where_it_can_be(seed):
    """That of the last tick's forces, shared as planned: hardly any slack, but for the light yaw."""
    rng, (arm, opening), (work, qp) = np.random.default_rng(seed), stance(seed), made()
    wrench, share = stand(work, arm, opening), np.maximum(opening.reshape(2, POINTS)[:, :4], 1e-3)
    phi = np.zeros((2, FOOT))
    phi[:, :4] = np.array([[0.6], [0.4]]) * share / share.sum(axis=1, keepdims=True)
    phi[:, 6:8] = 0.02 * rng.normal(size=(2, 2))
    wanted = wrench @ phi.ravel()
    fill(work, wanted, phi.ravel())
    solution = qp.solver.solve()
    assert solution.solved
    got = wrench @ solution.x[:FORCES]
    np.testing.assert_allclose(got[:5], wanted[:5], atol=5e-4)
    np.testing.assert_allclose(got - MOMENTUM_SLACK * solution.x[FORCES:], wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_forces_stay_within_friction_and_ramps_whatever_is_asked(seed):
    rng, (arm, opening) = np.random.default_rng(100 + seed), stance(seed)
    (work, qp), slack = made(1e-6), 1e-5
    stand(work, arm, opening)
    for _ in range(5):
        fill(work, UPRIGHT + rng.normal(size=6))
        solution = qp.solver.solve()
        assert solution.solved
        for foot, phi in enumerate(solution.x[:FORCES].reshape(2, FOOT)):
            normal, total = phi[:POINTS], phi[:POINTS].sum()
            ramp = opening[POINTS * foot : POINTS * (foot + 1)]
            assert (normal >= LEAST_NORMAL * ramp - slack).all()
            assert (normal <= np.maximum(LARGEST_NORMAL, LEAST_NORMAL) * ramp + slack).all()
            assert np.hypot(*phi[6:8]) <= np.abs(phi[6:8]).sum() <= FRICTION * total + slack
            share = np.maximum(ramp, 1e-3) / np.maximum(ramp, 1e-3).sum()
            lever = np.linalg.norm(arm[foot, :, :2] - share @ arm[foot, :, :2], axis=1)
            assert abs(phi[8]) * TWIST_ARM <= TWIST_SHARE * FRICTION * normal @ lever + slack

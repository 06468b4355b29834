"""The QP of one instant against dense references, and the integration of one step."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.orbit import COARSE_STEP
from ampm.body.step_reference import step_grid, step_reference
from tests.solved import COARSE, motion_of, walk_of

NODES = (0, 40, 90, 120, 150)


@pytest.fixture(scope="module", params=["free", "zero"])
def solved(request):
    """Inverse kinematics, reference and periodic step of one gait, with L_z free and held at zero."""
    settings = (f"body.angular_momentum_z={request.param}", "gait.c_y=0.7", COARSE)
    run, plan, robot = walk_of(*settings)
    motion = motion_of(*settings)
    return InverseKinematics(robot, run), step_reference(plan, motion.time), motion


def posture(ik, q, v):
    """-k (q - q0) - d qd, written down anew (Eq. 12 with the sign that holds the body upright)."""
    robot, k, d = ik.robot, ik.body.stiffness, ik.body.damping
    wanted = -d * v
    wanted[:3] = 0.0
    wanted[3:6] -= k * pin.log3(pin.Quaternion(q[3:7]).toRotationMatrix())
    wanted[6:] -= k * (q[7:] - ik.rest)
    for leg in robot.leg_joints:
        wanted[leg] = 0.0
    return wanted


def task(ik, reference, k, q, v):
    """Jacobian and right-hand side of the constraints at a node."""
    jacobian = ik.robot.jacobian(q).jacobian.copy()
    rows = ik.body.rows
    return jacobian[rows], (reference.acceleration[k] - ik.robot.drift(q, v))[rows]


@pytest.mark.parametrize("node", NODES)
def test_acceleration_meets_the_constraints_and_is_the_minimiser(solved, node):
    """Against the KKT system solved dense: [W J'; J 0] [qdd; multiplier] = [W posture; wanted]."""
    ik, reference, motion = solved
    q, v = motion.q[node], motion.v[node]
    jacobian, wanted = task(ik, reference, node, q, v)
    np.testing.assert_allclose(jacobian @ motion.acceleration[node], wanted, rtol=0.0, atol=1e-9)
    m, n = jacobian.shape
    weight = ik.body.weight
    kkt = np.block([[np.diag(weight), jacobian.T], [jacobian, np.zeros((m, m))]])
    right = np.concatenate([weight * posture(ik, q, v), wanted])
    exact = np.linalg.solve(kkt, right)[:n]
    np.testing.assert_allclose(motion.acceleration[node], exact, atol=1e-8 * np.abs(exact).max())


# ------------------------------------------------------------- states and steps


def task_errors(ik, reference, k, q, v):
    """Errors of the position tasks and of all task velocities, recomputed from frames."""
    robot = ik.robot
    terms = robot.jacobian(q)
    velocity = terms.jacobian @ v - reference.velocity[k]
    position = [
        terms.com - reference.position[k, 0],
        q[robot.toe_joints + 1] - reference.toe[k],
    ]
    for foot in (0, 1):
        position.append(terms.sole[foot] - reference.position[k, 1 + foot])
        position.append(pin.log3(terms.sole_turn[foot] @ reference.rotation[k, foot].T))
    return np.abs(np.concatenate(position)).max(), np.abs(velocity[ik.body.rows]).max()


def test_projection_meets_all_constraints_and_leaves_alone_what_does(solved):
    ik, reference, motion = solved
    reference = reference.with_angular_momentum_y(motion.report.angular_momentum_y_offset / ik.robot.mass)
    q, v = ik.project(reference, 0, motion.q[0], motion.v[0])
    np.testing.assert_allclose(q, motion.q[0], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(v, motion.v[0], rtol=0.0, atol=1e-10)
    rng = np.random.default_rng(0)
    for node in NODES:
        q = pin.integrate(ik.robot.model, motion.q[node], 0.05 * rng.normal(size=ik.robot.nv))
        q, v = ik.project(reference, node, q, motion.v[node] + rng.normal(size=ik.robot.nv))
        position, velocity = task_errors(ik, reference, node, q, v)
        assert position < 1e-11
        assert velocity < 1e-11


def test_second_order_in_the_grid():
    """The end of a step from one start: the error falls by four when the grid is halved."""
    run, plan, robot = walk_of()
    ik, motion = InverseKinematics(robot, run), motion_of()
    offset = motion.report.angular_momentum_y_offset / robot.mass
    grids = [step_reference(plan, step_grid(plan, h)) for h in (0.008, 0.004, 0.002)]
    ends = [
        ik.integrate(grid.with_angular_momentum_y(offset), motion.q[0], motion.v[0]).q[-1] for grid in grids
    ]
    first, second = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert 2.5 < first / second < 6.0


def test_unreachable_says_when_and_what(solved):
    ik, reference, motion = solved
    high = reference.lowered(-0.3)
    with pytest.raises(Unreachable, match=r"(left|right) leg") as caught:
        ik.project(high, NODES[1], motion.q[NODES[1]], motion.v[NODES[1]])
    assert caught.value.time == pytest.approx(reference.time[NODES[1]])
    assert caught.value.value > 0.01
    assert caught.value.unit == "m"
    with pytest.raises(Unreachable, match="leg"):
        ik.integrate(reference.lowered(-0.06), motion.q[0], motion.v[0])


def test_grid_has_a_node_on_every_switch():
    _, plan, _ = walk_of()
    single, step = plan.constants.single_support_duration, plan.constants.step_duration
    for largest in (0.05, 0.002, single / 7.0):
        grid = step_grid(plan, largest)
        assert grid[0] == 0.0
        assert grid[-1] == pytest.approx(step, abs=1e-15)
        assert np.abs(grid - single).min() < 1e-15
        switch = int(np.abs(grid - single).argmin())
        for part in (np.diff(grid[: switch + 1]), np.diff(grid[switch:])):
            assert part.max() <= largest * (1 + 1e-9)
            np.testing.assert_allclose(part, part[0], rtol=1e-9)
    assert len(step_grid(plan, 1.0)) == 5  # never fewer than two intervals in a phase
    assert walk_of().run.solver.ik_time_step < COARSE_STEP


def test_reference_holds_the_plan_and_its_derivatives():
    _, plan, _ = walk_of("gait.c_y=0.7")
    time = np.linspace(0.003, plan.constants.single_support_duration - 0.003, 50)
    h = 1e-6
    low, here, high = (step_reference(plan, time + s) for s in (-h, 0.0, h))
    rate = (high.position - low.position).reshape(len(time), 9) / (2 * h)
    velocity = here.velocity[:, [0, 1, 2, 6, 7, 8, 12, 13, 14]]
    np.testing.assert_allclose(rate, velocity, atol=1e-6)
    np.testing.assert_allclose((high.velocity - low.velocity) / (2 * h), here.acceleration, atol=1e-3)
    turn = (high.rotation - low.rotation) / (2 * h) @ here.rotation.swapaxes(-1, -2)
    np.testing.assert_allclose(here.velocity[:, [10, 16]], turn[..., 0, 2], atol=1e-6)
    lower = here.lowered(0.03)
    np.testing.assert_allclose(here.position[:, 0, 2] - lower.position[:, 0, 2], 0.03, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(lower.position[:, 1:], here.position[:, 1:])

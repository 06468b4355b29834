"""The QP of one instant against dense references, and the integration of one step."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.step_reference import step_grid, step_reference
from tests.solved import COARSE, motion_of, walk_of

PELVIS = ("body.pelvis_list=0.1", "body.pelvis_rotation=0.15")


@pytest.fixture(scope="module", params=[("free",), ("zero",), ("free", *PELVIS)])
def solved(request):
    """Inverse kinematics, reference and step of a gait: L_z free, held at zero, a pelvis that moves."""
    momentum, *pelvis = request.param
    settings = (f"body.angular_momentum_z={momentum}", "gait.c_y=0.7", *pelvis, COARSE)
    run, plan, robot = walk_of(*settings)
    motion = motion_of(*settings)
    return InverseKinematics(robot, run), step_reference(plan, motion.time), motion


def posture(ik, q, v, phase, rate):
    """-k (q - q0) - d qd, written down anew (Eq. 12 with the sign that holds the body upright)."""
    robot, k, d = ik.robot, ik.body.stiffness, ik.body.damping
    wanted = -d * v
    wanted[:3] = 0.0
    wanted[3:6] -= k * pin.log3(pin.Quaternion(q[3:7]).toRotationMatrix())
    rest = np.exp(1j * phase) * np.array([-1j * ik.pelvis[0], 0.0, -ik.pelvis[1]])
    wanted[3:6] += np.real(k * rest + d * 1j * rate * rest - rate**2 * rest)
    wanted[6:] -= k * (q[7:] - ik.rest)
    for leg in robot.leg_joints:
        wanted[leg] = 0.0
    return wanted


@pytest.mark.parametrize("node", [0, 40, 90, 120, 150])
def test_acceleration_meets_the_constraints_and_is_the_minimiser(solved, node):
    """Against the KKT system solved dense: [W J'; J 0] [qdd; multiplier] = [W posture; wanted]."""
    ik, reference, motion = solved
    q, v = motion.q[node], motion.v[node]
    jacobian = ik.robot.jacobian(q).jacobian[ik.body.rows]
    wanted = (reference.acceleration[node] - ik.robot.drift(q, v))[ik.body.rows]
    np.testing.assert_allclose(jacobian @ motion.acceleration[node], wanted, rtol=0.0, atol=1e-9)
    m, n = jacobian.shape
    weight = ik.body.weight
    kkt = np.block([[np.diag(weight), jacobian.T], [jacobian, np.zeros((m, m))]])
    rate = np.pi / motion.time[-1]
    right = np.concatenate([weight * posture(ik, q, v, rate * motion.time[node], rate), wanted])
    exact = np.linalg.solve(kkt, right)[:n]
    np.testing.assert_allclose(motion.acceleration[node], exact, atol=1e-8 * np.abs(exact).max())


def test_second_order_in_the_grid():
    """The end of a step from one start: the error falls by four when the grid is halved."""
    run, plan, robot = walk_of()
    ik, motion = InverseKinematics(robot, run), motion_of()
    offset = motion.report.angular_momentum_y_offset / robot.mass
    grids = [step_reference(plan, step_grid(plan, h)) for h in (0.008, 0.004, 0.002)]
    ends = [ik.integrate(g.with_angular_momentum_y(offset), motion.q[0], motion.v[0]).q[-1] for g in grids]
    first, second = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert 2.5 < first / second < 6.0

"""The periodic step: does it return, how unstable it is; its instants against dense references."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
import pytest

from ampm.body import orbit
from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.step_reference import step_grid, step_reference
from ampm.exceptions import BodilyRefusal
from tests.solved import COARSE, motion_of, walk_of
from validation.trial.plan import load_request, plan_walk


@pytest.fixture(params=["", "gait.c_y=0.4", "body.lean=0.05", "body.angular_momentum_z=zero"])
def settings(request):
    return (COARSE, *request.param.split())


def test_step_ends_where_its_mirror_image_begins(settings):
    robot, motion = walk_of(*settings).robot, motion_of(*settings)
    end = robot.mirror_q(motion.q[-1], -motion.step_length)
    np.testing.assert_allclose(pin.difference(robot.model, motion.q[0], end), 0.0, atol=1e-8)
    np.testing.assert_allclose(robot.mirror_v(motion.v[-1]), motion.v[0], atol=1e-8)
    assert motion.report.residual <= 1e-8


def test_mean_trunk_pitch_is_the_lean(settings):
    run, _, robot = walk_of(*settings)
    motion = motion_of(*settings)
    trunk = robot.trunk_rotations(motion.q)
    pitch = np.arctan2(trunk[:, 0, 2], trunk[:, 2, 2])
    np.testing.assert_allclose(pitch, motion.trunk_pitch, rtol=0.0, atol=1e-12)
    mean = np.trapezoid(pitch, motion.time) / motion.step_duration
    assert mean == pytest.approx(run.body.lean, abs=1e-8)
    assert motion.report.mean_trunk_pitch == pytest.approx(mean, abs=1e-12)


def test_body_moves_as_planned_with_the_constant_of_l_y(settings):
    """COM, both horizontal angular momenta and soles, by Pinocchio alone; tiled over three steps."""
    _, plan, robot = walk_of(*settings)
    motion = motion_of(*settings)
    nodes = motion.time[:-1:20]
    times = np.concatenate([nodes + k * motion.step_duration for k in range(3)])
    body, planned = motion.sample(times, robot), plan.sample(times)
    feet = plan.feet.sample(times)
    data = robot.model.createData()
    constant = np.array([0.0, motion.report.angular_momentum_y_offset])
    for k in range(len(times)):
        momentum = pin.computeCentroidalMomentum(robot.model, data, body.q[k], body.v[k])
        np.testing.assert_allclose(data.com[0], planned.com[k], atol=1e-7)
        np.testing.assert_allclose(momentum.linear / robot.mass, planned.com_velocity[k], atol=1e-6)
        wanted = planned.angular_momentum[k] + constant
        np.testing.assert_allclose(momentum.angular[:2], wanted, atol=1e-5)
        assert momentum.angular[2] == pytest.approx(body.angular_momentum_z[k], abs=1e-6)
        pin.updateFramePlacements(robot.model, data)
        for foot in (0, 1):
            sole = data.oMf[robot.sole_frames[foot]]
            np.testing.assert_allclose(sole.translation, feet[foot].position[k], atol=1e-7)
            turned = pin.utils.rotate("y", feet[foot].pitch[k])
            np.testing.assert_allclose(sole.rotation, turned, atol=1e-6)
            toe = body.q[k, robot.toe_joints[foot] + 1]
            assert toe == pytest.approx(feet[foot].toe[k], abs=1e-7)


def test_multipliers_are_eigenvalues_of_the_return_map():
    """Against the full Jacobian of the map by differences: few modes are slow, all others die in a step."""
    settings, slow = ("solver.ik_time_step=0.01", "body.angular_momentum_z=zero"), 3
    run, plan, robot = walk_of(*settings)
    motion = motion_of(*settings)
    ik = orbit.InverseKinematics(robot, run)
    offset, nv, h = motion.report.angular_momentum_y_offset, robot.nv, 1e-6
    reference = step_reference(plan, motion.time).with_angular_momentum((0.0, offset / robot.mass))

    def returned(dq, dv):
        q = pin.integrate(robot.model, motion.q[0], dq)
        end = ik.integrate(reference, q, motion.v[0] + dv)
        q = robot.mirror_q(end.q[-1], -motion.step_length)
        return np.concatenate([pin.difference(robot.model, motion.q[0], q), robot.mirror_v(end.v[-1])])

    zero = np.zeros(nv)
    jacobian = np.empty((2 * nv, 2 * nv))
    for i, e in enumerate(np.eye(nv)):
        jacobian[:, i] = (returned(h * e, zero) - returned(-h * e, zero)) / (2 * h)
        jacobian[:, nv + i] = (returned(zero, h * e) - returned(zero, -h * e)) / (2 * h)
    exact = np.linalg.eigvals(jacobian)
    exact = exact[np.argsort(-np.abs(exact))]
    reported = [complex(*x) for x in motion.report.multipliers]
    assert len(reported) == slow
    np.testing.assert_allclose(reported, exact[:slow], atol=2e-4)
    assert np.abs(exact[slow:]).max() < 0.05
    assert reported[0].real > 1.0  # why a walk is tiled, never integrated on
    assert reported[1].real < -0.9


def test_out_of_reach_names_the_instant_and_a_height_that_works():
    with pytest.raises(BodilyRefusal, match=r"(left|right)") as caught:
        motion_of(COARSE, "gait.com_height=0.94")
    refusal = caught.value
    assert (refusal.reason, refusal.value) == ("no_periodic_motion", 0.94)
    assert 0.8 < refusal.limit < 0.94
    assert "lower gait.com_height" in str(refusal)
    lower = motion_of(COARSE, f"gait.com_height={refusal.limit}")
    assert lower.report.residual <= 1e-8


def test_velocity_is_the_rate_of_the_configuration():
    motion, robot = motion_of(COARSE), walk_of(COARSE).robot
    times, h = np.linspace(0.01, 2.5, 300), 1e-6
    low, here, high = (motion.sample(times + s, robot) for s in (-h, 0.0, h))
    np.testing.assert_allclose(np.linalg.norm(here.q[:, 3:7], axis=1), 1.0, rtol=0.0, atol=1e-14)
    for k in range(len(times)):
        rate = pin.difference(robot.model, low.q[k], high.q[k]) / (2 * h)
        np.testing.assert_allclose(rate, here.v[k], atol=2e-3 * np.abs(here.v[k]).max())


def test_its_arrays_cannot_be_changed():
    motion = motion_of(COARSE)
    held = [value for value in vars(motion).values() if isinstance(value, np.ndarray)]
    assert not any(array.flags.writeable for array in (*held, *motion.sample([0.1], walk_of(COARSE).robot)))


def test_plan_writes_one_step_of_every_joint(ampm, tmp_path):
    path = tmp_path / "step.parquet"
    answer = ampm("plan", "flat", "--motion", path)
    assert answer.status == 0, answer.err
    motion = plan_walk(load_request("flat")).motion
    written = pq.read_table(path)
    assert written.column_names == [*motion.table()]
    for name, values in motion.table().items():
        np.testing.assert_array_equal(written[name].to_numpy(), values)


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
    rest = np.exp(1j * phase) * np.array([-1j * ik.body.pelvis[0], 0.0, -ik.body.pelvis[1]])
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
    offset = (0.0, motion.report.angular_momentum_y_offset / robot.mass)
    grids = [step_reference(plan, step_grid(plan, h)) for h in (0.008, 0.004, 0.002)]
    ends = [ik.integrate(g.with_angular_momentum(offset), motion.q[0], motion.v[0]).q[-1] for g in grids]
    first, second = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert 2.5 < first / second < 6.0

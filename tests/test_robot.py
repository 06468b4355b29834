"""Poses; the mirror map against what a mirror must keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.robot import Robot
from ampm.exceptions import InputError
from tests.solved import walk_of

SEEDS = range(4)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return walk_of().robot


def state(robot, seed):
    """A random posture and velocity of the whole body, its root turned any way."""
    rng = np.random.default_rng(seed)
    tangent = rng.normal(size=robot.nv) * 0.5
    q = pin.integrate(robot.model, pin.neutral(robot.model), tangent)
    return q, rng.normal(size=robot.nv)


def task_position(robot, q):
    """COM, soles and toe joints; rotations as matrices."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    com = pin.centerOfMass(robot.model, data, q)
    return com.copy(), [data.oMf[f].copy() for f in robot.sole_frames], q[robot.toe_joints + 1]


def test_poses_are_those_of_the_frames(robot):
    q, _ = state(robot, 2)
    terms = robot.jacobian(q)
    robot.jacobian(state(robot, 3)[0])  # which must not write into the first
    com, soles, _ = task_position(robot, q)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    np.testing.assert_allclose(terms.com, com, rtol=0.0, atol=1e-12)
    for sole, turn, expected in zip(terms.sole, terms.sole_turn, soles, strict=True):
        np.testing.assert_allclose(sole, expected.translation, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(turn, expected.rotation, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(terms.trunk, data.oMf[robot.trunk_frame].rotation, rtol=0.0, atol=1e-12)


def test_groups_of_joints_cover_every_hinge_once(robot):
    groups = [*robot.leg_joints, robot.trunk_joints, robot.arm_joints]
    assert sorted(np.concatenate(groups)) == list(range(6, robot.nv))
    assert len(robot.joint_names) == robot.nu == 34
    assert (robot.upper > robot.lower).all()
    assert (robot.torque_limit > 0.0).all()
    assert robot.mass == pytest.approx(60.0)
    assert robot.gravity == pytest.approx(9.81)


@pytest.mark.parametrize("seed", SEEDS)
def test_mirrored_body_has_the_same_mass_matrix(robot, seed):
    q, _ = state(robot, seed)
    mirror = np.stack([robot.mirror_v(e) for e in np.eye(robot.nv)], axis=1)

    def mass(configuration):
        m = pin.crba(robot.model, robot.model.createData(), configuration)
        return np.triu(m) + np.triu(m, 1).T

    reflected = mass(robot.mirror_q(q, 0.6))
    np.testing.assert_allclose(mirror.T @ reflected @ mirror, mass(q), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_mirrored_momentum_is_the_momentum_mirrored(robot, seed):
    """Linear momentum is a vector, angular momentum an axial one; the feet change places."""
    q, v = state(robot, seed)
    plain = (robot.jacobian(q).jacobian @ v).copy()
    com = task_position(robot, q)[0]
    mirrored_q = robot.mirror_q(q, 0.6)
    seen = robot.jacobian(mirrored_q).jacobian @ robot.mirror_v(v)
    vector, axial = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
    wanted = np.concatenate(
        [
            plain[0:3] * vector,
            plain[3:6] * axial,
            plain[12:15] * vector,
            plain[15:18] * axial,
            plain[6:9] * vector,
            plain[9:12] * axial,
            plain[[19, 18]],
        ]
    )
    np.testing.assert_allclose(seen, wanted, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        task_position(robot, mirrored_q)[0], com * vector + [0.6, 0, 0], rtol=0.0, atol=1e-12
    )


def test_names_that_the_model_lacks_are_refused(robot):
    legs = robot.description.left_leg
    for change in ({"knee": "no_such_knee"}, {"sole_frame": "no_such_sole"}):
        wrong = replace(robot.description, left_leg=replace(legs, **change))
        with pytest.raises(InputError, match=next(iter(change.values()))):
            Robot(robot.model, wrong, robot.shapes)

"""Rotations, mirror images and linear systems; kinematics and torques are held to Pinocchio in test_tick."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.rigid_body import RigidBody, moved
from ampm.body.robot import Robot
from ampm.exceptions import InputError
from ampm.linear import substitute, triangular
from ampm.vectors import rotation_vector
from tests.solved import walk_of


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.1e-4, 0.1, 3.0])
def test_a_configuration_moves_as_pinocchios(robot, size):
    q, change = state(robot, 0)
    expected = pin.integrate(robot.model, q, size * change)
    np.testing.assert_allclose(moved(q, size * change), expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, 2.9])
def test_rotation_vector_is_the_logarithm(angle):
    rng = np.random.default_rng(0)
    turn, axis = pin.exp3(rng.normal(size=3)), rng.normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(rotation_vector(pin.exp3(vector) @ turn, turn), vector, rtol=0.0, atol=1e-14)


def test_symmetric_systems_are_solved_and_others_refused():
    rng = np.random.default_rng(0)
    root, right = rng.normal(size=(7, 9)), rng.normal(size=(7, 3))
    matrix = root @ root.T
    system = np.hstack([matrix, right])
    assert triangular(system)
    substitute(system)
    np.testing.assert_allclose(system[:, 7:], np.linalg.solve(matrix, right), rtol=0.0, atol=1e-12)
    for wrong in (-np.eye(2), np.ones((2, 2)), np.full((2, 2), np.nan)):
        assert not triangular(np.hstack([wrong, np.ones((2, 1))]))


@pytest.mark.parametrize("first", [True, False])
def test_other_joints_are_refused(first):
    model = pin.Model()
    kinds = (
        [pin.JointModelPX(), pin.JointModelRX()] if first else [pin.JointModelFreeFlyer(), pin.JointModelPX()]
    )
    for kind in kinds:
        model.addJoint(model.njoints - 1, kind, pin.SE3.Identity(), f"joint {model.njoints}")
    with pytest.raises(InputError, match=f"joint {1 if first else 2}.*free root"):
        RigidBody(model, [], 0, np.arange(0))


# -------------------------------------- Groups of joints; the mirror map against what a mirror must keep


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


@pytest.mark.parametrize("seed", SEEDS)
def test_mirrored_momentum_is_the_momentum_mirrored(robot, seed):
    """Linear momentum is a vector, angular momentum an axial one; the feet change places."""
    q, v = state(robot, seed)
    here, image = robot.jacobian(q), robot.jacobian(robot.mirror_q(q, 0.6))
    plain, seen = here.jacobian @ v, image.jacobian @ robot.mirror_v(v)
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
    np.testing.assert_allclose(image.com, here.com * vector + [0.6, 0, 0], rtol=0.0, atol=1e-12)


def test_names_that_the_model_lacks_are_refused(robot):
    legs = robot.description.left_leg
    for change in ({"knee": "no_such_knee"}, {"sole_frame": "no_such_sole"}):
        wrong = replace(robot.description, left_leg=replace(legs, **change))
        with pytest.raises(InputError, match=next(iter(change.values()))):
            Robot(robot.model, wrong, robot.shapes)

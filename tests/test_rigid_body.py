"""Steps of a configuration and linear systems; test_tick holds the rest to Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.articulated import respond
from ampm.body.rigid_body import moved
from ampm.body.robot import Robot
from ampm.linear import substitute, triangular
from tests.solved import walk_of


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.1e-4, 0.1, 3.0])
def test_a_configuration_moves_as_pinocchios(robot, size):
    q, change = state(robot, 0)
    expected = pin.integrate(robot.model, q, size * change)
    np.testing.assert_allclose(moved(q, size * change), expected, rtol=0.0, atol=1e-12)


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


@pytest.fixture(scope="module")
def robot() -> Robot:
    return walk_of().robot


def state(robot, seed):
    """A random posture and velocity of the whole body, its root turned any way."""
    rng = np.random.default_rng(seed)
    tangent = rng.normal(size=robot.nv) * 0.5
    q = pin.integrate(robot.model, pin.neutral(robot.model), tangent)
    return q, rng.normal(size=robot.nv)


def test_hinges_respond_to_the_root_as_the_mass_matrix_says(robot):
    q, v = state(robot, 5)
    body = robot.rigid_body
    body.place(q)
    turn = body.link["turn"][0]
    rate = respond(body.tree, body.armature, body.link, tuple(turn @ v[:3]), tuple(turn @ v[3:6]))
    matrix = pin.crba(robot.model, robot.model.createData(), q)
    matrix = np.triu(matrix) + np.triu(matrix, 1).T
    np.testing.assert_allclose(matrix[6:, 6:] @ rate + matrix[6:, :6] @ v[:6], 0.0, atol=1e-9)

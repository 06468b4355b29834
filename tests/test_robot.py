"""Groups of joints; the mirror map against what a mirror must keep."""

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

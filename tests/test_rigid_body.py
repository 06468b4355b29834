"""Kinematics, momentum and torques of random trees against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.rigid_body import RigidBody, frames_of, joint_torques, moved
from ampm.exceptions import InputError
from ampm.linear import substitute, triangular
from ampm.vectors import rotation_vector

ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
FEET, POINTS, HINGES = 3, 5, 14
TREES = range(6)


class Tree:
    """A random body with hinges about any axis, massless links and rotated placements, and its state."""

    def __init__(self, seed, toes):
        self.rng = rng = np.random.default_rng(seed)
        pin.seed(seed)
        model = pin.Model()
        model.gravity = pin.Motion(np.array([0.0, 0.0, -9.81]), np.zeros(3))
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
        model.appendBodyToJoint(root, pin.Inertia.Random(), pin.SE3.Random())
        for i in range(HINGES):
            axis = rng.normal(size=3)
            unaligned = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
            kind = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ(), unaligned)[i % 4]
            parent = int(rng.integers(1, model.njoints))
            joint = model.addJoint(parent, kind, pin.SE3.Random(), f"hinge {i}")
            if rng.random() < 0.7:
                model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
        model.armature = np.concatenate([np.zeros(6), rng.uniform(size=HINGES)])
        frames = [
            model.addFrame(
                pin.Frame(f"{i}", int(rng.integers(1, model.njoints)), 0, pin.SE3.Random(), pin.OP_FRAME)
            )
            for i in range(FEET + 1 + POINTS)
        ]
        self.model, self.data, self.mass = model, model.createData(), pin.computeTotalMass(model)
        self.soles, self.trunk, self.points = frames[:FEET], frames[FEET], frames[FEET + 1 :]
        self.toes = np.arange(6, 6 + toes)
        self.body = RigidBody(model, self.soles, self.trunk, self.toes)
        self.q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
        self.v, self.now, self.acceleration = rng.normal(size=(3, model.nv))
        self.body.place(self.q)
        pin.ccrba(model, self.data, self.q, self.v)
        pin.updateFramePlacements(model, self.data)

    def frame_jacobian(self, frame):
        return pin.getFrameJacobian(self.model, self.data, frame, ALIGNED)


@pytest.fixture(params=[(seed, seed % 3) for seed in TREES], ids=lambda of: f"tree {of[0]}, {of[1]} toes")
def tree(request):
    return Tree(*request.param)


def close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-12 * max(1.0, np.abs(expected).max()))


def test_places_are_pinocchios(tree):
    close(tree.q[:3] + tree.body.com, pin.centerOfMass(tree.model, tree.data, tree.q))
    for frames, numbers in ((tree.body.soles, tree.soles), (tree.body.trunk, [tree.trunk])):
        for place, turn, number in zip(*tree.body.places(frames), numbers, strict=True):
            close(tree.q[:3] + place, tree.data.oMf[number].translation)
            close(turn, tree.data.oMf[number].rotation)


def test_task_jacobian_is_pinocchios(tree):
    rows = [tree.data.Ag / tree.mass, *[tree.frame_jacobian(sole) for sole in tree.soles]]
    close(tree.body.columns.T, np.vstack([*rows, np.eye(tree.model.nv)[tree.toes]]))


def test_drift_is_pinocchios(tree):
    """That of the momentum at one velocity, that of the feet at another."""
    model, data, still = tree.model, tree.data, np.zeros(tree.model.nv)
    pin.computeCentroidalMomentumTimeVariation(model, data, tree.q, tree.v, still)
    rows = [data.dhg.vector / tree.mass]
    pin.forwardKinematics(model, data, tree.q, tree.now, still)
    rows += [pin.getFrameClassicalAcceleration(model, data, sole, ALIGNED).vector for sole in tree.soles]
    close(tree.body.drift(tree.v, tree.now), np.concatenate([*rows, np.zeros(len(tree.toes))]))


def test_torques_are_pinocchios(tree):
    model, forces = tree.model, tree.rng.normal(size=(POINTS, 3))
    total = pin.rnea(model, tree.data, tree.q, tree.v, tree.acceleration)
    for point, force in zip(tree.points, forces, strict=True):
        total = total - tree.frame_jacobian(point)[:3].T @ force
    body, torque, points = tree.body, np.empty(HINGES), frames_of(model, tree.points)
    state = tree.v, tree.acceleration, 9.81
    joint_torques(body.tree, body.armature, body.link, *state, points, forces, torque)
    close(torque, total[6:])


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.1e-4, 0.1, 3.0])
def test_a_configuration_moves_as_pinocchios(tree, size):
    change = size * tree.rng.normal(size=tree.model.nv)
    close(moved(tree.q, change), pin.integrate(tree.model, tree.q, change))


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

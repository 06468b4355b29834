"""The compiled steps of a control tick against Pinocchio and dense algebra, at random ticks of two bodies.

Formulas of the control law are held by the walks of ``golden.csv``; gate, hold and the trunk's feedback have
tests of their own.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from numba.core import config

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.compiled import refer
from ampm.control.controller import TrackingController
from ampm.control.tick import keep_tick, prepare_qp, take_forces
from ampm.control.workspace import ANGULAR, Workspace, gains_of
from ampm.parameters import BodyParameters, RunParameters
from validation.trial.plan import make_body

TICKS = 12 if config.DISABLE_JIT else 120
ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
SCALE = np.array([1.0, 1.0, 1.0, ANGULAR, ANGULAR, ANGULAR])


def frames(robot, q, numbers):
    """Places (k, 3) and rotations (k, 3, 3) of frames."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return [np.array([getattr(data.oMf[k], part) for k in numbers]) for part in ("translation", "rotation")]


def frame_jacobians(robot, q, numbers):
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    return [pin.getFrameJacobian(robot.model, data, number, ALIGNED) for number in numbers]


def task_jacobian(robot, q):
    """Momentum over the mass, soles, toes: shape (R, nv)."""
    momentum = pin.computeCentroidalMap(robot.model, robot.model.createData(), q) / robot.mass
    soles, toes = frame_jacobians(robot, q, robot.sole_frames), np.eye(robot.nv)[robot.toe_joints]
    return np.vstack([momentum, *soles, toes])


def drift(robot, q, v, now):
    """Rates of momentum (at v) and soles (at ``now``) without accelerations of the coordinates."""
    model, data, still = robot.model, robot.model.createData(), np.zeros(robot.nv)
    momentum = pin.computeCentroidalMomentumTimeVariation(model, data, q, v, still).vector / robot.mass
    pin.forwardKinematics(model, data, q, now, still)
    soles = [pin.getFrameClassicalAcceleration(model, data, f, ALIGNED).vector for f in robot.sole_frames]
    return np.concatenate([momentum, *soles, np.zeros(len(robot.toe_joints))])


def inverse_dynamics(robot, q, v, acceleration, point_force):
    """``M qdd + h - sum J' f``: of the root, which nothing drives, and of the hinges, shape (nv,)."""
    total = pin.rnea(robot.model, robot.model.createData(), q, v, acceleration)
    for jacobian, force in zip(frame_jacobians(robot, q, robot.point_frames), point_force, strict=True):
        total = total - jacobian[:3].T @ force
    return total


class Tick(NamedTuple):
    """One tick: the workspace before and after it."""

    robot: Any
    old: Workspace
    c: Workspace


def copied(part):
    """A named tuple with copies of its arrays."""
    if isinstance(part, np.ndarray):
        return part.copy()
    return type(part)(*map(copied, part)) if isinstance(part, tuple) else part


def randomise(c, robot, rng, k):
    """State and reference near each other, contacts that last for some ticks, forces."""
    model, wanted, stepping = robot.model, c.wanted, c.stepping[0]
    for array in wanted:
        if array.dtype == float:
            array[...] = 0.3 * rng.normal(size=array.shape)
    q = pin.integrate(model, pin.neutral(model), 0.15 * rng.normal(size=robot.nv))
    inside = np.minimum(0.1, 0.4 * (robot.upper - robot.lower))
    q[7:] = np.clip(q[7:], robot.lower + inside, robot.upper - inside)
    q[2] += 0.9 * robot.description.scale
    c.sensed.q[:], c.sensed.v[:] = q, 0.3 * rng.normal(size=robot.nv)
    wanted.q[:] = pin.integrate(model, q, 0.05 * rng.normal(size=robot.nv))
    wanted.com[:] = pin.centerOfMass(model, robot.data, q) + 0.02 * rng.normal(size=3)
    places, turns = frames(robot, wanted.q, robot.sole_frames)
    wanted.foot_position[:], wanted.foot_rotation[:] = places, turns
    wanted.trunk[:] = frames(robot, wanted.q, [robot.trunk_frame])[1][0]
    wanted.right_load[:] = rng.choice([0.0, 0.3, 1.0])
    wanted.tilt_window[:] = 0.0 if k % 50 < 2 else rng.choice([0.02, 0.03]) if k < 100 else 9.0
    wanted.until_lift[:] = rng.choice([np.inf, 0.06, 0.02, 0.0], size=(2, 3), p=[0.7, 0.1, 0.1, 0.1])
    if k % 6 == 0:
        wanted.planned[:] = rng.random((2, 3)) < rng.choice([0.0, 0.6, 1.0], size=(2, 1))
        wanted.due[:] = wanted.planned | (rng.random((2, 3)) < rng.choice([0.0, 0.3], size=(2, 1)))
        c.sensed.contact[:] = rng.random(len(c.body.points)) < rng.choice([0.0, 0.2, 0.8])
        stepping["active"] = rng.random() < 0.7
        stepping["off_plan"] = stepping["active"] and rng.random() < 0.6
    heading = 0.3 * rng.normal()
    stepping["heading"] = np.cos(heading), np.sin(heading)
    stepping["floor_rise"], stepping["force_factor"] = 0.02 * rng.normal(), rng.choice([1.0, 1.05])
    c.sensed.contact[:] ^= rng.random(len(c.body.points)) < 0.05
    sensed = rng.uniform(0.0, 0.3, len(c.body.points)) * robot.mass * robot.gravity
    c.sensed.normal_force[:] = c.sensed.contact * sensed
    c.contact.solution[:] = rng.uniform(0.0, 0.2, len(c.contact.solution))
    c.joints.torque_limit[:] = robot.torque_limit * rng.choice([0.1, 1e3])
    for name in ("floor_rise", "slope", "raised", "raised_rate"):
        c.body.feet[name] = 0.0


@cache
def ticks(source, count=TICKS):
    """Random ticks of a body, one after another."""
    rng = np.random.default_rng(9)
    run = RunParameters(body=BodyParameters(source=source))
    robot = make_body(run).robot
    numbers = gains_of(run.controller)._asdict()
    chosen = {name: float(rng.uniform(0.7, 1.3) * value) for name, value in numbers.items()}
    gains = run.controller.model_copy(update=chosen)
    controller = TrackingController(robot, run.model_copy(update={"controller": gains}))
    c = controller.workspace
    handle, done = refer(c), []
    for k in range(count):
        randomise(c, robot, rng, k)
        c.wanted.jumps[0] = k % 9 == 0
        c.sensed.velocity_lag[0], c.sensed.force_age[0] = 0.0005 * (k % 2), 0.001
        old = copied(c)
        assert prepare_qp(handle, None, k == 0)
        take_forces(handle)
        keep_tick(handle, k == 0)
        done.append(Tick(robot, old, copied(c)))
    return done


@pytest.fixture(params=["human", "suite-humanoid"])
def walked(request):
    return ticks(request.param)


def close(actual, expected):
    """To 1e-9 of the largest number, or of one."""
    expected = np.asarray(expected)
    size = max(1.0, np.abs(expected[np.isfinite(expected)]).max(initial=0.0))
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-9 * size)


def test_kinematics(walked):
    for it in walked:
        q, c, robot = it.c.sensed.q, it.c, it.robot
        now = c.sensed.v + c.sensed.velocity_lag * it.old.motion.last_acceleration
        jacobian = task_jacobian(robot, q)
        close(c.motion.v, now)
        close(c.body.com, pin.centerOfMass(robot.model, robot.data, q))
        close(c.body.rigid.columns.T, jacobian)
        close(c.tasks.rates, jacobian @ now)
        close(c.tasks.drift, drift(robot, q, c.sensed.v, now))
        places, turns = frames(robot, q, robot.sole_frames)
        close(c.body.com + c.body.feet["place"], places)
        close(c.body.feet["rotation"], turns)
        close(c.body.com + c.body.points["arm"], frames(robot, q, robot.point_frames)[0])


def test_a_flat_foot_is_left_with_a_share_of_its_angular_acceleration_unless_its_contact_changes(walked):
    left = 0
    for it in walked:
        gains, lines = it.c.gains, it.c.contact.lines
        for i, (foot, old) in enumerate(zip(it.c.body.feet, it.old.body.feet, strict=True)):
            on = lines[i]["planned"] | lines[i]["touched"]
            if not (on[:2].all() and (on[2] or foot["toe"] < 0) and lines[i]["touched"][:2].all()):
                continue
            omega = it.c.tasks.rates[9 + 6 * i : 12 + 6 * i]
            last = it.old.contact.last[i]
            stood = (last["planned"] | last["touched"]).any()
            same = stood and np.array_equal(last["touching"], lines[i]["touching"])
            share = gains.stance_yield if same else 0.0
            actual = gains.frequency * (omega - old["last_omega"])
            tilting = np.array([1.0, 1.0, 0.0])  # not about the vertical
            wanted = share * tilting * actual - (1.0 - share * tilting) * gains.stance_damping * omega
            close(it.c.tasks.wanted[9 + 6 * i : 12 + 6 * i], wanted)
            left += share > 0.0
    assert left or config.DISABLE_JIT  # with fewer ticks


def test_elimination(walked):
    """Without the slacks: W (a - posture) = J' m and J a = rhs + (wrench, 0) + softness m, solved dense."""
    for it in walked:
        c, rows, weights = it.c, len(it.c.tasks.rhs), it.robot.by_group(POSTURE_WEIGHTS)
        jacobian, softness = task_jacobian(it.robot, c.sensed.q), np.diag(c.tasks.softness)
        jacobian[:6] *= SCALE[:, None]
        rhs = (c.tasks.wanted - c.tasks.drift) / it.robot.gravity
        rhs[:6] *= SCALE
        posture = c.tasks.posture / c.motion.sqrt_weight
        right = np.zeros((it.robot.nv + rows, 7))
        right[it.robot.nv : it.robot.nv + 6, :6] = np.eye(6)
        right[:, 6] = [*weights * posture, *rhs]
        exact = np.linalg.solve(np.block([[np.diag(weights), jacobian.T], [jacobian, -softness]]), right)
        close(c.tasks.system[:, rows:], -exact[it.robot.nv :])
        force = c.contact.point_force / (it.robot.mass * it.robot.gravity)
        wrench = [*force.sum(axis=0), *ANGULAR * np.cross(c.body.points["arm"], force).sum(axis=0)]
        close(c.contact.wrench_map @ c.contact.solution, wrench)
        close(c.motion.acceleration, it.robot.gravity * exact[: it.robot.nv] @ [*wrench, 1.0])


def test_torques_and_what_the_next_tick_reads(walked):
    for it in walked:
        c, weight, limit = it.c, it.robot.mass * it.robot.gravity, it.c.joints.torque_limit
        net = inverse_dynamics(it.robot, c.sensed.q, c.sensed.v, c.motion.acceleration, c.contact.point_force)
        assert np.abs(net[:6]).max() < 1e-8 * weight  # nothing but the floor drives the root
        close(c.joints.torque, np.clip(net[6:] + c.motion.passive_torque, -limit, limit))
        np.testing.assert_array_equal(c.joints.last_torque, c.joints.torque)
        np.testing.assert_array_equal(c.motion.last_acceleration, c.motion.acceleration)
        np.testing.assert_array_equal(c.contact.forces, c.contact.solution)

"""One control tick against the laws that it must keep: dynamics, contact, limits, and what is asked of it."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.robot import Robot
from ampm.control.controller import TrackingController
from ampm.control.limited_qp import acceleration_bounds, limit_broken
from ampm.control.workspace import Joints
from ampm.walk import LIMITED, UNSOLVED, State, Timing, Touch
from tests.solved import COARSE, planned_walk, walk_of
from tests.test_tick import frames, inverse_dynamics

INSTANTS = (0.2, 0.62, 0.66, 0.9)
"""Single support, both feet in the double support, the other single support [s]."""


@cache
def reference(time, row=0):
    """The reference of an instant of the walk, or of ticks after it."""
    return planned_walk().table(time + 0.002 * np.arange(200), Timing(early=0.04))[row]


def controller(*overrides, weaker=1.0):
    """A controller with a robot of its own."""
    robot, run = walk_of(COARSE).robot, walk_of(COARSE, *overrides).run
    model = robot.model.copy()
    model.effortLimit = weaker * np.array(model.effortLimit)
    return TrackingController(Robot(model, robot.description, robot.gaps), run)


def state(time, shift=0.0):
    """State of the motion at an instant, shifted at random [rad, m]."""
    planned, rng = reference(time), np.random.default_rng(0)
    q = pin.integrate(walk_of(COARSE).robot.model, planned.q, shift * rng.normal(size=40))
    return State(time, q, planned.v + 5.0 * shift * rng.normal(size=40))


def touch(time):
    """The sole points that are planned in contact."""
    robot = walk_of(COARSE).robot
    contact = reference(time).planned[robot.point_foot, robot.point_group]
    return Touch(contact, np.zeros(12))


def tick(time, *overrides, shift=0.0, weaker=1.0, tolerance=1e-9):
    """The first tick of a controller at an instant of the motion: controller, state, output."""
    it = controller(f"solver.tolerance={tolerance}", *overrides, weaker=weaker)
    now = state(time, shift)
    return it, now.q, now.v, it.update(now, touch(time), reference(time))


@pytest.mark.parametrize("time", INSTANTS)
def test_forces_give_what_is_asked_for_within_the_friction(time):
    it, q, _, first = tick(time, shift=0.002)
    for _ in range(20):  # the first tick knows no forces that the next one would keep
        output = it.update(state(time, 0.002), touch(time), reference(time))
    assert not any(map(np.shares_memory, first[:5], output[:5]))  # a caller may keep both
    force = output.point_force
    com = pin.centerOfMass(it.robot.model, it.robot.model.createData(), q)
    np.testing.assert_allclose(force.sum(axis=0), output.force, atol=0.3)  # what the slacks give away
    feet = force.reshape(2, 6, 3).sum(axis=1)
    friction = walk_of(COARSE).run.controller.friction
    assert (np.linalg.norm(feet[:, :2], axis=1) <= friction * feet[:, 2] + 1e-6).all()
    assert (force[:, 2] >= -1e-9).all()
    position = frames(it.robot, q, it.robot.point_frames)[0]
    zmp = (position[:, :2] * force[:, 2:]).sum(axis=0) / force[:, 2].sum()
    moment = np.cross(position - com, force).sum(axis=0)
    assert zmp == pytest.approx(output.zmp, abs=1e-3)
    wanted = com[:2] - (com[2] * output.force[:2] + [moment[1], -moment[0]]) / output.force[2]
    np.testing.assert_allclose(output.zmp, wanted, atol=1e-3)


def test_a_heel_that_sinks_leaves_its_ball_where_it_was():
    wanted, time, sunk, now = [], 0.62, 0.0008, state(0.62)
    now.q[2] -= sunk
    for share in (0.0, 1.0):
        it = controller(f"controller.sink_compensation={share}")
        it.update(now, touch(time), reference(time))
        wanted.append(it.workspace.tasks.wanted[6:18].copy())
    sole, (front,) = it.robot.description.sole, np.flatnonzero(reference(time).planned[:, 0])
    pitch = -it.workspace.gains.roll_stiffness * sunk / (sole.ball_x - sole.heel_x)
    change = (wanted[1] - wanted[0]).reshape(2, 6)
    assert change[front, 4] == pytest.approx(pitch, rel=0.05)
    assert not change[1 - front].any()


@pytest.mark.parametrize("time", INSTANTS)
def test_with_less_torque_the_limits_are_kept_and_the_dynamics_too(time):
    free = tick(time)[-1]
    share = 0.9 * (np.abs(free.torque) / walk_of(COARSE).robot.torque_limit).max()
    it, q, v, output = tick(time, tolerance=5e-5, weaker=share)
    assert output.status == LIMITED
    limit = it.robot.torque_limit
    assert (np.abs(output.torque) <= limit).all()
    assert (np.abs(output.torque) > 0.99 * limit).any()
    total = inverse_dynamics(it.robot, q, v, it.acceleration, output.point_force)
    np.testing.assert_allclose(total[:6], 0.0, atol=1.0)  # to the tolerance of the solver
    np.testing.assert_allclose(total[6:], output.torque, atol=0.02 * limit.max())


def test_joints_may_only_run_as_fast_as_they_can_brake():
    robot = walk_of(COARSE).robot
    middle = pin.neutral(robot.model)
    middle[7:] = 0.5 * (robot.lower + robot.upper)
    still, free = np.zeros(40), np.zeros(34)
    joints = Joints(free, free, free, robot.torque_limit, robot.lower, robot.upper)
    strong = joints._replace(torque=1.001 * robot.torque_limit * np.eye(34)[3])
    assert not limit_broken(middle, still, still, joints)
    assert limit_broken(middle, still, still, strong)
    near = middle.copy()
    near[10] = robot.upper[3] - 0.001  # from 1 rad/s on it cannot brake at 500 rad/s^2 within that
    for rate, breaks in ((0.99, False), (1.01, True), (-5.0, False)):
        v = np.zeros(40)
        v[9] = rate
        assert limit_broken(near, v, still, joints) is breaks
        low, high = acceleration_bounds(near, v, joints, robot.gravity)
        assert bool(high[3] < 0.0) is breaks
        assert (low <= high).all()


def test_a_state_that_is_no_number_gives_no_torque_and_is_told():
    it, q, v, _ = tick(0.3)
    nowhere = State(0.302, np.full_like(q, np.nan), v)
    output = it.update(nowhere, Touch(np.zeros(12, bool), np.zeros(12)), reference(0.3, 1))
    assert (output.status, output.residual) == (UNSOLVED, np.inf)
    assert (output.torque == 0.0).all()

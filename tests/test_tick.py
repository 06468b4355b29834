"""Every compiled step of a control tick against its plain twin, at random ticks of two bodies."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from numba.core import config

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.compiled import refer
from ampm.control.controller import TrackingController
from ampm.control.sole import share_sole
from ampm.control.tick import after, before, keep
from ampm.control.workspace import BALL, HEEL, TIP, Workspace, gains_of
from ampm.parameters import BodyParameters, RunParameters
from tests import twins
from validation.trial.plan import make_body

BODIES = ("human", "suite-humanoid")
TICKS = 12 if config.DISABLE_JIT else 120
ROOT = Path(__file__).parents[1]
PLAIN = """
import sys, numpy
from tests.test_tick import numbers
numpy.savez(sys.argv[1], **numbers("human", 4))
"""


class Tick(NamedTuple):
    """One tick: the workspace before and after it, and what the tick was told and said."""

    robot: Any
    old: Workspace
    c: Workspace
    first: bool
    still: bool
    velocity_lag: float
    load_age: float
    tilt: Any
    command: Any  # before the sole was shared
    broken: bool


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
    places, turns = twins.frames(robot, wanted.q, robot.sole_frames)
    wanted.foot_position[:], wanted.foot_rotation[:] = places, turns
    wanted.trunk[:] = twins.frames(robot, wanted.q, [robot.trunk_frame])[1][0]
    wanted.right_load[:] = rng.choice([0.0, 0.3, 1.0])
    wanted.tilt_window[:] = 0.0 if k % 50 < 2 else rng.choice([0.02, 0.03]) if k < 100 else 9.0
    wanted.until_lift[:] = rng.choice([np.inf, 0.06, 0.02, 0.0], size=(2, 3), p=[0.7, 0.1, 0.1, 0.1])
    if k % 6 == 0:
        wanted.planned[:] = rng.random((2, 3)) < rng.choice([0.0, 0.6, 1.0], size=(2, 1))
        wanted.due[:] = wanted.planned | (rng.random((2, 3)) < rng.choice([0.0, 0.3], size=(2, 1)))
        c.sensed.contact[:] = rng.random(len(c.body.points)) < rng.choice([0.0, 0.2, 0.8])
        stepping["active"] = rng.random() < 0.7
        stepping["off_plan"] = stepping["active"] and rng.random() < 0.6
        stepping["com_first"] = rng.random() < 0.5
    heading = 0.3 * rng.normal()
    stepping["heading"] = np.cos(heading), np.sin(heading)
    stepping["floor"], stepping["force_factor"] = 0.02 * rng.normal(), rng.choice([1.0, 1.05])
    c.sensed.contact[:] ^= rng.random(len(c.body.points)) < 0.05
    sensed = rng.uniform(0.0, 0.3, len(c.body.points)) * robot.mass * robot.gravity
    c.sensed.normal_force[:] = c.sensed.contact * sensed
    c.contact.solution[:] = rng.uniform(0.0, 0.2, len(c.contact.solution))
    c.joints.torque_limit[:] = robot.torque_limit * rng.choice([0.1, 1e3])
    for name in ("floor", "slope", "raised", "raised_rate"):
        c.body.feet[name] = 0.0


@cache
def ticks(source, count=TICKS):
    """Random ticks of a body, one after another."""
    rng = np.random.default_rng(7)
    run = RunParameters(body=BodyParameters(source=source))
    robot = make_body(run).robot
    numbers = gains_of(run.controller)._asdict()
    chosen = {name: float(rng.uniform(0.7, 1.3) * value) for name, value in numbers.items()}
    gains = run.controller.model_copy(update=chosen)
    controller = TrackingController(robot, run.model_copy(update={"controller": gains}))
    c = controller.workspace
    handle, parts = refer(c), (refer(c.body), c.stepping[0], refer(c.wanted), refer(c.command))
    tilt, done = twins.MeanTilt(c.gains), []
    for k in range(count):
        randomise(c, robot, rng, k)
        first, still = k == 0, k % 9 == 0
        velocity_lag, load_age = 0.0005 * (k % 2), 0.001
        old = copied(c)
        assert before(handle, None, velocity_lag, load_age, first)
        command = copied(c.command)
        share_sole(*parts)
        c.contact.solution[:] = old.contact.solution
        kept = after(handle, still, first)
        if not kept:
            keep(handle, still, first)
        error = twins.rotation_error(
            c.wanted.trunk, twins.frames(robot, c.sensed.q, [robot.trunk_frame])[1][0]
        )
        fed_back = tilt.update(error, c.wanted.trunk, float(c.wanted.tilt_window[0]))
        done.append(
            Tick(robot, old, copied(c), first, still, velocity_lag, load_age, fed_back, command, not kept)
        )
    return done


@pytest.fixture(params=BODIES)
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
        now = c.sensed.v + it.velocity_lag * it.old.motion.last_acceleration
        jacobian = twins.task_jacobian(robot, q)
        close(c.motion.now, now)
        close(c.body.com, pin.centerOfMass(robot.model, robot.data, q))
        close(c.tasks.jacobian.T, jacobian)
        close(c.tasks.rates, jacobian @ now)
        close(c.tasks.drift, twins.drift(robot, q, c.sensed.v, now))
        places, turns = twins.frames(robot, q, robot.sole_frames)
        close(c.body.com + c.body.feet["place"], places)
        close(c.body.feet["pose"], turns)
        close(c.body.com + c.body.points["arm"], twins.frames(robot, q, robot.point_frames)[0])


def test_contact_gate(walked):
    for it in walked:
        lines, points, stepping = it.c.contact.lines, it.c.body.points, it.c.stepping[0]
        touching = np.zeros(lines.shape, dtype=bool)
        np.logical_or.at(touching, (points["foot"], points["line"]), it.c.sensed.contact)
        close_lifted_tips = stepping["active"] and not stepping["off_plan"]
        expected, _ = twins.gate(it.c, it.old, touching, it.first, close_lifted_tips)
        for name, value in expected.items():
            np.testing.assert_array_equal(lines[name], value, err_msg=name)
        for name in ("opening", "limit"):
            np.testing.assert_array_equal(points[name], lines[name][points["foot"], points["line"]])


def test_command_with_the_trunks_mean_tilt(walked):
    for it in walked:
        force, moment, momentum = twins.command_wrench(it.c, it.tilt)
        close(it.command.force, force)
        close(it.command.moment, moment)
        close(it.command.angular_momentum, momentum)
        close(it.command.zmp, twins.zmp(it.c.body.com, force, moment))


def test_what_the_sole_can_give(walked):
    for it in walked:
        command = it.c.command
        force, moment, changed = twins.shared(it.c, it.command.force, it.command.moment)
        close(command.force, force)
        close(command.moment, moment)
        zmp = twins.zmp(it.c.body.com, force, moment) if changed else it.command.zmp
        close(command.zmp, zmp)


def test_tasks_of_soles_toes_and_posture(walked):
    for it in walked:
        c, q = it.c, it.c.sensed.q
        close(c.tasks.wanted[:6], -c.body.gravity * np.eye(6)[2])
        for i, foot in enumerate(c.body.feet):
            acceleration, softness, speed = twins.sole_task(c, it.old, i)
            rows = slice(6 + 6 * i, 12 + 6 * i)
            close(c.tasks.wanted[rows], acceleration)
            np.testing.assert_array_equal(c.tasks.softness[rows], softness)
            assert foot["stood"] == (speed is not None)
            if speed is not None:
                close(foot["speed"], speed)
            if foot["toe_row"] >= 0:
                toe = foot["toe"]
                close(c.tasks.wanted[foot["toe_row"]], twins.toe_task(c, i, q[toe + 1], c.motion.now[toe]))
        posture = c.motion.posture / c.motion.root_weight * c.body.gravity
        close(posture, twins.posture_task(c, q, c.motion.now))
        close(c.motion.passive_torque, twins.passive(it.robot, q, c.sensed.v, c.wanted.v))


def scaled_tasks(it):
    """Task Jacobian in units of the QP, and the posture's wanted accelerations [g]."""
    jacobian = twins.task_jacobian(it.robot, it.c.sensed.q)
    jacobian[:6] *= twins.SCALE[:, None]
    return jacobian, twins.posture_task(it.c, it.c.sensed.q, it.c.motion.now) / it.robot.gravity


def test_elimination(walked):
    for it in walked:
        c, rows, weights = it.c, len(it.c.tasks.rhs), it.robot.by_group(POSTURE_WEIGHTS)
        jacobian, posture = scaled_tasks(it)
        rhs = (c.tasks.wanted - c.tasks.drift) / it.robot.gravity
        rhs[:6] *= twins.SCALE
        eliminated = twins.eliminate(weights, jacobian, rhs, posture, c.tasks.softness)
        multipliers = c.tasks.system[:, rows:]
        close(multipliers, eliminated.multipliers)
        accelerations = c.tasks.scaled @ multipliers
        accelerations[:, 6] += c.motion.posture
        close(accelerations / c.motion.root_weight[:, None], eliminated.accelerations)


def test_matrices_of_the_qp(walked):
    for it in walked:
        c, yaw = it.c, it.c.tasks.system[5, len(it.c.tasks.rhs) :]
        by_point, lever = twins.force_map(c, it.old)
        close(c.contact.wrench_map, twins.wrench_map(c, by_point))
        landing = twins.gate(it.c, it.old, it.c.contact.lines["touching"], it.first, False)[1]
        limits = twins.bounds(c, it.old, landing, it.load_age)
        expected = twins.qp(c, it.command, by_point, lever, limits, yaw[5], yaw[6])
        for actual, matrix in zip(c.problem, expected, strict=True):
            close(actual, matrix)


def test_accelerations_torques_and_limits(walked):
    for it in walked:
        c, robot, weight = it.c, it.robot, it.robot.mass * it.robot.gravity
        by_point, _ = twins.force_map(c, it.old)
        wrench = twins.wrench_map(c, by_point) @ c.contact.solution
        jacobian, posture = scaled_tasks(it)
        pull = c.tasks.system[:, len(c.tasks.rhs) :] @ [*wrench, 1.0]
        expected = posture + jacobian.T @ pull / robot.by_group(POSTURE_WEIGHTS)
        close(c.motion.acceleration, robot.gravity * expected)
        force = weight * by_point @ c.contact.solution
        close(c.contact.point_force, force)
        total = twins.inverse_dynamics(robot, c.sensed.q, c.sensed.v, c.motion.acceleration, force)
        assert np.abs(total[:6]).max() < 1e-8 * weight  # nothing but the floor drives the root
        torque, limit = total[6:] + c.motion.passive_torque, c.joints.torque_limit
        close(c.joints.torque, np.clip(torque, -limit, limit))
        assert it.broken == twins.breaks_limit(c, torque)


def test_hold_and_what_the_next_tick_reads(walked):
    for it in walked:
        c, old = it.c, it.old
        close(c.joints.rate, twins.rate(c, old, it.still or it.first))
        np.testing.assert_array_equal(c.joints.last_torque, c.joints.torque)
        np.testing.assert_array_equal(c.motion.last_acceleration, c.motion.acceleration)
        np.testing.assert_array_equal(c.contact.forces, c.contact.solution)
        change = old.contact.change if it.first else c.contact.solution - old.contact.forces
        np.testing.assert_array_equal(c.contact.change, change)


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs more ticks")
@pytest.mark.parametrize("source", BODIES)
def test_the_random_ticks_reach_every_case(source):
    seen = dict.fromkeys("flat heel ball late swing tips lands shared off broken kept rate".split(), 0)
    for it in ticks(source):
        lines = it.c.contact.lines
        on, touched = lines["planned"] | lines["touched"], lines["touched"]
        has_tip = (it.c.body.points["line"] == TIP).any()
        whole = on[:, HEEL] & on[:, BALL] & (on[:, TIP] | (it.c.body.feet["toe"] < 0))
        flat = whole & touched[:, HEEL] & touched[:, BALL]
        for name, case in (
            ("flat", flat),
            ("late", whole & ~flat),
            ("heel", ~whole & touched[:, HEEL]),
            ("ball", ~whole & ~touched[:, HEEL] & touched[:, BALL]),
            ("swing", ~on.any(axis=1)),
            ("tips", (lines["limit"][:, TIP] > 0.0) | (not has_tip)),
            ("lands", (lines["opening"] > 0.0) & (lines["opening"] < 1.0)),
            ("shared", it.c.command.zmp != it.command.zmp),
            ("off", it.c.stepping["off_plan"]),
            ("broken", it.broken),
            ("kept", not it.broken),
            ("rate", it.c.joints.rate != 0.0),
        ):
            seen[name] += bool(np.any(case))
    assert min(seen.values()) > 1, seen


def numbers(source, count):
    """What some ticks computed, by name."""
    return {
        f"{k}.{name}": getattr(part, name)
        for k, it in enumerate(ticks(source, count))
        for part in (it.c.tasks, it.c.command, it.c.contact, it.c.problem, it.c.joints, it.c.motion)
        for name in part._fields
        if getattr(part, name).dtype == float
    }


@pytest.mark.skipif(config.DISABLE_JIT, reason="compares compiled code with plain Python")
def test_plain_python_computes_the_same(tmp_path):
    file, environment = tmp_path / "plain.npz", {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", PLAIN, str(file)]
    subprocess.run(command, cwd=ROOT, env=environment, check=True)
    with np.load(file) as plain:
        compiled = numbers("human", 4)
        assert set(plain) == set(compiled)
        for name, value in compiled.items():
            close(plain[name], value)

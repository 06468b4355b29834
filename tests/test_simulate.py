"""The closed loop: what a record holds, how a run ends, by what came first, and what it survives."""

import math
from functools import cache

import mujoco
import numpy as np
import pytest

from ampm.control import contact_qp, limited_qp
from ampm.control.qp import QPSolution, QPSolver
from ampm.exceptions import SolverError
from ampm.walk import LIMITED, SOLVED, UNSOLVED
from models.scene import BodyModel
from tests.records import first_difference, stored
from tests.solved import body_of, replays
from tests.solved import simulated as walk
from validation.trial.outcome import OutcomeName
from validation.trial.physics import Physics
from validation.trial.watch import BLOW_UP, CALM, FALL_TIME, Stance, Watch

STEPS = 2
FAIL_AT = 150  # a tick in single support


@cache
def plain(*overrides):
    return walk(*overrides)


def interrupt(*_):
    raise KeyboardInterrupt


class Spoilt:
    """A solver whose answers are spoilt at some of its solves."""

    def __init__(self, solver, spoil, ticks):
        self.solver, self.spoil, self.ticks, self.solves = solver, spoil, ticks, 0

    def solve(self):
        solution = self.solver.solve()
        self.solves += 1
        return self.spoil(solution) if self.solves - 1 in self.ticks else solution


@pytest.fixture
def spoil(monkeypatch):
    """Spoil the answers of the controller's solver at some ticks, or those of the one with limits."""

    def install(how, ticks, module=contact_qp):
        plain()  # the first walk of a process makes a controller more, to check it
        made = []

        def make(*arguments):
            made.append(QPSolver(*arguments))
            return Spoilt(made[0], how, ticks) if len(made) == 1 else made[-1]

        monkeypatch.setattr(module, "QPSolver", make)

    return install


def not_a_number(solution):
    return QPSolution(np.full_like(solution.x, np.nan), False, np.inf, 400, solution.seconds)


def test_a_slower_clock_holds_its_torques_and_replays():
    settings = "controller.frequency=250"
    record = plain(settings)
    assert record.outcome.name == OutcomeName.COMPLETED
    assert replays(record, settings)
    np.testing.assert_allclose(np.diff(record.tick_time), 0.004, rtol=1e-9)
    assert (np.diff(record.torque[:2], axis=0) == 0.0).all()


@pytest.mark.parametrize("how", [lambda last: last._replace(x=last.x + 1e-4, solved=False), not_a_number])
def test_a_few_failed_qps_are_survived_and_counted(spoil, how):
    spoil(how, range(FAIL_AT, FAIL_AT + 3))
    record = walk()
    assert record.outcome.name == OutcomeName.COMPLETED
    assert record.outcome.steps_completed == STEPS
    assert np.flatnonzero(record.qp_status == UNSOLVED).tolist() == [FAIL_AT, FAIL_AT + 1, FAIL_AT + 2]
    assert np.isfinite(record.torque).all()
    # The last tick's forces, or an iterate, carry the body over: it hardly notices.
    np.testing.assert_allclose(record.com, plain().com, atol=2e-3)


def test_qps_that_fail_on_and_on_end_the_run_as_infeasible(spoil):
    ticks = 25
    spoil(not_a_number, range(FAIL_AT, 10_000))
    record = walk(f"controller.unsolved_limit={0.002 * ticks}")
    assert record.outcome.name == OutcomeName.INFEASIBLE
    assert record.outcome.time == pytest.approx(0.002 * (FAIL_AT + ticks + 1))
    assert record.outcome.steps_completed == 0
    assert f"from 0.300 to {0.3 + 0.002 * ticks:.3f} s" in record.outcome.cause
    assert record.steps == record.tick_time.size == FAIL_AT + ticks + 1
    assert (record.qp_status[:FAIL_AT] == SOLVED).all()
    assert (record.qp_status[FAIL_AT:] == UNSOLVED).all()
    assert replays(record)


def weaker(share: float) -> BodyModel:
    """The body with a share of the torque that the walk needs."""
    share *= (np.abs(plain().torque) / plain().torque_limit).max()
    spec = mujoco.MjSpec.from_string(body_of().xml)
    for motor in spec.actuators:
        motor.ctrlrange = share * np.array(motor.ctrlrange)
        motor.forcerange = share * np.array(motor.forcerange)
    return BodyModel(spec.to_xml(), body_of().description)


def test_a_weaker_body_uses_the_form_with_limits(spoil):
    """Where that fails, the torques are clipped and the failure counted."""
    spoil(not_a_number, range(3), limited_qp)
    record = walk(body=weaker(0.8))
    assert record.outcome.name == OutcomeName.COMPLETED
    limited = record.qp_status == LIMITED
    assert 10 < limited.sum() < record.steps / 2
    assert (record.qp_status == UNSOLVED).sum() == 3
    assert (np.abs(record.torque) <= record.torque_limit).all()
    assert (np.abs(record.torque[limited]) > 0.999 * record.torque_limit).any(axis=1).mean() > 0.5


@pytest.fixture
def physics(monkeypatch):
    """The physics of the next walk."""
    caught = []
    place = Physics.place

    def catch(self, *state):
        caught.append(self)
        place(self, *state)

    monkeypatch.setattr(Physics, "place", catch)
    return caught


@pytest.mark.parametrize(("force", "speed"), [(1e15, 0.0), (np.nan, 0.0), (0.0, 500.0)])
def test_numbers_that_blow_up_diverged_and_the_record_ends_before(physics, force, speed):
    def blow(done, _):
        if done == 100:
            physics[0].data.qfrc_applied[0] = force
            physics[0].data.qvel[2] += speed

    record = walk(progress=blow)
    assert record.outcome.name == OutcomeName.DIVERGED
    assert ("no body does" in record.outcome.cause) or not speed
    assert np.isfinite(record.q).all()
    assert np.isfinite(record.torque).all()
    if force:
        assert record.outcome.time == pytest.approx(0.2)
        assert record.steps == 100
        assert replays(record)


@pytest.mark.parametrize(
    ("where", "at"),
    [
        ("between steps", 0),
        ("between steps", None),
        ("within a solve", FAIL_AT),
        ("after the physics has moved on", FAIL_AT),
    ],
)
def test_an_interrupt_keeps_whole_steps(monkeypatch, spoil, tmp_path, where, at):
    """OSQP catches the signal itself, and its backend raises ``KeyboardInterrupt`` afterwards."""
    step, progress, taken = mujoco.mj_step2, None, []
    whole = plain()
    at = whole.steps if at is None else at  # the very end

    def stop_late(*state):
        step(*state)
        taken.append(state)
        if len(taken) == at + 1:
            interrupt()

    if where == "within a solve":
        spoil(interrupt, [at])
    elif where == "between steps":
        progress = lambda done, _: interrupt() if done == at else None  # noqa: E731
    else:
        monkeypatch.setattr(mujoco, "mj_step2", stop_late)
    record = walk(progress=progress)
    assert record.outcome.name == OutcomeName.INTERRUPTED
    assert record.steps == record.tick_time.size == at
    assert record.outcome.time == pytest.approx(0.002 * at)
    np.testing.assert_array_equal(record.q, whole.q[: at + 1])
    np.testing.assert_array_equal(record.qd, whole.qd[: at + 1])
    np.testing.assert_array_equal(record.torque, whole.torque[:at])
    np.testing.assert_array_equal(record.point_force, whole.point_force[:at])
    np.testing.assert_array_equal(record.foot_position, whole.foot_position[: at + 1])
    assert record.command_zmp.shape == (at, 2)
    assert replays(record)
    assert first_difference(record, stored(record, body_of().xml, tmp_path)) is None


def test_a_fall_between_control_ticks_is_noticed():
    push = "disturbance.push_x=60", "disturbance.push_at=0.12"
    settings = ("controller.frequency=25", "controller.hold=zero-order", *push)
    record = walk(*settings)
    assert record.outcome.name == OutcomeName.FELL
    assert record.steps % 20 > 1  # neither at a tick nor at the step after it
    assert "first sign" in record.outcome.cause
    assert record.time[-1] == record.outcome.time
    assert replays(record, *settings)


def test_a_qp_that_the_solver_refuses_ends_the_walk_and_keeps_its_record(spoil):
    def refuse(_):
        raise SolverError("not convex")

    spoil(refuse, range(51, 10_000))
    record = walk()
    assert record.outcome.name == OutcomeName.INFEASIBLE
    assert "not convex" in record.outcome.cause
    assert (record.steps, record.outcome.time) == (51, pytest.approx(0.102))
    assert replays(record)


PERIOD = 0.002
PLANNED = (0.0, 0.0, 0.88)
UP = (0.0, 0.0, 1.0)
STILL = (0.0, 0.0, 0.0)
SOLES = np.array([[0.1, 0.09, 0.0], [-0.1, -0.09, 0.03]])
FALL_TICK = 1 + round(FALL_TIME / PERIOD)  # of a QP that is unsolved from the first tick on


def leaning(degrees, axis=0):
    """A trunk's axis, turned from the vertical."""
    angle = math.radians(degrees)
    return (math.sin(angle), 0.0, math.cos(angle)) if axis == 0 else (0.0, math.sin(angle), math.cos(angle))


def watched(ticks, limit=0.05, until=3000, soles=SOLES):
    """The end of a walk and its tick; ``ticks(k)`` gives (com error, trunk, status)."""
    stance = Stance(np.array(PLANNED), np.array(UP), soles, np.array(PLANNED), np.array(UP), SOLES)
    watch = Watch(stance, limit)
    for k in range(until):
        error, stance.trunk[:], status = ticks(k)
        stance.com[:] = np.array(PLANNED) + error
        end = watch.check(k * PERIOD, status, residual=0.5, limit="left_knee at 100 %")
        if end is not None:
            return end, k
    return None, until


def test_a_walk_on_the_plan_goes_on():
    assert watched(lambda k: ((1e-3, -1e-3, 0.0), leaning(3.0), k % 2)) == (None, 3000)


FAR = ((0.85, 0.0, 0.0), (0.0, -0.85, 0.0), (0.0, 0.0, -0.23), (0.0, 0.0, 0.31))
FASTEST = BLOW_UP * PERIOD
OFF = "COM 50 mm off"
LATE = "QP at 0.200 s"
LEANED = "60 degrees off the reference at"


@pytest.mark.parametrize(
    ("ticks", "name", "tick", "sign"),
    [
        *(
            (lambda k, e=e: (tuple(min(k / 500, 1.0) * i for i in e), UP, SOLVED), OutcomeName.FELL, None, "")
            for e in FAR
        ),
        (lambda k: (STILL, leaning(0.1 * k, 0), SOLVED), OutcomeName.FELL, 601, LEANED),
        (lambda k: (STILL, leaning(0.1 * k, 1), SOLVED), OutcomeName.FELL, 601, "trunk 1"),
        (lambda k: (STILL, (0.0, 0.0, -1.0), SOLVED), OutcomeName.FELL, 0, "trunk 1"),
        (lambda k: ((1e-3, 0, 0), UP, UNSOLVED if k >= 100 else SOLVED), OutcomeName.INFEASIBLE, 125, LATE),
        (lambda k: ((0.05, 0, 0), UP, UNSOLVED if k else SOLVED), OutcomeName.INFEASIBLE, FALL_TICK, OFF),
        (lambda k: ((math.nan if k == 7 else 0.0, 0, 0), UP, SOLVED), OutcomeName.DIVERGED, 7, ""),
        (lambda k: ((math.inf if k == 7 else 0.0, 0, 0), UP, SOLVED), OutcomeName.DIVERGED, 7, ""),
        (lambda k: (STILL, (0.0, math.nan, 1.0), SOLVED), OutcomeName.DIVERGED, 0, ""),
        (lambda k: ((1.01 * FASTEST * max(0, k - 4), 0, 0), UP, UNSOLVED), OutcomeName.DIVERGED, 5, ""),
        (lambda k: ((0.91 * FASTEST * k, 0, 0), UP, SOLVED), OutcomeName.FELL, None, ""),
    ],
)
def test_how_a_walk_ends(ticks, name, tick, sign):
    end, k = watched(ticks)
    assert end.name == name
    assert k == tick or tick is None
    assert sign in end.cause


def test_a_sign_that_was_got_over_is_not_the_cause_of_what_comes_later():
    calm = round(CALM / PERIOD)

    def late(k):
        early = k == 10
        return (0.0, 0.0, 0.0 if k < 3 * calm else -1e-3 * (k - 3 * calm)), UP, LIMITED if early else SOLVED

    end, _ = watched(late, until=4 * calm)
    assert end.name == OutcomeName.FELL
    assert "knee" not in end.cause
    end, _ = watched(lambda k: (*late(k + 3 * calm - 100)[:2], LIMITED if k == 10 else SOLVED))
    assert "0.020 s (left knee at 100 %)" in end.cause


def test_a_body_that_stepped_off_the_plan_and_stands_has_not_fallen():
    """It stands 0.5 m beside the plan, and 0.4 m lower, where the real floor is."""
    away = np.array([0.3, 0.5, -0.4])
    assert watched(lambda k: (tuple(away), UP, SOLVED), soles=SOLES + away)[0] is None
    end, _ = watched(lambda k: (tuple(away), UP, SOLVED))
    assert "0.48 m over the soles" in end.cause

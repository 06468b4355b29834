"""Planners that go on planning while their plan is walked."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ampm import BodilyRefusal, FootstepPlanner, InputError, PeriodicPlanner, TrackingController, load_run
from ampm.planner.routes import straight
from tests.records import same_bits
from tests.solved import COARSE, planned_walk, simulate_plan, simulated, walk_of
from tests.test_make_plan import Moved
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.judge.signals import signals_table
from validation.measure.measure import measure
from validation.store.record import load_record, read_table, save_record
from validation.store.signals import COLUMNS
from validation.trial.followed import JUDGED_LEAD, LEADS, PlanRows
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, make_body, plan_walk
from validation.trial.references import References
from validation.trial.simulate import simulate
from validation.trial.users import UsersError


class Replanning:
    """A planner of ours, and a change of its plan by a function of time and plan."""

    def __init__(self, change, period=None, planner=PeriodicPlanner):
        self.change, self.calls, self.planner = change, [], planner
        if period is not None:
            self.replan_period = period

    def plan(self, run, robot):
        return self.planner().plan(run, robot)

    def replan(self, time, state, touch, plan):
        self.calls.append((time, state.time, len(touch.contact), plan))
        return self.change(time, plan)


def assert_same(one, other):
    for name in ("q", "qd", "torque", "point_force", "command_com", "command_zmp", "qp_status"):
        assert same_bits(getattr(one, name), getattr(other, name)), name


@pytest.fixture(scope="module")
def fixed():
    return simulated()


@pytest.mark.parametrize(("period", "kept"), [(None, lambda plan: plan), (0.05, lambda plan: None)])
def test_the_planner_is_asked_at_its_period_and_may_keep_its_plan(fixed, period, kept):
    planner = Replanning(lambda time, plan: kept(plan), period)
    record = simulated(planner=planner)
    assert_same(fixed, record)
    times = [call[0] for call in planner.calls]
    wanted = record.tick_time if period is None else np.arange(0.0, record.tick_time[-1], period)
    np.testing.assert_allclose(times, wanted, rtol=0.0, atol=1e-9)
    assert all(time == sensed and points == 12 for time, sensed, points, _ in planner.calls)


@pytest.mark.parametrize(("period", "steps"), [(0.01, 1), (0.05, 2)])
def test_an_equal_plan_walks_the_same_walk(fixed, period, steps):
    """References are made in other parts of the walk, so that the last digits differ."""
    planner = Replanning(lambda time, plan: replace(plan), period)
    record = simulated(planner=planner, steps=steps)
    plans = [call[3] for call in planner.calls]
    assert len({id(plan) for plan in plans}) == len(plans)  # each call gets the plan made by the one before
    np.testing.assert_allclose(record.q, fixed.q[: len(record.q)], rtol=0.0, atol=1e-7)
    command = fixed.command_com[: len(record.command_com)]
    np.testing.assert_allclose(record.command_com, command, rtol=0.0, atol=1e-12)
    walk = compared(plan_of(4), record)
    for lead in LEADS:
        np.testing.assert_allclose(walk.followed.at(walk.time, lead).zmp, walk.sample.zmp, atol=1e-9)


def test_a_plan_holds_from_the_next_tick_on():
    """A plan that says when it was made is followed one tick later, whatever it has measured."""
    base = plan_of(2)
    planner = Replanning(lambda time, plan: moved_plan(base, 1e-3 * time), 0.01)
    record = simulated("simulation.time_step=0.0005", planner=planner, steps=1)
    ticks = record.tick_time
    followed = record.command_com[:: record.substeps, 1] - base.sample(ticks).com[:, 1]
    asked = np.array([call[0] for call in planner.calls])
    before = asked[np.searchsorted(asked, ticks[1:] - 1e-9) - 1]
    np.testing.assert_allclose(followed[1:], 1e-3 * before, rtol=0.0, atol=1e-12)


def plan_of(steps):
    """The plan of the same gait with another number of steps."""
    return planned_walk(f"gait.steps={steps}")


@pytest.mark.parametrize(("first", "then", "ask", "walked"), [(1, 3, 4, 3), (1, 3, 1, 1), (2, 6, 4, 4)])
def test_the_plan_then_valid_says_when_a_walk_ends(fixed, first, then, ask, walked):
    """A record of a walk that became longer than planned has no gap."""
    planner = Replanning(lambda time, plan: plan_of(then) if time > 0.3 else None, 0.05)
    record = simulate_plan(plan_of(first), f"gait.steps={ask}", planner=planner)
    assert record.outcome.completed
    assert record.outcome.steps_completed == walked
    rows = min(record.steps, fixed.steps) - 1
    for name in ("q", "qd", "torque", "point_force", "command_com", "command_zmp", "com"):
        one, other = (getattr(walk, name)[:rows] for walk in (record, fixed))
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
    assert np.isfinite(record.q).all()
    assert (np.diff(record.com[:, 0]) > 0.0).all()


def refuse(plan):
    raise BodilyRefusal("the step is long", reason="", value=1.0, limit=0.5, unit="m")


def squeezed(plan):
    """All that comes after the first step lasts 10 ms a phase."""
    switches = plan.contacts.switches
    switches = np.append(switches[:2], switches[2] + 0.01 * np.arange(len(switches) - 2))
    return replace(plan, contacts=replace(plan.contacts, switches=switches))


def hurried(plan):
    """More of the steps have passed."""
    return replace(plan, contacts=replace(plan.contacts, switches=0.4 * plan.contacts.switches))


@pytest.mark.parametrize(
    ("change", "at", "words"),
    [
        (lambda plan: plan_of(1), 0.9, "plan beyond now"),
        (lambda plan: plan_of(1), 0.3, "1 of the walk's 2 steps"),
        (lambda plan: begun(plan, start=0.4), 0.3, "begins at 0.4 s; plan from now on"),
        (lambda plan: replace(plan, com_height=np.nan), 0.1, "'com' of its plan"),
        (refuse, 0.1, r"the planner Replanning failed \(BodilyRefusal: the step is long"),
        (squeezed, 0.1, "it swings a foot in 0.01 s"),
        # An error within a library is placed where the class called it.
        (
            lambda plan: np.linalg.solve(np.zeros((2, 2)), np.zeros(2)),
            0.1,
            r"matrix\) in test_replan\.py, line",
        ),
        (hurried, 0.3, "other supports up to then than the plan in force"),
    ],
)
def test_errors_on_the_way_end_the_walk(change, at, words):
    record = simulated(planner=Replanning(lambda time, plan: change(plan) if time > at else None))
    assert record.outcome.name is OutcomeName.CRASHED
    assert re.search(words, record.outcome.cause), record.outcome.cause
    assert words != "plan beyond now" or record.time[-1] == pytest.approx(at, abs=0.01)


@pytest.mark.parametrize(
    ("rows", "scale", "words"),
    [
        (4, 1.0, "has 2 of the walk's 3 steps"),
        (5, 0.3, r"does not keep to footstep 3 at \(0\.3, .*its footstep is 0\.21 m off"),
        (7, 1.0, ""),
        (20, 1.0, r"takes 15\.\d+ s, more than 1\.5 times the 5\.6\d+ s"),
    ],
)
def test_footsteps_of_the_run_bind_later_plans(rows, scale, words):
    """Fewer footsteps and others are refused; more are walked."""
    longer = straight(20, 0.3, 0.18)
    given = longer[:5]
    run = load_run(None, ["simulation.time_step=0.002"], footsteps=given)

    def replan(time, plan):
        if time < 0.1:
            return None
        others = [s._replace(position=(scale * s.position[0], *s.position[1:])) for s in longer[:rows]]
        return FootstepPlanner().plan(run.replace({}, footsteps=others), body.robot)

    planner, body = Replanning(replan, 0.1, FootstepPlanner), make_body(run)
    record = simulate(plan_walk(Request("stones", run), planner=planner))
    assert record.outcome.name is (OutcomeName.CRASHED if words else OutcomeName.COMPLETED)
    assert re.search(words, record.outcome.cause), record.outcome.cause
    assert words or record.outcome.steps_completed == rows - 2


class Untidy(TrackingController):
    """Writes into what it got and has used."""

    def update(self, state, touch, reference):
        output = super().update(state, touch, reference)
        for values in (state.q, state.v, touch.normal_force):
            values[:] = math.nan
        return output


def test_a_planner_and_an_estimator_get_what_was_sensed_whatever_a_controller_writes():
    found: list = []

    class Look(Replanning):
        def replan(self, time, state, touch, plan):
            found.extend((state.q.copy(), state.v.copy(), touch.normal_force.copy()))

    for estimators in (("exact", "exact"), ("kalman", "tests.test_sensors:Untidy")):
        walked = []
        for name, controller in zip(estimators, (None, Untidy), strict=True):
            setting = f"sensors.estimator={name}"
            walked.append(simulated(setting, planner=Look(None), controller=controller, steps=1))
        assert_same(*walked)
    assert np.isfinite(np.hstack(found)).all()


def test_a_planner_cannot_change_the_run():
    class Greedy(PeriodicPlanner):
        checked = False

        def plan(self, run, robot):
            run.planner.options["roll"] = 0.2
            object.__setattr__(run.gait, "steps", 1)
            return super().plan(run, robot)

    run = walk_of(COARSE, "gait.steps=2", "planner.options.roll=0.1").run
    with pytest.raises(UsersError, match="1 of the 2 steps"):
        plan_walk(Request("walk", run), planner=Greedy())
    assert (run.gait.steps, run.planner.options) == (2, {"roll": 0.1})


def begun(plan, **change):
    """The plan with a change in its first phase."""
    return replace(plan, phases=(plan.phases[0]._replace(**change), *plan.phases[1:]))


def moved_plan(plan, by):
    """The plan, moved along y as a whole [m]."""
    phases = tuple(phase._replace(origin=(phase.origin[0], phase.origin[1] + by)) for phase in plan.phases)
    places = [(step, step.position) for step in plan.contacts.footsteps]
    footsteps = tuple(step._replace(position=(x, y + by, z)) for step, (x, y, z) in places)
    return replace(plan, phases=phases, contacts=replace(plan.contacts, footsteps=footsteps))


def compared(plan, record):
    return compare(plan, record, measure(record, walk_of(COARSE).robot.model))


@pytest.fixture(scope="module")
def replanned():
    """A walk whose plan moves by 1 mm along y at 0.3 s: first plan, record."""
    planner = Replanning(lambda time, plan: moved_plan(plan, 1e-3) if abs(time - 0.3) < 1e-9 else None)
    plan = plan_of(4)
    return plan, simulate_plan(plan, "gait.steps=2", planner=planner)


def test_the_record_says_which_plan_was_followed(replanned, fixed, tmp_path):
    _, record = replanned
    assert record.outcome.completed
    np.testing.assert_array_equal(record.tick_plan, record.tick_time > 0.3 + 1e-9)
    save_record(record, tmp_path / "moved")
    stored = load_record(tmp_path / "moved")
    np.testing.assert_array_equal(stored.tick_plan, record.tick_plan)
    assert stored.changes == 1
    save_record(fixed, tmp_path / "fixed")
    assert not load_record(tmp_path / "fixed").tick_plan.any()
    assert "plan" not in read_table(tmp_path / "fixed" / "ticks.parquet").column_names


def test_a_walk_is_judged_by_the_plan_as_it_stood_before(replanned):
    plan, record = replanned
    walk = compared(plan, record)
    now, moved = plan.sample(walk.time), moved_plan(plan, 1e-3).sample(walk.time)
    for lead in LEADS:
        later = (walk.time - lead > 0.3 + 1e-9)[:, None]
        there = walk.followed.at(walk.time, lead).zmp
        np.testing.assert_allclose(there, np.where(later, moved.zmp, now.zmp), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(walk.sample.zmp, walk.followed.at(walk.time, JUDGED_LEAD).zmp)
    np.testing.assert_array_equal(walk.first.zmp, now.zmp)
    np.testing.assert_array_equal(walk.sample.stance, now.stance)
    metrics = evaluate(walk)
    assert metrics["zmp_y_rmse"] == walk.ahead[JUDGED_LEAD]["zmp_y"]
    assert metrics["plan_moved_zmp_maximum"] == pytest.approx(1e-3)
    assert metrics["plan_changes"] == 1.0
    table = signals_table(walk)
    np.testing.assert_array_equal(table["first_plan_zmp_y"], now.zmp[:, 1])
    assert {*table.column_names} <= {*COLUMNS}


def test_a_frozen_plan_goes_on_along_straight_lines():
    plan, times = plan_of(2), np.arange(0.0, 0.3, 0.01)
    between = PlanRows.of(plan, times).at(times[:-1] + 0.005)
    np.testing.assert_allclose(between.com, plan.sample(times[:-1] + 0.005).com, atol=1e-4)


def test_a_plan_that_stays_has_no_more_metrics_and_columns(fixed):
    walk = compared(plan_of(4), fixed)
    assert walk.first is None
    assert not [name for name in evaluate(walk) if name.startswith(("plan_moved", "plan_c"))]
    assert len({tuple(found.values()) for found in walk.ahead.values()}) == 1
    assert not [name for name in signals_table(walk).column_names if name.startswith("first")]


def test_what_a_plan_answers_after_it_was_handed_over_has_no_effect(fixed):
    """The planner changes the law of its plan in place: so that it contradicts itself, and moves its ZMP."""
    plan = plan_of(2)
    laws = [Moved(phase.x, "zmp", 0.0) for phase in plan.phases]
    phases = tuple(phase._replace(x=law) for phase, law in zip(plan.phases, laws, strict=True))

    def change(time, plan):
        for law in laws:
            law.by = 0.1 if time > 0.2 else 0.0
        return plan

    plan = replace(plan, phases=phases)
    record = simulate_plan(plan, "gait.steps=2", planner=Replanning(change))
    assert_same(fixed, record)
    walk = compared(plan, record)
    assert laws[0].by == 0.1
    np.testing.assert_allclose(walk.sample.zmp, plan_of(2).sample(walk.time).zmp)
    assert not walk.followed.moved


def test_a_plan_that_contradicts_itself_is_refused():
    plan = plan_of(2)
    off = Moved(plan.phases[0].x, "zmp", 3e-4)
    wrong = begun(plan, x=off)
    with pytest.raises(InputError, match=r"contradicts itself at .* s: its ZMP .* 0\.3 mm .* 0\.2 mm"):
        simulate_plan(wrong)
    record = simulated(planner=Replanning(lambda time, plan: wrong if time > 0.1 else None), steps=2)
    assert record.outcome.completed or "contradicts itself" in record.outcome.cause
    off.by = 1e-4
    walk = compared(wrong, simulate_plan(wrong))
    assert evaluate(walk)["plan_newton_residual"] == pytest.approx(1e-4, rel=1e-3)


class Elsewhere(Moved):
    """A law that says something else of the instants that are judged, 2 ms apart."""

    def evaluate(self, time):
        self.by = 1e-3 * np.allclose(np.diff(time), 2e-3)
        return super().evaluate(time)


def test_torque_is_held_where_a_plan_begins_with_another_acceleration(replanned):
    """Between two ticks it goes on with its slope, which a jump would double."""
    plan, _ = replanned
    run = walk_of().run
    physics: Any = SimpleNamespace(time_step=0.0005, substeps=4)
    steeper = Moved(plan.phases[0].x, "acceleration", 1e-3)  # as if its ZMP were 0.1 mm elsewhere
    for other, jumps in ((replace(plan), 0), (begun(plan, x=steeper), 1)):
        course = References(plan, run, physics, steps=1)
        assert (course.timing.hold, course.timing.extrapolation) == (0.0015, 0.002)
        found = []
        for reference in course.references:
            found.append(reference)
            if len(found) == 100:
                course.follow(other)
        wanted = plan.table([reference.time for reference in found], course.timing).jumps.copy()
        wanted[100] |= bool(jumps)
        np.testing.assert_array_equal([reference.jumps for reference in found], wanted)

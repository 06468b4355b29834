"""Planners that go on planning while their plan is walked."""

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

import ampm
import validation as val
from ampm.exceptions import InputError
from ampm.planner.contacts import Contacts
from ampm.planners import PeriodicPlanner, periodic_walk
from ampm.reference import Timing
from tests.solved import COARSE, motion_of, simulate_plan, simulated, walk_of
from validation.cli.app import app
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.judge.signals import signals_table
from validation.measure.measure import measure
from validation.store.record import StoredRecord, read_table, save_record
from validation.store.saved import load_saved_run
from validation.store.signals import column_of
from validation.trial.bridge import to_pinocchio
from validation.trial.disturbances import Push
from validation.trial.followed import JUDGED_LEAD, LEADS
from validation.trial.outcome import OutcomeName
from validation.trial.references import References


class Replanning:
    """Our planner, and a change of its plan by a function of time and plan."""

    def __init__(self, change, period=None):
        self.change, self.calls = change, []
        if period is not None:
            self.replan_period = period

    def plan(self, run, robot):
        return PeriodicPlanner().plan(run, robot)

    def replan(self, time, state, touch, plan):
        self.calls.append((time, state.time, len(touch.contact), plan))
        return self.change(time, plan)


def first_difference(one, other):
    names = ("q", "qd", "torque", "point_force", "command_com", "command_zmp", "qp_status")
    return next((n for n in names if getattr(one, n).tobytes() != getattr(other, n).tobytes()), None)


@pytest.fixture(scope="module")
def fixed():
    return simulated()


@pytest.mark.parametrize("period", [None, 0.05])
def test_the_planner_is_asked_at_its_period(fixed, period):
    planner = Replanning(lambda time, plan: plan, period)
    record = simulated(planner=planner)
    assert first_difference(fixed, record) is None
    times = [call[0] for call in planner.calls]
    wanted = record.tick_time if period is None else np.arange(0.0, record.tick_time[-1], period)
    np.testing.assert_allclose(times, wanted, rtol=0.0, atol=1e-9)
    assert all(time == sensed and points == 12 for time, sensed, points, _ in planner.calls)


def test_no_plan_is_kept(fixed):
    assert first_difference(fixed, simulated(planner=Replanning(lambda time, plan: None))) is None


@pytest.mark.parametrize(("period", "steps"), [(None, 1), (0.05, 2)])
def test_an_equal_plan_walks_the_same_walk(fixed, period, steps):
    """References are made in other parts of the walk, so that the last digits differ."""
    planner = Replanning(lambda time, plan: replace(plan), period)
    record = simulated(planner=planner, steps=steps)
    plans = [call[3] for call in planner.calls]
    assert len({id(plan) for plan in plans}) == len(plans)  # each call gets the plan made by the one before
    np.testing.assert_allclose(record.q, fixed.q[: len(record.q)], rtol=0.0, atol=1e-7)
    command = fixed.command_com[: len(record.command_com)]
    np.testing.assert_allclose(record.command_com, command, rtol=0.0, atol=1e-12)


def test_a_plan_holds_from_the_next_tick_on():
    """A plan that says when it was made is followed one tick later, whatever it has measured."""
    base = plan_of(2)
    planner = Replanning(lambda time, plan: moved_plan(base, 1e-3 * time))
    record = simulated("simulation.time_step=0.0005", planner=planner, steps=1)
    ticks = record.tick_time
    followed = record.command_com[:: record.substeps, 1] - base.sample(ticks).com[:, 1]
    np.testing.assert_allclose(followed[1:], 1e-3 * ticks[:-1], rtol=0.0, atol=1e-12)


def plan_of(steps):
    """The plan of the same gait with another number of steps."""
    walk = walk_of(COARSE, f"gait.steps={steps}")
    return periodic_walk(walk.plan, motion_of(COARSE), walk.robot)


@pytest.mark.parametrize(
    ("first", "then", "asked", "walked"), [(1, 3, None, 3), (1, 3, 1, 1), (2, 6, None, 4)]
)
def test_the_plan_then_valid_says_when_a_walk_ends(fixed, first, then, asked, walked):
    """The run asks for 4 steps; a record of a walk that became longer than planned has no gap."""
    planner = Replanning(lambda time, plan: plan_of(then) if time > 0.3 else None, 0.05)
    record = simulate_plan(plan_of(first), planner=planner, steps=asked)
    assert record.outcome.completed
    assert record.outcome.steps_completed == walked
    rows = min(record.steps, fixed.steps) - 1
    for name in ("q", "qd", "torque", "point_force", "command_com", "command_zmp", "com"):
        one, other = (getattr(walk, name)[:rows] for walk in (record, fixed))
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
    assert np.isfinite(record.q).all()
    assert (np.diff(record.com[:, 0]) > 0.0).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda time, plan: 1 / 0, "planner Replanning failed .ZeroDivisionError"),
        (lambda time, plan: ampm.plan(walk_of(COARSE).run), "CentroidalPlan, not a WalkPlan; it lacks feet"),
        (lambda time, plan: plan.contacts, "replan at 0 s made a Contacts, not a WalkPlan; None keeps"),
    ],
)
def test_errors_at_the_first_tick_are_the_planners(change, words):
    with pytest.raises(InputError, match=words):
        simulated(planner=Replanning(change))


@pytest.mark.parametrize(
    ("change", "at", "words"),
    [
        (lambda plan: plan_of(1), 0.9, "before now"),
        (lambda plan: plan_of(1), 0.3, "1 steps .* to step"),
        (lambda plan: replace(plan, com_height=np.nan), 0.1, "'com' of its plan"),
    ],
)
def test_errors_on_the_way_end_the_walk(change, at, words):
    record = simulated(planner=Replanning(lambda time, plan: change(plan) if time > at else None))
    assert record.outcome.name is OutcomeName.CRASHED
    assert re.search(words, record.outcome.cause), record.outcome.cause
    assert words != "before now" or record.time[-1] == pytest.approx(at, abs=0.01)


def test_a_period_that_is_none_is_refused():
    with pytest.raises(InputError, match=r"replan_period is -1\.0 s"):
        simulated(planner=Replanning(lambda time, plan: None, -1.0))


def swapped(plan):
    """The plan with the contacts of the other foot's walk."""
    phases = tuple(phase._replace(left=phase.right, right=phase.left) for phase in plan.contacts.phases)
    return replace(plan, contacts=Contacts(plan.contacts.footsteps, phases))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swapped, "at 0.*s its contacts have the left foot in the air, and the path of the foot has it on"),
        (lambda plan: replace(plan, contacts=moved_plan(plan, 0.02).contacts), "left foot is 0.02 m off"),
        (lambda plan: replace(plan, phases=moved_plan(plan, 0.2).phases), "its ZMP is 0.1.* m outside its"),
    ],
)
def test_a_plan_that_contradicts_its_contacts_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        simulated(planner=Replanning(lambda time, plan: change(plan)))


def moved_plan(plan, by):
    """The plan, moved along y as a whole [m]."""
    phases = tuple(phase._replace(origin=(phase.origin[0], phase.origin[1] + by)) for phase in plan.phases)

    def there(step):
        if step is None:
            return None
        x, y, z = step.position
        return step._replace(position=(x, y + by, z))

    old = plan.contacts
    supports = (phase._replace(left=there(phase.left), right=there(phase.right)) for phase in old.phases)
    return replace(plan, phases=phases, contacts=Contacts(tuple(map(there, old.footsteps)), tuple(supports)))


def compared(plan, record):
    return compare(plan, record, measure(record, walk_of(COARSE).robot.model, to_pinocchio))


@pytest.fixture(scope="module")
def replanned():
    """A walk whose plan moves by 1 mm along y at 0.3 s: first plan, record."""
    planner = Replanning(lambda time, plan: moved_plan(plan, 1e-3) if abs(time - 0.3) < 1e-9 else None)
    plan = plan_of(4)
    return plan, simulate_plan(plan, planner=planner, steps=2)


def test_the_record_says_which_plan_was_followed(replanned, fixed, tmp_path):
    _, record = replanned
    assert record.outcome.completed
    np.testing.assert_array_equal(record.tick_plan, record.tick_time > 0.3 + 1e-9)
    save_record(record, tmp_path / "moved")
    stored = StoredRecord(tmp_path / "moved")
    np.testing.assert_array_equal(stored.tick_plan, record.tick_plan)
    assert stored.changes == 1
    save_record(fixed, tmp_path / "fixed")
    assert not StoredRecord(tmp_path / "fixed").tick_plan.any()
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
    assert metrics["zmp_y_rmse"].value == walk.ahead[JUDGED_LEAD]["zmp_y"]
    assert metrics["plan_moved_zmp_maximum"].value == pytest.approx(1e-3)
    assert metrics["plan_moved_footsteps"].value == pytest.approx(1e-3)
    assert metrics["plan_moved_time"].value == 0.0
    assert metrics["plan_changes"].value == 1.0
    assert metrics["plan_change_rate"].value == pytest.approx(1.0 / record.time[-1])
    table = signals_table(walk)
    np.testing.assert_array_equal(table["first_plan_zmp_y"], now.zmp[:, 1])
    np.testing.assert_array_equal(table["plan_zmp_y"], walk.sample.zmp[:, 1])
    for name in table.column_names:
        column_of(name)  # has a description


def test_a_plan_that_stays_has_no_more_metrics_and_columns(fixed):
    walk = compared(plan_of(4), fixed)
    assert walk.first is None
    assert not [name for name in evaluate(walk) if name.startswith(("plan_moved", "plan_c"))]
    assert len({tuple(found.values()) for found in walk.ahead.values()}) == 1
    assert not [name for name in signals_table(walk).column_names if name.startswith("first")]


class Wrong:
    """A law whose ZMP is off, by what can be changed while walking."""

    def __init__(self, law):
        self.law, self.off = law, 0.0

    def evaluate(self, time):
        state = self.law.evaluate(time)
        return state._replace(zmp=state.zmp + self.off)


def test_what_a_plan_answers_after_it_was_handed_over_has_no_effect(fixed):
    """The planner changes the law of its plan in place: so that it contradicts itself, and moves its ZMP."""
    plan = plan_of(2)
    laws = [Wrong(phase.x) for phase in plan.phases]
    phases = tuple(phase._replace(x=law) for phase, law in zip(plan.phases, laws, strict=True))

    def change(time, plan):
        for law in laws:
            law.off = 0.1 if time > 0.2 else 0.0
        return plan

    plan = replace(plan, phases=phases)
    record = simulate_plan(plan, planner=Replanning(change), steps=2)
    assert first_difference(fixed, record) is None
    walk = compared(plan, record)
    assert laws[0].off == 0.1
    np.testing.assert_allclose(walk.sample.zmp, plan_of(2).sample(walk.time).zmp)
    assert not walk.followed.moved


def test_a_plan_that_contradicts_itself_is_refused():
    plan = plan_of(2)
    off = Wrong(plan.phases[0].x)
    off.off = 3e-4
    wrong = replace(plan, phases=(plan.phases[0]._replace(x=off), *plan.phases[1:]))
    with pytest.raises(InputError, match=r"contradicts itself at .* s: its ZMP .* 0\.3 mm apart .* 0\.2 mm"):
        simulate_plan(wrong)
    record = simulated(planner=Replanning(lambda time, plan: wrong if time > 0.1 else None), steps=2)
    assert record.outcome.completed or "contradicts itself" in record.outcome.cause
    off.off = 1e-4
    walk = compared(wrong, simulate_plan(wrong))
    assert evaluate(walk)["plan_newton_residual"].value == pytest.approx(1e-4, rel=1e-3)


def test_a_plan_made_of_the_measurement_does_not_know_what_comes(fixed):
    """Its COM is put where it is measured at every tick: at once it is right, a while before it was not."""
    body = walk_of(COARSE).robot

    class Follows(Replanning):
        def replan(self, time, state, touch, plan):
            data = body.model.createData()
            com = pin.centerOfMass(body.model, data, state.q)
            off = com - plan.sample([time]).com[0]
            return moved_plan(plan, float(off[1]))

    push = Push("chest", (0.0, 20.0, 0.0), at=0.3, duration=0.1)
    record = simulate_plan(plan_of(4), planner=Follows(None, 0.02), disturbances=[push], steps=2)
    walk = compared(plan_of(4), record)
    errors = [found["com_y"] for found in walk.ahead.values()]
    assert errors[1] > 1.5 * errors[0]
    assert evaluate(walk)["recovery_time"].value > 0.1


def test_torque_is_held_where_a_plan_begins_with_another_acceleration(replanned):
    """Between two ticks it goes on with its slope, which a jump would double."""
    plan, _ = replanned
    timing = Timing(hold=0.0015, slope=0.002)
    for other, jumps in ((replace(plan), 0), (steeper(plan), 1)):
        course = References(plan, timing, time_step=0.0005, substeps=4, steps=1)
        found = []
        for reference in course.references:
            found.append(reference)
            if len(found) == 100:
                course.follow(other)
        wanted = plan.table([reference.time for reference in found], timing).jumps.copy()
        wanted[100] |= bool(jumps)
        np.testing.assert_array_equal([reference.jumps for reference in found], wanted)


def steeper(plan):
    """The plan with another acceleration, as if its ZMP were 0.1 mm elsewhere."""
    law = plan.phases[0].x
    return replace(plan, phases=(plan.phases[0]._replace(x=Ahead(law)), *plan.phases[1:]))


class Ahead:
    """A law with a larger acceleration."""

    def __init__(self, law):
        self.law = law

    def evaluate(self, time):
        state = self.law.evaluate(time)
        return state._replace(acceleration=state.acceleration + 1e-3)


PLANNER = """
from dataclasses import replace
from ampm.planners import PeriodicPlanner


class Online:
    replan_period = 0.05

    def plan(self, run, robot):
        return PeriodicPlanner().plan(run, robot)

    def replan(self, time, state, touch, plan):
        return replace(plan)
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP, which raises none at its users'
def test_the_example_of_predictive_control_survives_a_push():
    """Its plans leave the soles by some cm for a moment; the fixed plan falls."""
    mpc = runpy.run_path(str(Path(__file__).parents[1] / "examples/planners/mpc.py"))["Mpc"]
    run = ampm.load_run("normal", gait={"steps": 6}, simulation={"time_step": 0.002})
    push = Push("chest", (0.0, -120.0, 0.0), at=2.3, duration=0.1)
    outcomes = [val.walk(run, planner=p, disturbances=[push]).record.outcome for p in (mpc(), "ampm")]
    assert outcomes[0].completed, outcomes[0].cause
    assert outcomes[1].name is OutcomeName.FELL


@pytest.mark.slow
def test_a_planner_of_a_module_replans_on_the_command_line(tmp_path, monkeypatch):
    (tmp_path / "online.py").write_text(PLANNER)
    monkeypatch.chdir(tmp_path)
    words = ["validate", "normal", "--planner", "online:Online", "--steps", "3", "--out", "run"]
    assert CliRunner().invoke(app, words).exit_code == 0
    saved = load_saved_run("run")
    assert saved.summary["metrics"]["plan_changes"]["value"] == saved.record.tick_plan.max()
    assert saved.summary["metrics"]["plan_change_rate"]["value"] == pytest.approx(20.0, abs=1.0)
    assert saved.summary["metrics"]["zmp_x_rmse"]["value"] < 1e-3

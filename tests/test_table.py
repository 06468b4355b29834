"""A plan from a table of COM, ZMP and footsteps: what its author planned, refusals, and walked."""

import math

import numpy as np
import pytest

import ampm
import validation as val
from ampm.body.constant_posture import ConstantPosture
from ampm.body.motion import PeriodicPosture
from ampm.parameters import GRAVITY
from ampm.planner import routes
from ampm.planner.centroidal import CentroidalPlan, PlanConstants
from ampm.planner.footstep_walk import plan_footstep_walk
from ampm.planner.sampled import sampled_plan
from ampm.planner.support import plan_steps
from ampm.planner.table import plan_table, repeats, sample_times, table_motion
from tests.solved import body_of
from validation.store.record import write_columns
from validation.trial.users import read_columns

STEPS = 3


def planned(name="normal", steps=STEPS):
    run = ampm.load_run(name, gait={"steps": steps})
    return plan_steps(run.gait, run.body.mass, run.foot, body_of().description.sole)


def table_of(plan, rate=200.0):
    return plan_table(plan, sample_times(plan.duration, rate))


def read(table, height=0.865):
    motion = table_motion(table)
    bare = CentroidalPlan(60.0, GRAVITY, height, 1.0, motion.pop("contacts"), (), PlanConstants())
    return sampled_plan(bare, **motion)


@pytest.mark.parametrize("name", ["normal", "momentum"])
def test_a_table_gives_back_the_plan_that_wrote_it(name):
    assert sample_times(0.29, 100.0)[-1] == 0.29  # whose product is less than 29 by rounding
    plan = planned(name)
    found = read(table_of(plan, 1000.0))
    assert repeats(found)
    np.testing.assert_array_equal(found.contacts.starts, plan.contacts.starts)
    for field, expected in vars(plan.constants).items():
        assert getattr(found.constants, field) == pytest.approx(expected, rel=0.02, abs=2e-3), field
    times = np.linspace(0.0, found.duration, 2001)
    a, b = plan.sample(times), found.sample(times)
    for field, tolerance in (
        ("com", 1e-8),
        ("com_velocity", 2e-5),
        ("com_acceleration", 2e-2),
        ("zmp", 1e-3),
        ("force", 1.0),
        ("moment", 0.2),
        ("angular_momentum", 1e-3),
    ):
        np.testing.assert_allclose(getattr(b, field), getattr(a, field), atol=tolerance, err_msg=field)
    for a_step, b_step in zip(plan.contacts.footsteps, found.contacts.footsteps, strict=True):
        np.testing.assert_allclose(b_step.position, a_step.position, rtol=0.0, atol=1e-12)
    assert max(found.residuals().values()) == 0.0  # one phase


def test_without_the_starts_of_phases_equal_steps_are_found_from_the_way_of_the_com():
    plan = planned(steps=6)
    table = table_of(plan)
    del table["phase_start"]
    placed = ("com_y", "zmp_y", "left_placement_y", "right_placement_y")
    found = read(table | {name: table[name] + 4e-4 for name in placed})
    assert repeats(found)
    assert found.constants.step_duration == pytest.approx(plan.constants.step_duration, abs=1e-4)
    assert np.abs(found.contacts.starts - plan.contacts.starts).max() < 0.5e-3  # a tenth of a row


def test_without_accelerations_the_force_passes_through_the_com():
    table = table_of(planned())
    rows = len(table["time"])
    del table["com_acceleration_x"], table["com_acceleration_y"]
    sample = read(table).sample(table["time"][: rows - 1])
    assert not sample.moment.any()
    com, zmp = (np.column_stack([table[f"{name}_{axis}"] for axis in "xy"]) for name in ("com", "zmp"))
    expected = GRAVITY / 0.865 * (com - zmp)
    np.testing.assert_allclose(sample.com_acceleration[:, :2], expected[: rows - 1], rtol=0.0, atol=1e-9)


def exchanged(table):
    """The same walk mirrored: the right foot stands first."""
    sides = {"left": "right", "right": "left"}
    found = dict(table)
    for name, column in table.items():
        foot, _, rest = name.partition("_")
        found[f"{sides[foot]}_{rest}" if foot in sides else name] = column
    for name in (name for name in found if name.endswith("_y")):
        found[name] = -found[name]
    found["angular_momentum_x"], found["angular_momentum_y"] = (
        sign * table[f"angular_momentum_{axis}"] for sign, axis in ((-1.0, "x"), (1.0, "y"))
    )
    found["stance"] = np.array([sides.get(name, name) for name in table["stance"]], dtype=object)
    return found


@pytest.mark.parametrize(("slope", "across"), [(0.0, 0.0), (0.05, -0.03)])
def test_a_file_is_walked_as_the_plan_that_wrote_it(tmp_path, slope, across):
    """It begins on the right foot: the mirrored walk alone changes the error by 4 %."""
    gait = {"steps": STEPS, "slope": slope, "cross_slope": across}
    run = ampm.load_run("momentum", gait=gait, simulation={"time_step": 0.002})
    own, path = val.walk(run), tmp_path / "plan.parquet"
    write_columns(exchanged(table_of(own.plan)), path)
    other = own.run.replace({"gait.com_height": 1.2, "gait.cross_slope": -across})  # the table has its height
    trial = val.walk(other, planner=str(path))
    assert isinstance(trial.plan.posture, PeriodicPosture)
    assert trial.summary["planner"] == path.name
    for axis in "xy":
        expected = own.metrics[f"zmp_{axis}_rmse"].value
        assert trial.metrics[f"zmp_{axis}_rmse"].value == pytest.approx(expected, rel=0.1)
    offsets = [walk.plan.constants.angular_momentum_y_offset for walk in (trial, own)]
    assert offsets[0] == pytest.approx(offsets[1], abs=0.01)


def test_steps_that_do_not_repeat_are_walked_with_a_constant_posture():
    """The COM begins 5 mm off and comes back as a pendulum does; the ZMP is that of the plan."""
    plan = planned()
    table = {name: column for name, column in table_of(plan, 1000.0).items() if "acceleration" not in name}
    table["com_x"] = table["com_x"] + 5e-3 * np.exp(-math.sqrt(GRAVITY / plan.com_height) * table["time"])
    assert not repeats(read(table))
    run = ampm.load_run("normal", gait={"steps": STEPS}, simulation={"time_step": 0.002})
    trial = val.walk(run, planner=ampm.TablePlanner(table))
    assert isinstance(trial.plan.posture, ConstantPosture)
    assert trial.record.outcome.completed
    assert trial.metrics["zmp_x_rmse"].value < 5e-3
    assert trial.summary["planner"] == "table"


def test_a_walk_that_turns_and_climbs_as_a_table(tmp_path):
    """Written and read as 'ampm plan --footsteps --samples' and 'ampm validate --planner' do."""
    run, path = ampm.load_run("normal", simulation={"time_step": 0.002}), tmp_path / "arc.csv"
    arc = enumerate(routes.arc(4, 0.4, radius=1.0, width=0.2))
    climb = [step._replace(position=(*step.position[:2], 0.03 * (number > 3))) for number, step in arc]
    own = val.walk(run, footsteps=climb)
    write_columns(table_of(own.plan), path)
    found = read(read_columns(path))
    for a_step, b_step in zip(own.plan.contacts.footsteps, found.contacts.footsteps, strict=True):
        assert (b_step.foot, b_step.heading) == (a_step.foot, pytest.approx(a_step.heading, abs=1e-12))
        assert b_step.position == pytest.approx(a_step.position, abs=1e-12)
    assert found.contacts.footsteps[-1].heading > 0.9
    trial = val.walk(run, planner=str(path)).judged("footsteps")
    assert trial.verdict.passed, trial.verdict.reason
    for name in ("zmp_x_rmse", "zmp_y_rmse"):
        assert trial.metrics[name].value == pytest.approx(own.metrics[name].value, abs=2e-5)


def test_a_table_may_not_stand_long():
    """Rest would dilute the errors of its steps."""
    run = ampm.load_run("flat", footsteps=routes.straight(4, 0.3, 0.2))
    table = table_of(plan_footstep_walk(run, body_of().description))
    longer = {name: np.append(column, column[-1:].repeat(6000)) for name, column in table.items()}
    longer["time"][-6000:] += 0.005 * np.arange(1, 6001)
    with pytest.raises(ampm.InputError, match=r"takes 3\d.* s, more than 1.5 times the 6.0.* s of its steps"):
        val.walk("flat", planner=ampm.TablePlanner(longer))

"""Logs of measured signals, judged by a plan: of a run, of other clocks and places, of sensors, strides."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import validation as val
from ampm.exceptions import InputError
from tests.saved_run import make_run
from tests.test_bad_input import assert_said, rows_of
from tests.test_replan import Replanning
from validation.judge.log import whole_strides
from validation.judge.uncertainty import Uncertainty
from validation.measure.log import UNITS
from validation.run.walk import walk_planned
from validation.store.record import write_columns
from validation.trial.plan import load_request, plan_walk
from validation.trial.users import read_columns

PERSON = Path(__file__).parents[1] / "validation/measure/person_0p8ms.csv"
OF_PLAN = ("zmp", "force", "angular_momentum", "com")


@pytest.fixture(scope="module")
def folder(run_of):
    return run_of()


@pytest.fixture(scope="module")
def summary(folder):
    return val.load(folder).summary


@pytest.fixture
def table(folder):
    """What a robot would have told of a run: every fifth row, force and ZMP of both feet, COM, momentum."""
    signals = val.load(folder).signals
    names = {"time": "time"}
    names |= {f"{name}_{axis}": f"measured_{name}_{axis}" for name in OF_PLAN[1:] for axis in "xyz"}
    names |= {f"zmp_{axis}": f"measured_zmp_{axis}" for axis in "xy"}
    return {name: np.array(signals[column][::5]) for name, column in names.items()}


@pytest.mark.parametrize("row", rows_of("log"))
def test_bad_logs_are_refused(row, folder, table):
    exec(row["input"], {"np": np}, table)
    options = {name: table.pop(name) for name in ("start", "strides") if name in table}
    with pytest.raises(InputError) as caught:
        val.judge_log(table, folder, settings=["solver.ik_time_step=0.01"], **options)
    assert_said(str(caught.value), row["words"])


def value(trial, name):
    return trial.metrics[name].value


def test_every_row_of_a_run_gives_its_metrics(folder, summary, monkeypatch):
    """A run's folder is a log, too; the controller that a plan's run names is not imported."""
    trial = val.judge_log(folder, folder, settings=["controller.name=a:B"], start=0.0, place=(0.0, 0.0))
    known = {name: item for name, item in trial.metrics.items() if not math.isnan(item.value)}
    for name, item in known.items():
        want = summary["metrics"].get(name, {"value": item.value})
        assert item.value == pytest.approx(want["value"], rel=1e-9, abs=1e-12), name
    compared = {f"{name}_{axis}_{kind}" for name in OF_PLAN for axis in "xyz" for kind in ("rmse", "maximum")}
    assert known.keys() >= compared - {"zmp_z_rmse", "zmp_z_maximum"}
    assert trial.verdict.passed, trial.verdict.reason
    assert "Checks of the measurement that were not made" in trial.verdict.reason
    for profile in ("free", "pushed"):  # which are of other walks
        assert trial.judged(profile).verdict.name == "not_measured"
    effort = {name: pytest.approx(values, rel=1e-9) for name, values in summary["effort"].items()}
    assert trial.summary["effort"] == effort
    for name in ("friction", "plan_polygon"):
        assert trial.summary["margins"][name] == summary["margins"][name], name
    assert trial.summary["margins"]["torque"]["value"] is None
    assert trial.record.time[-1] == pytest.approx(val.load(folder).record.time[-1])
    other = plan_walk(load_request("normal", ["gait.c_y=0.93"]))  # as of a table that has changed
    monkeypatch.setattr("validation.run.judge_log.plan_walk", lambda request, progress: other)
    with pytest.raises(InputError, match="mm from the recorded one: a table, its class or ampm"):
        val.judge_log(folder, folder)


def test_start_and_place_are_found_and_said(folder, summary, table):
    """On another clock, 500 km away, at 400 Hz, from .25 s until 1.8 rows before its sixth step ends."""
    trial = val.judge_log(table, folder, settings=["gait.steps=2"])  # of alike strides the middle one
    assert trial.summary["log"]["start"] == pytest.approx(4.0 * trial.plan.constants.step_duration, abs=1e-3)
    table = {name: values[100:1629] for name, values in table.items()}
    table["time"] += 1.7e9
    for name in ("zmp_x", "com_x"):
        table[name] += 5e5
    trial = val.judge_log(table, folder, settings=["disturbance.push_y=20"])
    facts = trial.summary["log"]
    assert trial.verdict.profile == "default"  # nothing disturbs the plan
    assert facts["start"] == pytest.approx(1.7e9, abs=2e-4)
    assert facts["correlation"] > 0.99
    assert trial.record.outcome.steps_completed == 5
    assert facts["place"] == pytest.approx([-5e5, 0.0], abs=2e-4)
    assert trial.verdict.passed, trial.verdict.reason
    for name in ("zmp_x_rmse", "zmp_y_rmse"):
        assert value(trial, name) == pytest.approx(summary["metrics"][name]["value"], rel=0.2)
    said = " ".join(facts["notes"])
    assert "moved by -5e+05 m along x" in said
    assert "1529 instants of the plan are compared, 0.250 to 4.070 s, " in said


def test_a_step_counts_without_its_first_and_last_row_and_a_log_without_a_whole_one_is_partial(folder, table):
    table["zmp_x"][[0, -1]] = np.nan
    turned = {**table, "zmp_y": table["zmp_y"] + np.pi / 180.0 * table["zmp_x"]}
    facts = val.judge_log(turned, folder).summary["log"]
    assert facts["steps"] == facts["planned_steps"] == 8
    assert "Its way is turned by 1.00 degrees to the left of the plan's." in facts["notes"]
    part = slice(500, 780)  # 0.7 s of 0.78 s
    trial = val.judge_log({name: values[part] for name, values in table.items()}, folder, start=0.0)
    assert trial.verdict.reason.startswith("Pass on 11 of 11; no step of the plan is whole.")


def test_strides_that_a_gap_touches_are_left_out():
    log: Any = SimpleNamespace(time=np.r_[0.0:1.5:0.01, 2.25:6.5:0.01], time_step=0.01)
    assert whole_strides(log, np.arange(7.0)) == [(0.0, 1.0), (3.0, 4.0), (4.0, 5.0), (5.0, 6.0)]
    assert whole_strides(log, np.arange(7.0), 0.1) == [(3.0, 4.0), (4.0, 5.0), (5.0, 6.0)]
    assert whole_strides(log, np.r_[3.0, 4.0, 5.6, 6.4]) == [(3.0, 4.0), (5.6, 6.4)]  # it stands between


def test_gaps_are_left_out_and_said(folder, summary, table):
    for rows in (slice(250, 350), slice(600, 700), slice(-100, None)):  # the first over the judged begin
        table["zmp_x"][rows] = np.nan
    gone = np.r_[0:900, 1000 : len(table["time"])]
    table = {name: values[gone] for name, values in table.items()}
    trial = val.judge_log(table, folder, start=0.0, place=(0.0, 0.0))
    assert " steps of " in trial.planned.name  # the log ends before the plan
    assert any("3 of 0.75 s in all, the longest 0.25 s" in note for note in trial.table().notes)
    assert value(trial, "zmp_x_rmse") == pytest.approx(summary["metrics"]["zmp_x_rmse"]["value"], rel=0.3)
    assert trial.verdict.reason.startswith("Pass on 11 of 11; 15.5 % of the time is left out")


@pytest.mark.parametrize("of", ["holes", "random", "clock"])
def test_empty_rows_are_lost_time_if_they_are_not_those_of_a_faster_clock(folder, table, of):
    """Holes of 25 ms, every second row at random, and a ZMP at 100 Hz in a log at 400 Hz."""
    row = np.arange(len(table["time"]))
    empty = {"holes": row % 100 < 10, "random": np.random.default_rng(0).random(row.size) < 0.5}
    table["zmp_x"][empty.get(of, row % 4 > 0)] = np.nan
    trial = val.judge_log(table, folder, start=0.0)
    assert trial.verdict.passed is (of == "clock"), trial.verdict.reason
    assert ("% of the time is left out" in trial.verdict.reason) is (of != "clock")


def test_a_row_counts_for_the_time_until_the_next(folder, table):
    """Few rows where the ZMP is wrong make its RMS error no smaller: alike they gave 1.6 for 4 mm."""
    row = np.arange(len(table["time"]))
    table["zmp_x"] = table["zmp_x"] + 0.01 * (row % 100 < 20)
    wanted = value(val.judge_log(table, folder, start=0.0), "zmp_x_rmse")
    few = {name: values[(row % 100 >= 20) | (row % 10 == 0)] for name, values in table.items()}
    trial = val.judge_log(few, folder, start=0.0)
    assert value(trial, "zmp_x_rmse") == pytest.approx(wanted, rel=0.1)
    assert any("A row counts for the time until the next" in note for note in trial.table().notes)


def test_two_rates_are_no_gaps_and_a_momentum_may_have_some(folder, table):
    few = np.r_[0:600, 600 : len(table["time"]) : 4]
    trial = val.judge_log({name: values[few] for name, values in table.items()}, folder, start=0.0)
    assert "A row counts for the time until the next: give a" in " ".join(trial.table().notes)
    assert trial.verdict.passed, trial.verdict.reason
    some = abs(table["time"] - 1.625) < 0.125
    table["angular_momentum_y"] = np.ma.array(table["angular_momentum_y"], mask=some)
    assert "the angular momentum is empty in 5" in val.judge_log(table, folder, start=0.0).verdict.reason


def test_a_log_of_which_a_part_alone_is_like_the_plan_is_partial(folder, table):
    """Between two parts that walk as planned, 0.7 s are missing, and the clock goes on."""
    cut = np.r_[0:1100, 1380 : len(table["time"])]
    broken = {name: values[cut] for name, values in table.items()}
    broken["time"] = table["time"][: len(cut)]
    trial = val.judge_log(broken, folder)
    assert trial.verdict.name == "partial"
    assert "the part that is like the plan lacks 4 of the log's steps" in trial.verdict.reason


def test_feet_and_sensors_give_the_same_zmp(folder, table):
    """Centres of pressure of both feet, and wrenches at turned sensors above them."""
    signals, sides = val.load(folder).signals, ("left", "right")
    zmp, vertical = np.column_stack([table["zmp_x"], table["zmp_y"]]), {}
    cop, sensor = {"time": table["time"]}, {"time": table["time"]}
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    for side in sides:
        vertical[side] = signals[f"{side}_force_z"][::5]
    share = (vertical["right"] / (vertical["left"] + vertical["right"]))[:, None]
    other = np.array([0.1, -0.05])  # of the right centre of pressure from the left one
    for side, place in zip(sides, (zmp - share * other, zmp + (1.0 - share) * other), strict=True):
        force = np.column_stack([signals[f"{side}_force_{axis}"][::5] for axis in "xyz"])
        cop |= {f"{side}_force_{axis}": force[:, k] for k, axis in enumerate("xyz")}
        known = np.where(vertical[side][:, None] < 1.0, 2e3, place)  # noise of a foot in the air
        cop |= {f"{side}_cop_{axis}": known[:, k] for k, axis in enumerate("xy")}
        lever = np.column_stack([np.zeros((len(zmp), 2)) - [0.02, 0.01], np.full(len(zmp), -0.08)])
        at = np.column_stack([place, np.zeros(len(zmp))]) - lever
        columns = {
            "": at,
            "_force": turn.inv().apply(force),
            "_torque": turn.inv().apply(np.cross(lever, force)),
            "_quaternion": np.tile(np.roll(turn.as_quat(), 1), (len(zmp), 1)),
        }
        for name, values in columns.items():
            axes = "wxyz" if name == "_quaternion" else "xyz"
            sensor |= {f"{side}_sensor{name}_{axis}": values[:, k] for k, axis in enumerate(axes)}
    want = val.judge_log(table, folder, start=0.0, place=(0.0, 0.0))
    # A foot with less than 1 % of the weight has no centre of pressure.
    for log, most in ((cop, 0.1), (sensor, 1e-6)):
        found = val.judge_log(log, folder, start=0.0, place=(0.0, 0.0))
        for name in ("zmp_x_rmse", "zmp_y_maximum", "force_x_rmse", "force_z_rmse"):
            assert value(found, name) == pytest.approx(value(want, name), rel=most), name
        both = found.comparison.rows["measured_double_support"]
        assert 0 < np.count_nonzero(both) < np.count_nonzero(found.comparison.rows["run"])
    sensor["left_sensor_quaternion_w"][100] = np.nan  # a gap
    found = val.judge_log(sensor, folder, start=0.0, place=(0.0, 0.0))
    assert value(found, "zmp_x_rmse") == pytest.approx(value(want, "zmp_x_rmse"), rel=0.01)
    for side, opposite in zip(sides, reversed(sides), strict=True):
        cop[f"{side}_cop_x"] = np.where(vertical[opposite] > 1.0, zmp[:, 0], np.nan)
    with pytest.raises(InputError, match=r"left_cop is empty in \d+ % of the rows in which the foot carries"):
        val.judge_log(cop, folder)
    for side in sides:  # then only double support would be left
        sensor[f"{side}_sensor_torque_x"][vertical[side] < 1.0] = np.nan
    with pytest.raises(InputError, match=r"% of the double supports and . % of the single supports"):
        val.judge_log(sensor, folder)
    for side in sides:  # with the force of both feet beside them nothing is missing
        for axis in "xyz":
            force = signals[f"{side}_force_{axis}"][::5]
            table[f"{side}_force_{axis}"] = np.where(vertical[side] < 1.0, np.nan, force)
    found = val.judge_log(table, folder, start=0.0, place=(0.0, 0.0))
    assert value(found, "zmp_x_rmse") == pytest.approx(value(want, "zmp_x_rmse"), rel=0.01)


def test_the_mean_stride_has_less_error_than_the_run(folder, summary, table):
    table["time"] += 17.0
    trial = val.judge_log(table, folder, strides=True)
    facts = trial.summary["log"]["strides"]
    assert facts["count"] == 3
    assert facts["duration"] == pytest.approx(2.0 * trial.plan.constants.step_duration, abs=2e-3)
    assert facts["speed"] == pytest.approx(trial.plan.constants.mean_velocity, rel=1e-3)
    assert max(facts["spread"]) < 1e-3
    for name in ("zmp_x_rmse", "zmp_y_rmse", "force_x_rmse", "force_z_rmse", "angular_momentum_y_rmse"):
        assert 0.2 < value(trial, name) / summary["metrics"][name]["value"] < 1.05, name
    assert trial.verdict.passed, trial.verdict.reason
    hung = {**table, "force_z": np.where(table["time"] > 20.0, 0.0, table["force_z"])}  # after a fall
    found = val.judge_log(hung, folder, strides=True)
    assert found.verdict.name == "partial"
    assert "Standard deviation" not in next(n for n in found.table().notes if "Mean of 1 stride of" in n)
    table["time"] *= 1.1
    slower = val.judge_log(table, folder, strides=True)
    assert [item.name for item in slower.verdict.judged if item.passed is False] == ["stride_duration_error"]
    assert value(slower, "stride_duration_error") == pytest.approx(0.1, abs=1e-3)


def test_what_strides_lack_makes_their_mean_partial(folder, table):
    """A momentum that is empty in other rows of every stride, some rows of the COM, and a ZMP with holes."""
    row = np.arange(len(table["time"]))
    table["com_x"][row % 30 == 0] = table["angular_momentum_x"][row % 13 == 0] = np.nan
    trial = val.judge_log(table, folder, strides=True)
    assert "the angular momentum is empty in 7.7 % of the rows" in trial.verdict.reason
    assert trial.summary["statistics"]["angular_momentum_x"]["run"]["unmeasured"] < 50
    table["zmp_y"][row % 100 < 10] = np.nan
    trial = val.judge_log(table, folder, strides=True)
    assert trial.verdict.name == "partial"
    assert "9.7 % of the time is left out" in trial.verdict.reason


def test_the_spread_of_strides_is_that_of_force_zmp_and_momentum(folder, table):
    """Every second stride has its ZMP 30 mm further ahead, and its momentum is 0.2 N m s larger."""
    other = table["time"] // 1.358 % 2
    table["zmp_x"] = table["zmp_x"] + 0.03 * other
    table["angular_momentum_x"] = table["angular_momentum_x"] + 0.2 * other
    trial = val.judge_log(table, folder, strides=True)
    spreads = trial.summary["log"]["strides"]["spreads"]
    assert spreads["zmp"] == pytest.approx([0.017, 0.0], abs=1e-3)  # of three strides
    assert spreads["angular_momentum"][0] == pytest.approx(0.115, abs=0.01)
    assert "% of body weight, ZMP 1" in " ".join(trial.table().notes)


def test_a_person_is_no_pendulum_of_constant_height(tmp_path, ampm):
    """The public mean strides at 0.8 m/s: report and recording are written, and the limits are not met."""
    answer = ampm(
        *("judge", PERSON, "--plan", "normal", "--set", "body.mass=70", "--strides"),
        *("--out", tmp_path / "person"),
    )
    assert answer.status == 1, answer.err
    assert "Mean of 2 strides of 1.356 s at 0.8 m/s" in " ".join(answer.out.split())
    saved = val.load(tmp_path / "person")
    assert saved.summary["metrics"]["force_z_rmse"]["display"]["value"] == pytest.approx(7.5, abs=0.1)
    page = (tmp_path / "person" / "report.html").read_text(encoding="utf-8")
    assert "person_0p8ms.csv on normal" in page
    assert "busiest motors" not in page
    assert (tmp_path / "person" / "recording.rrd").stat().st_size > 10_000
    with pytest.raises(InputError, match="is of a log"):
        val.replay(tmp_path / "person")


def test_the_command_judges_and_keeps(folder, table, tmp_path, ampm):
    write_columns(table, log := tmp_path / "log.csv")
    out = tmp_path / "again"
    answer = ampm("judge", log, "--plan", folder, "--out", out, "--json")
    assert (answer.status, answer.json["verdict"]) == (0, "pass"), answer.err
    assert answer.json["directory"] == str(out)
    assert json.loads((out / "summary.json").read_text())["metrics"] == answer.json["metrics"]
    again = ampm("judge", log, "--plan", folder, "--out", out)
    assert (again.status, "exists" in again.err) == (2, True)
    answer = ampm("compare", out, folder)  # a log is a folder like that of a run
    assert "track the ZMP equally well" in answer.out


def test_a_table_of_a_plan_judges_too(folder, tmp_path, table, ampm):
    """The plan's own force and ZMP as log and plan: nothing differs but by the table's sampling."""
    path = tmp_path / "plan.csv"
    assert ampm("plan", "normal", "--steps", 8, "--samples", path, "--rate", 500).status == 0
    trial = val.judge_log(table, path, start=0.0, place=(0.0, 0.0))
    assert value(trial, "zmp_x_rmse") < 2e-3
    assert trial.verdict.passed, trial.verdict.reason


class Online(Replanning):
    """Plans again every 50 ms, the same plan."""

    def __init__(self):
        super().__init__(lambda time, plan: replace(plan), 0.05)


def kept(folder, **changed):
    """The summary on disk, and that of the folder judged again, which equals it."""
    before = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    again = val.judge_run(folder, **changed)
    assert json.loads((folder / "summary.json").read_text(encoding="utf-8")) == before
    return before, json.loads(json.dumps(again.summary))


@pytest.mark.parametrize(
    ("gait", "settings", "profile", "measured"),
    [
        ("normal", (f"gait.planner={__name__}:Online",), "default", "plan_changes"),
        ("normal", ("sensors.estimator=kalman",), "odometry", "zmp_foot_x_rmse"),
        ("ipm", ("disturbance.push_y=20", "disturbance.push_at=0.5"), "pushed", "zmp_x_rmse"),
    ],
    ids=["replanned", "estimated", "pushed"],
)
def test_a_run_is_judged_as_it_was(tmp_path, ampm, gait, settings, profile, measured):
    request = load_request(gait, ["gait.steps=2", "simulation.time_step=0.002", *settings], as_is=True)
    folder = tmp_path / "run"
    walk_planned(plan_walk(request)).save(folder, recording=False)
    before, again = kept(folder)
    assert before["profile"] == profile
    assert before["metrics"][measured]["value"] is not None
    assert again == before
    assert val.replay(folder).identical
    answer = ampm("judge", folder, "--plan", folder, "--json")
    assert answer.status == (before["verdict"] != "pass")
    assert answer.json == {**before, "directory": str(folder)}
    assert val.judge_run(folder, "jumps").summary["profile"] == "jumps"


def test_so_is_one_whose_uncertainty_is_known(tmp_path):
    values = {"zmp_x_rmse": 2e-3, "zmp_y_rmse": 1e-5, "zmp_x_maximum": 1e-3}
    known = Uncertainty("normal", 6, values, spreads={"zmp_x_maximum": math.inf})
    folder = make_run(tmp_path / "run", steps=2, uncertainty=known)
    before, again = kept(folder)
    assert before["verdict"] == "undecided"
    assert again == before
    with pytest.raises(InputError, match="is undecided, not failed"):
        val.explain(folder)


def test_so_is_the_log_of_a_treadmill(folder, table, tmp_path):
    """On the belt's frame it has the metrics of the walk over the floor."""
    belt = 0.9 + 0.1 * np.sin(table["time"])
    way = np.cumsum(np.append(0.0, 0.5 * (belt[1:] + belt[:-1]) * np.diff(table["time"])))
    moved = {name: table[name] - way for name in ("zmp_x", "com_x")}
    want, found = (val.judge_log(log, folder) for log in (table, {**table, **moved, "belt_speed": belt}))
    assert value(found, "zmp_x_rmse") == pytest.approx(value(want, "zmp_x_rmse"), rel=1e-9)
    before, again = kept(found.save(tmp_path / "log", recording=False))
    assert again == before


def test_units_have_the_factors_of_their_prefixes():
    prefixes = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}
    for unit, factor in (pair for units in UNITS.values() for pair in units.items()):
        last = unit.split()[-1]
        assert factor == (prefixes[last[0]] if len(last) == 2 else {"kgf": 9.80665}.get(unit, 1.0)), unit


def test_columns_have_other_names_units_and_signs(folder, table, tmp_path, ampm):
    """A robot's table may have milliseconds, millimetres, force on the floor, x to the left."""
    want = val.judge_log(table, folder, start=0.0)
    other = {"t": 1e3 * table["time"], "Fz": -table["force_z"], "COMx[mm]": 1e3 * table["com_x"]}
    names = {"time": "t[ms]", "force_z": "-Fz", "com_x": "COMx[mm]"}
    other |= {name: values for name, values in table.items() if name not in names}
    write_columns(other, log := tmp_path / "log.csv")
    (tmp_path / "names.toml").write_text('time = "t[ms]"\nforce_z = "-Fz"\n')
    columns = ("--columns", tmp_path / "names.toml", "--columns", "com_x=COMx[mm]")
    answer = ampm("judge", log, "--plan", folder, *columns, "--start", 0, "--out", tmp_path / "a", "--json")
    assert answer.status == 0, answer.err
    for name in ("zmp_x_rmse", "force_z_rmse", "com_x_rmse"):
        assert answer.json["metrics"][name]["value"] == pytest.approx(value(want, name), rel=1e-9)
    lean = ("--columns", "com_x=nothing")
    assert "no column 'nothing' for com_x" in ampm("judge", log, *lean, "--out", tmp_path / "b").err


def test_what_a_log_lacks_is_named_and_has_a_status_of_its_own(folder, table, tmp_path, ampm):
    lean = {name: values for name, values in table.items() if not name.startswith(("angular", "com"))}
    meant = {"angular_momentm_x": table["angular_momentum_x"]}
    another = {"com_vx": lean["zmp_x"]}
    write_columns(lean | meant | another, log := tmp_path / "log.csv")
    answer = ampm("judge", log, "--plan", folder, "--start", 0, "--out", tmp_path / "a")
    assert answer.status == 6
    assert "column angular_momentm_x is not used; did you mean angular_momentum_x?" in answer.err
    assert "com_vx" not in answer.err
    assert "PARTIAL  Pass on 9 of 11; angular momentum was not measured." in answer.out
    assert ampm("judge", tmp_path / "a").status == 6
    forces = {name: values for name, values in lean.items() if not name.startswith("zmp")}
    trial = val.judge_log(forces, folder, start=0.0)
    assert "ZMP and angular momentum were not measured." in trial.verdict.reason
    assert math.isnan(value(trial, "unsupported_instants"))
    lean["zmp_y"] = lean["zmp_y"] + 0.05 * np.sin(9.0 * lean["time"])
    write_columns(lean, log)
    assert ampm("judge", log, "--plan", folder, "--out", tmp_path / "b").status == 1


@pytest.mark.parametrize(
    "text",
    [
        "time;force_z\n0,25;700\n0,5;-1,5e3\n",
        "# walk 12\n# of a robot\ntime;force_z\n0.25;700\n0.5;-1500\n",
        "time\tforce_z\n0.25\t700\n0.5\t-1500\n",
        "time\tforce_z\n0,25\t700\n0,5\t-1500\n",
        "time;force_z;note\n0,25;700;a.b\n0,5;-1500;c.d\n",
        "time\tforce_z\tnote\n0.25\t700\ta, b\n0.5\t-1500\tc\n",
        "time, force_z\r\n0.25, 700\r\n0.5, -1500\r\n",
    ],
)
def test_csv_of_other_programs_is_read(text, tmp_path):
    (tmp_path / "log.csv").write_text(text, encoding="utf-8", newline="")
    found = read_columns(tmp_path / "log.csv")
    assert found["time"].tolist() == [0.25, 0.5]
    assert found["force_z"].tolist() == [700.0, -1500.0]


def test_a_fall_is_flagged_in_the_notes(folder, table):
    """The last second without load, as the sensors of a robot on its side."""
    gone = table["time"] > table["time"][-1] - 1.0
    for axis in "xyz":
        table[f"force_{axis}"][gone] = 0.0
    table["zmp_x"][gone] = 0.0  # as some estimators say of no force
    trial = val.judge_log(table, folder, start=0.0, place=(0.0, 0.0))
    assert any("From 4." in note and "the body falls" in note for note in trial.table().notes)
    assert value(trial, "zmp_x_maximum") < 0.01
    assert value(trial, "unsupported_instants") == 400

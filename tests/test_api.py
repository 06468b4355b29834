"""Public API: ``import ampm, validation as val``."""

import json
import re
import sys
from dataclasses import replace
from html import escape
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ampm
import validation as val
from ampm.control.controller import TrackingController
from ampm.exceptions import InputError
from ampm.planners import PeriodicPlanner
from ampm.walk import ControlOutput
from tests.sweep_table import make_table, sweep_of
from validation.cli.app import Status, call
from validation.study.compare.sweeps import compare_sweeps

RUN: dict[str, dict[str, Any]] = {"gait": {"steps": 2}, "solver": {"ik_time_step": 0.01}}
HERE = "tests.test_api"
PUSH = val.Push("chest", (20.0, 0.0, 0.0), at=0.5, duration=0.1)


class Weaker(TrackingController):
    """A controller of a user's own."""

    def update(self, state, touch, reference):
        output = super().update(state, touch, reference)
        return output._replace(torque=0.999 * output.torque)


class Limp:
    """A controller of a user's own that solves no QP and falls."""

    def __init__(self, robot, run):
        self.torque = np.zeros(robot.nu)

    def update(self, state, touch, reference):
        return ControlOutput(self.torque)


class Planner:
    """A planner of a user's own."""

    def plan(self, run, robot):
        return PeriodicPlanner().plan(run, robot)


@pytest.fixture(scope="module")
def trial():
    return val.walk(ampm.load_run("normal", **RUN), disturbances=[PUSH], name="pushed", profile="default")


def test_a_trial_in_memory(trial):
    assert trial.verdict.passed is (trial.verdict.name == "pass")
    assert 0 < trial.metrics["zmp_x_rmse"].value < 0.01
    error = trial.measured.zmp - trial.plan.sample(trial.measured.time).zmp
    assert error.shape == (trial.record.steps, 2)
    assert trial.comparison.record is trial.record
    assert trial.run.gait.steps == RUN["gait"]["steps"]
    assert trial.timing.keys() >= {"planning", "simulation", "measurement", "real_time_factor"}
    assert trial.summary["gait"] == "pushed"


def test_it_is_kept_as_the_command_line_keeps_it(trial, tmp_path):
    folder = trial.save(tmp_path / "run", recording=False)
    with pytest.raises(InputError, match="--force"):
        trial.save(folder)
    saved = val.load(folder)
    assert saved.summary["disturbances"] == [repr(PUSH)]
    assert saved.summary["metrics"].keys() <= trial.metrics.keys()
    np.testing.assert_array_equal(saved.record.torque, trial.record.torque)
    shared: list[Any] = [saved.record.torque_limit, saved.record.point_foot, *saved.signals.columns.values()]
    assert not any(array.flags.writeable for array in shared)
    assert val.replay(folder).identical

    out = tmp_path / "again"
    settings = [f"--set={s}.{k}={v}" for s, table in RUN.items() for k, v in table.items()]
    call(["validate", "normal", *settings, "--push", "chest,20,0,0,0.5,0.1", "--out", str(out)])
    np.testing.assert_array_equal(val.load(out).record.torque, trial.record.torque)


def test_a_controller_and_a_planner_of_ones_own(tmp_path, ampm):
    options = ["--controller", f"{HERE}:Weaker", "--planner", f"{HERE}:Planner", "--out", tmp_path / "a"]
    answer = ampm("validate", "normal", "--steps", "2", *options, "--json")
    assert answer.status in (Status.PASS, Status.OUT_OF_TOLERANCE)
    assert (answer.json["controller"], answer.json["planner"]) == (f"{HERE}:Weaker", "Planner")
    assert val.load(tmp_path / "a").plan() is None  # of another planner


@pytest.mark.slow
def test_a_fall_without_qp_has_its_folder_and_report(tmp_path, ampm):
    settings = ["--set=gait.steps=2", "--set=solver.ik_time_step=0.01", "--out", tmp_path / "a"]
    answer = ampm("validate", "normal", "--controller", f"{HERE}:Limp", *settings)
    assert answer.status == Status.NOT_COMPLETED
    assert "no QP was reported" in answer.out
    assert re.search(r"ZMP, RMS feedback along x +│ +– │", answer.out)
    assert "failed_qp" not in val.load(tmp_path / "a").summary["metrics"]
    assert "no QP" in (tmp_path / "a" / "report.html").read_text(encoding="utf-8")


class Broken:
    """A controller, planner and disturbance of a user's own that do not work."""

    def __init__(self, robot=None, run=None):
        self.robot = robot

    def update(self, state, touch, reference):
        return 1

    def plan(self, run, robot):
        return 1

    def apply(self, time, plant):
        raise KeyError("gusts")


class Slack:
    """A planner whose posture gives what is no state of the body."""

    def __init__(self, change):
        self.change = change

    def plan(self, run, robot):
        plan = PeriodicPlanner().plan(run, robot)
        sample = plan.posture.sample
        posture: Any = SimpleNamespace(sample=lambda times: self.change(sample(times)))
        return replace(plan, posture=posture)


class Late(Limp):
    """A controller that fails in mid-walk."""

    def update(self, state, touch, reference):
        if state.time > 0.05:
            raise KeyError("late")
        return super().update(state, touch, reference)


class Short(Broken):
    """Its torque would be spread over all joints."""

    def update(self, state, touch, reference):
        return ControlOutput(np.zeros(1))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"controller": Broken}, "controller Broken failed .TypeError: it returned .*, not a ControlOutput"),
        ({"controller": Short}, r"controller Short failed .*\(1,\)"),
        ({"controller": lambda: None}, "too many positional arguments; it takes none"),
        ({"controller": lambda robot, run: sys.exit(3)}, "failed .SystemExit: 3"),
        ({"planner": Broken()}, "planner Broken failed .*int"),
        ({"disturbances": [Broken()]}, "disturbance Broken failed .KeyError: 'gusts'"),
        ({"disturbances": PUSH}, "Push.* cannot be the disturbances; give a list"),
        ({"controller": "x"}, "unknown controller.name 'x'; known: ampm, joint-pd; .* MODULE:CLASS"),
        ({"controller": 3}, "3 cannot be the controller; give a class"),
        ({"planner": object}, "cannot be the planner; give an object"),
        ({"planner": Slack(lambda state: None)}, "planner Slack failed .AttributeError"),
        (
            {"planner": Slack(lambda state: state._replace(q=state.q[:, :5]))},
            "'q' of its posture at 0 s must be",
        ),
        ({"planner": Slack(lambda state: state._replace(v=np.nan * state.v))}, "'v' of its posture at 0 s"),
        (
            {"planner": Slack(lambda state: state._replace(trunk=state.q[:, :9]))},
            "trunk of a reference has shape",
        ),
        ({"planner": Slack(lambda state: state._replace(v=state.v[:-1]))}, "v of a reference has shape"),
    ],
)
def test_errors_of_a_users_own_classes_are_one_sentence(options, words):
    with pytest.raises(InputError, match=words) as caught:
        val.walk(ampm.load_run("normal", **RUN), **options)
    assert str(caught.value).count("\n") == 0


def test_a_name_or_one_setting_is_enough():
    assert ampm.plan("flat").contacts == ampm.plan(ampm.load_run("flat")).contacts
    assert ampm.load_run("momentum", "gait.c_y=0.6").gait.c_y == 0.6


@pytest.mark.parametrize("package", [ampm, val])
def test_every_public_name_is_listed_and_there(package):
    assert set(package.__all__) <= set(dir(package))
    assert all(getattr(package, name) is not None for name in package.__all__)


def test_reprs_are_short(trial, tmp_path):
    saved = val.load(trial.save(tmp_path / "run", recording=False))
    assert repr(trial) == f"Trial(pushed, 2 steps, completed, {trial.verdict.name})"
    assert repr(saved).startswith(f"SavedRun({tmp_path / 'run'}: pushed, 2 steps")
    held = (
        trial.record,
        saved.record,
        trial.planned,
        trial.planned.body,
        trial.plan,
        trial.plan.feet,
        trial.plan.posture,
        trial.measured,
        trial.comparison,
        trial.verdict,
        saved.signals,
        ampm.plan("momentum"),
    )
    for value in held:  # one line, however long the arrays
        assert len(repr(value)) < 400
        assert "\n" not in repr(value)
    assert repr(ampm.load_run("normal", gait={"steps": 3})) == "RunParameters(gait={'steps': 3})"
    assert repr(ampm.plan("momentum")).startswith("CentroidalPlan(mass=60, gravity=9.81, com_height=0.865, ")


def test_print_says_what_a_run_a_plan_and_a_trial_are(trial):
    run = "run of 30 steps: planner ampm, body human, controller ampm\n"
    assert str(ampm.load_run("normal")) == run + "  all values are the defaults"
    assert str(ampm.load_run("momentum", body={"mass": 70.0})) == (
        f"{run}"
        "  gait.c_s   1.2       (default 1.0)\n"
        "  gait.c_y   0.4       (default 1.0)\n"
        "  body.mass  70.0  kg  (default 60.0)"
    )
    rows = [{"foot": foot, "x": 0.0, "y": y} for foot, y in (("right", -0.1), ("left", 0.1))]
    assert str(ampm.load_run("normal", footsteps=2 * rows)).startswith("run over 4 footsteps: planner ampm")
    title, *facts = str(ampm.plan("momentum")).splitlines()
    assert title == "CentroidalPlan of 30 steps in 21.59 s"
    assert facts[:3] == [
        "  body            60 kg, COM at 0.865 m",
        "  way of the COM  18 m, 0.8338 m/s on average",
        "  supports        0.599 s single, 0.1206 s double",
    ]
    assert str(trial.plan).startswith("WalkPlan of 2 steps in ")
    title, *metrics = str(trial).splitlines()
    assert title.startswith(f"pushed, 2 steps, completed: {trial.verdict.name.upper()}. ")
    assert title.endswith(trial.verdict.reason)
    zmp = next(item for item in trial.verdict.judged if item.name == "zmp_x_rmse")
    assert re.fullmatch(rf"  ZMP, RMS error along x  +{zmp}, limit 2.5", metrics[0])
    assert len(metrics) == len({"zmp_x_rmse", "zmp_y_rmse"} | {item.name for item in trial.verdict.failed})


def test_notebooks_get_tables(trial, tmp_path):
    run = ampm.load_run("momentum", ["controller.name='a:<b>'"])._repr_html_()
    assert "<tr><td>gait.c_s</td><td>1.2</td><td></td><td>(default 1.0)</td></tr>" in run
    assert "<td>a:&lt;b&gt;</td>" in run
    assert "<td>60 kg, COM at 0.865 m</td>" in ampm.plan("momentum")._repr_html_()
    saved = val.load(trial.save(tmp_path / "run", recording=False))
    for result in (trial, saved):
        text = result._repr_html_()
        assert "ZMP, RMS error along x" in text
        assert escape(trial.verdict.reason) in text
        assert result.table().__html__() in text
    assert "largest torque, of the motor&#x27;s limit" in trial._repr_html_()
    sweep = sweep_of(make_table(20))
    assert "<h3>sweep synthetic</h3>" in sweep._repr_html_()
    text = compare_sweeps(sweep, sweep)._repr_html_()
    assert text.startswith("<p><b>No regression in 20 matched runs")


def test_python_m_ampm_lists_the_keys(capsys):
    assert call(["keys", "--gait", "momentum", "--set", "gait.c_y=0.7", "--json"]) == Status.PASS
    keys = {item["key"]: item for item in json.loads(capsys.readouterr().out)}
    height = keys["gait.com_height"]
    assert (height["unit"], height["bounds"], height["default"]) == ("m", "> 0, <= 100", 0.865)
    assert keys["gait.c_y"]["value"] == 0.7
    assert all(item["meaning"] for item in keys.values())

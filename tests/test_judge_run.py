"""A run or a log judged again from its folder has the verdict that it had, whatever was walked."""

import json
import math
from dataclasses import replace

import pytest

import validation as val
from ampm.exceptions import InputError
from ampm.planners import PeriodicPlanner
from tests.saved_run import make_run
from tests.test_log import signals_of
from validation.judge.profiles import DEFAULT, own_profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import judge_summary
from validation.run.validate import validate
from validation.trial.plan import load_request


class Online:
    """Plans again every 50 ms, the same plan."""

    replan_period = 0.05

    def plan(self, run, robot):
        return PeriodicPlanner().plan(run, robot)

    def replan(self, time, state, touch, plan):
        return replace(plan)


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
    validate(request, folder, own_profile(gait, request.run), recording=False)
    before, again = kept(folder)
    assert before["profile"] == profile
    assert before["metrics"][measured]["value"] is not None
    assert again == before
    assert val.replay(folder).identical
    answer = ampm("judge", folder, "--plan", folder, "--json")
    assert answer.status == (before["verdict"] != "pass")
    assert answer.json == {**before, "directory": str(folder)}
    assert val.judge_run(folder, "wide").summary["profile"] == "wide"


def test_so_is_one_whose_uncertainty_is_known(tmp_path):
    values = {"zmp_x_rmse": 2e-3, "zmp_y_rmse": 1e-5, "zmp_x_maximum": 1e-3}
    known = Uncertainty("normal", 6, values, spreads={"zmp_x_maximum": math.inf})
    folder = make_run(tmp_path / "run", steps=2, uncertainty=known)
    before, again = kept(folder)
    assert before["verdict"] == "undecided"
    assert again == before


def test_so_is_the_log_of_a_treadmill(run_of, tmp_path, ampm):
    plan = run_of("normal", steps=8)
    table = signals_of(plan)
    belt = 0.9
    table |= {name: table[name] - belt * table["time"] for name in ("zmp_x", "com_x")}
    trial = val.judge_log(table | {"belt_speed": belt + 0.0 * table["time"]}, plan)
    assert trial.verdict.passed
    before, again = kept(trial.save(tmp_path / "log", recording=False))
    assert again == before
    for words in (("--start", 0.0), ("--plan", "normal"), ("--strides",)):
        refused = ampm("judge", tmp_path / "log", *words)
        assert refused.status == 2
        assert f"{words[0]} is for a table" in refused.err


def test_a_metric_of_another_process_is_asked_for(tmp_path):
    folder = make_run(tmp_path / "run", steps=2)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    with pytest.raises(InputError, match="metric 'strange' is not known here; register it"):
        judge_summary({**summary, "metrics": {"strange": {}}}, DEFAULT)

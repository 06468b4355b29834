"""Public API: ``import ampm, validation as val``."""

import os
import pickle
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ampm
import validation as val
from tests.solved import Changed
from validation.cli.app import call

RUN: dict[str, dict[str, Any]] = {"gait": {"steps": 2}, "solver": {"ik_time_step": 0.01}}
PUSH = val.Push("chest", (20.0, 0.0, 0.0), at=0.5, duration=0.1)


def walk(**options):
    return val.walk(ampm.load_run("normal", **RUN), **options)


@pytest.fixture(scope="module")
def trial():
    return val.walk(ampm.load_run("normal", **RUN), disturbances=[PUSH], name="pushed").judged("default")


def test_it_is_kept_as_the_command_line_keeps_it(trial, tmp_path):
    assert trial.timing.keys() >= {"planning", "simulation", "measurement", "real_time_factor"}
    begin = trial.measured.time[trial.comparison.inside][0]
    assert begin == pytest.approx(0.5, abs=1e-3)  # of the push, in the first step
    folder = pickle.loads(pickle.dumps(trial)).save(tmp_path / "run", recording=False)
    saved = val.load(folder)
    push = "push of (20, 0, 0) N on chest from 0.5 s for 0.1 s"
    assert (saved.summary["gait"], saved.summary["disturbances"]) == ("pushed", [push])
    assert f"gait pushed, {push}, body human" in val.report(folder).read_text(encoding="utf-8")
    assert saved.summary["metrics"].keys() <= trial.metrics.keys()
    np.testing.assert_array_equal(saved.record.torque, trial.record.torque)
    assert val.replay(folder).identical
    settings = [f"--set={s}.{k}={v}" for s, table in RUN.items() for k, v in table.items()]
    call(["validate", "normal", *settings, "--push=chest,20,0,0,0.5,0.1", "--out", str(tmp_path / "again")])
    np.testing.assert_array_equal(val.load(tmp_path / "again").record.torque, trial.record.torque)


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


def slack(change):
    """A planner whose posture gives what is not a state of the body."""

    def with_posture(plan):
        posture: Any = SimpleNamespace(sample=lambda times: change(plan.posture.sample(times)))
        return replace(plan, posture=posture)

    return Changed(with_posture)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"step_length": 0.4}, "steps of 0.4 m, and gait.step_length is 0.3 m"),
        ({"switching_velocity": 0.52}, "steps of 0.643 s, and those of the gait take 0.54 s"),
    ],
)
def test_steps_that_are_not_the_runs_are_told(change, what):
    trial = val.walk(ampm.load_run("flat", gait={"steps": 2}), planner=Changed(**change))
    note = f"The planner Changed plans {what}."
    assert trial.summary["notes"] == [note]
    assert note in trial.table().notes


class Late:
    """A controller of a user's own, without a QP, that fails in mid-walk."""

    def __init__(self, robot, run):
        os.chdir("/")  # relative paths of the walk itself are not of there
        self.torque = np.zeros(robot.nu)

    def update(self, state, touch, reference):
        if state.time > 0.05:
            raise KeyError("late")
        return ampm.ControlOutput(self.torque)


@pytest.mark.parametrize("package", [ampm, val])
def test_every_public_name_is_listed_and_there(package):
    assert set(package.__all__) <= set(dir(package))
    assert all(getattr(package, name) is not None for name in package.__all__)


def test_whatever_is_held_has_a_short_repr_and_a_table_for_notebooks(trial):
    run, plan = ampm.load_run("momentum"), ampm.plan("momentum")
    held = [trial.record, trial.planned, trial.planned.body, trial.plan, trial.plan.feet, trial.plan.posture]
    held += [trial.measured, trial.comparison, trial.verdict, plan]
    for value in (trial, run, *held):  # one line, however long the arrays
        assert len(repr(value)) < 400
        assert "\n" not in repr(value)
    assert trial.table().__html__() in trial._repr_html_()

"""Controllers by name, without a QP, in sweeps and side by side."""

from functools import partial
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import ampm
import validation as val
from ampm import ControlOutput, InputError, TrackingController
from docs.examples import tsid_controller
from docs.examples.joint_pd import JointPD
from tests.solved import QUICK
from tests.test_bad_input import assert_said, rows_of
from validation.store.record import load_record
from validation.trial import users
from validation.trial.users import CONTROLLER

JOINT_PD = "docs.examples.joint_pd:JointPD"
SETTINGS = ["--steps=2", "--set=solver.ik_time_step=0.01", "--set=simulation.time_step=0.002"]


@pytest.fixture
def installed(monkeypatch):
    """A package that adds the controller ``simple``, and one whose module is missing."""
    points = [
        EntryPoint("simple", JOINT_PD, "ampm.controllers"),
        EntryPoint("broken", "no_such_module:Controller", "ampm.controllers"),
    ]
    monkeypatch.setattr(users, "entry_points", lambda group: [p for p in points if p.group == group])


def test_a_controller_has_one_name_wherever_it_comes_from(installed):
    assert CONTROLLER.find("ampm") is TrackingController
    assert CONTROLLER.find("simple") is CONTROLLER.find(JOINT_PD) is JointPD
    assert CONTROLLER.name_of(JointPD) == JOINT_PD
    with pytest.raises(InputError, match="no_such_module:Controller' cannot be imported"):
        CONTROLLER.find("broken")
    assert users.load_object("--metric", "docs.examples.joint_pd:JointPD.update") is JointPD.update


def test_tsid_walks_on_flat_feet():
    if tsid_controller.tsid is None:
        pytest.skip("needs the extra tsid, in an environment of its own: pip install -e '.[tsid]'")
    run = ampm.load_run("flat", gait={"steps": 3}, simulation={"time_step": 0.001})
    trial = val.walk(run, controller=tsid_controller.TsidController)
    assert trial.record.outcome.name == "completed"
    limits = {"failed_qp": 0, "zmp_x_rmse": 2e-3, "zmp_y_rmse": 1.5e-3, "angular_momentum_y_rmse": 0.05}
    for name, limit in limits.items():
        assert trial.metrics[name].value <= limit, name
    planned = trial.planned.plan.sample(trial.record.time[:-1]).zmp
    assert np.sqrt(np.mean((trial.record.command_zmp - planned) ** 2)) < 2e-3


def test_the_template_walks():
    changes = {"simulation.time_step": 0.002, "gait.steps": 4, "controller.options.resolution": 0.05}
    run = ampm.load_run("normal").replace(changes)
    trial = val.walk(run, controller="docs.examples.controller_template:MyController")
    assert trial.verdict.passed, trial.verdict.reason
    steps = trial.record.torque[0] / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


@pytest.mark.parametrize("row", rows_of("output"))
def test_torques_that_cannot_be_applied_end_the_walk_and_keep_its_record(row):
    class Spoilt(JointPD):
        def update(self, state, touch, reference):
            output = super().update(state, touch, reference)
            if state.time < 0.01:
                return output
            fields = output._asdict()
            exec(row["input"], {"np": np}, fields)
            return output._replace(**fields)

    trial = val.walk(ampm.load_run("normal", **QUICK), controller=Spoilt)
    assert trial.record.outcome.name == "crashed"
    assert_said(trial.record.outcome.cause, f"controller | Spoilt failed | {row['words']}")
    assert trial.record.steps == 5
    assert not trial.verdict.passed


def test_the_record_keeps_the_reference_that_a_controller_followed():
    class Elsewhere(TrackingController):
        def update(self, state, touch, reference):
            output = super().update(state, touch, reference)
            return output._replace(reference=reference.replace(com=reference.com + 0.01))

    run = ampm.load_run("normal", **QUICK)
    record, plain = (val.walk(run, controller=it).record for it in (Elsewhere, None))
    np.testing.assert_array_equal(record.command_com, plain.command_com + 0.01)

    class Limp(Elsewhere):
        def update(self, state, touch, reference):
            output = super().update(state, touch, reference)
            fallen = reference.replace(
                com=np.array(state.q[:3]), foot_position=np.array([state.q[:3]] * 2) - 0.8
            )
            return output._replace(torque=0.0 * output.torque, rate=None, reference=fallen)

    assert val.walk(run, controller=Limp).record.outcome.name == "fell"
    np.testing.assert_array_equal(record.q, plain.q)


def test_a_crash_in_mid_walk_keeps_the_run(ampm, tmp_path, caplog):
    words = [*SETTINGS, "--controller", "tests.test_api:Late", "--out", tmp_path / "run"]
    answer = ampm("validate", "normal", *words, "--json", "--debug")
    assert answer.status == 3
    assert answer.json["outcome"] == "crashed"
    assert "Late failed (KeyError: 'late')" in answer.json["end"]["cause"]
    assert 'raise KeyError("late")' in caplog.text
    assert load_record(tmp_path / "run").steps == 26


class Ramp:
    """Gives the same torque and rate at every tick."""

    def __init__(self, robot, run, rate):
        self.torque = 0.98 * robot.torque_limit
        self.rate = None if rate is None else np.full(robot.nu, rate)

    def update(self, state, touch, reference):
        return ControlOutput(self.torque, rate=self.rate)


def above_limits(rate):
    """Torques of the first milliseconds over 98 % of the motors' limits, four steps a tick; the other 2 %."""
    record = val.walk(ampm.load_run("normal", gait={"steps": 1}), controller=partial(Ramp, rate=rate)).record
    assert record.controller == f"{__name__}:<partial Ramp>"
    return record.torque[:8] - 0.98 * record.torque_limit, 0.02 * record.torque_limit


def test_the_torque_goes_on_with_its_rate_within_the_limits():
    above, room = above_limits(1e3)
    since = np.array([0.0, 1.0, 2.0, 3.0] * 2)[:, None] * 0.0005  # since the tick [s]
    np.testing.assert_allclose(above, np.minimum(1e3 * since, room), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(above_limits(None)[0], 0.0, rtol=0.0, atol=1e-9)

"""A walk without a plan: the body begins standing, is asked for a velocity, and is judged by its record."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import validation as val
from ampm import ControlOutput, load_run
from validation.judge.metrics import METRICS
from validation.run.judge_log import judge_run
from validation.trial.record import heading_velocity, measured_supports

QUICK = ("--planner", "none", "--set", "simulation.time_step=2e-3", "--set", "command.duration=2")


def test_with_the_projects_controller_a_body_stands(ampm, tmp_path):
    (gait := tmp_path / "up.toml").write_text("[gait]\nslope = 0.05\n[drake]\nstiffness = 2e5\n")
    more = ("--steps", 4, "--out", tmp_path / "run", "--json", "--set", "sensors.stand=1")
    slope = ("--body", "suite-humanoid", "--set", "disturbance.slope_across=0.02", "--set", "body.lean=0.1")
    answer = ampm("validate", gait, *slope, *QUICK, *more, "--set", "controller.stabilizer=stepping")
    assert answer.status == 0
    assert "planner none does not use: body.lean, gait.slope, gait.steps" in answer.err
    idle = ("exact does not use: sensors.stand", "mujoco does not use: drake", "none does not use: control")
    assert [keys for keys in idle if keys not in answer.err] == []
    summary = answer.json
    assert (summary["profile"], summary["verdict"], summary["steps_completed"]) == ("free", "pass", 0)
    assert summary["metrics"]["velocity_x_error"]["pass"]
    assert "zmp_x_rmse" not in summary["metrics"]
    np.testing.assert_allclose(summary["velocity"]["measured"], 0.0, atol=1e-6)
    page = (tmp_path / "run/report.html").read_text()
    assert page.count("<dd>(0, 0) m/s, 0 rad/s</dd>") == page.count("over measured footprints") == 2
    said = "Commanded and measured velocity", "Right joints get the values of the left: right_hip_y low"
    assert [text for text in said if text not in page] == []
    assert [text for text in ("error, plan and measurement", "from the planned") if text in page] == []
    assert (tmp_path / "run/recording.rrd").is_file()
    assert ampm("replay", tmp_path / "run").status == 0
    reasons = {judge_run(tmp_path / "run", profile).summary["reason"] for profile in ("default", "strict")}
    assert reasons == {"The walk has no plan: judge it by the profile free."}
    assert val.walk(tmp_path / "run/run.toml").summary["metrics"] == summary["metrics"]
    assert ampm("plan", *QUICK).out == "planner none has no plan: the trial starts with the body standing.\n"


class Limp:
    """Asks what it is asked for, and lets the body fall."""

    asked: tuple[Any, ...] = ()

    def __init__(self, robot, run):
        self.torque, self.command = np.zeros(robot.nu), run.command

    def update(self, state, touch, reference):
        type(self).asked += (self.command.at(state.time),)
        return ControlOutput(self.torque)


def test_a_controller_reads_its_command_and_a_fall_is_told_without_a_plan():
    command = {"vx": 0.4, "wz": -0.2, "settling": 0.1, "duration": 2}
    run = load_run(simulation={"time_step": 0.002}, command=command)
    trial = val.walk(run, controller=Limp, planner="none")
    assert set(Limp.asked[:49]) == {(0.0, 0.0, 0.0)}
    assert set(Limp.asked[51:]) == {(0.4, 0.0, -0.2)}
    assert trial.record.outcome.cause.startswith("the COM sank to 0.70 m over the soles at 0.2")
    assert "off the plan" not in trial.record.outcome.cause
    assert trial.verdict.name == "not_measured"
    assert np.isnan(trial.comparison.sample.zmp).all()


def test_steps_and_velocity_are_found_in_the_record():
    down = np.ones((1000, 2), dtype=bool)
    down[100:300, 0] = down[400:600, 1] = down[700:710, 0] = False  # two swings and a bounce
    heading = 0.001 * np.arange(1001)
    q = np.zeros((1001, 7))
    q[:, 3], q[:, 6] = np.cos(0.5 * heading), np.sin(0.5 * heading)
    com = np.column_stack([np.sin(heading), 1.0 - np.cos(heading), np.ones(1001)]) / 0.5  # a circle at 1 m/s
    force = np.zeros((1000, 2, 3))
    force[:, :, 2] = 300.0 * down
    record: Any = SimpleNamespace(point_force=force, point_foot=np.arange(2), time_step=0.002, q=q, com=com)
    stance, steps = measured_supports(record)
    assert steps == 2
    assert [int(stance[k]) for k in (50, 200, 350, 500, 705)] == [2, 1, 2, 0, 2]
    assert heading_velocity(record).mean(axis=0) == pytest.approx([1.0, 0.0, 0.5], abs=1e-3)


@pytest.mark.parametrize("part", ["vy", "wz"])
@pytest.mark.parametrize(("asked", "steps", "want"), [(0.6, 0, 1), (0.6, 1, 0), (-0.2, 0, np.nan), (0, 0, 0)])
def test_a_commanded_way_asks_for_a_step(part, asked, steps, want):
    plan = SimpleNamespace(command=standing(command={part: asked, "duration": 2.0}).command)
    record = SimpleNamespace(outcome=SimpleNamespace(steps_completed=steps))
    walk: Any = SimpleNamespace(plan=plan, record=record, scales={"foot_length": 0.25})
    assert METRICS["steps_missing"].compute(walk) == pytest.approx(want, nan_ok=True)


def standing(**sections):
    return load_run(gait={"planner": "none"}, simulation={"time_step": 0.002}, **sections)


def test_a_sweep_takes_it(ampm, tmp_path):
    (tmp_path / "sweep.toml").write_text(
        '[sweep]\ngait = "normal"\nprofile = "free"\nrecordings = "none"\n[set]\ngait.planner = "none"\n'
        "simulation.time_step = 0.002\ncommand.duration = 1.5\n"
        '[[vary]]\nmethod = "grid"\ncommand.vx = [0.0, 0.5]\n'
    )
    swept = ampm("sweep", tmp_path / "sweep.toml", "--out", tmp_path / "sweep", "--workers", 0)
    assert swept.status == 1, swept.err
    assert "follows no command: it stands" in ampm("plan", *QUICK, "--command", "0.5,0,0").err
    rows = val.sweep(tmp_path / "sweep.toml", out=tmp_path / "sweep", resume=True).table.to_pylist()
    assert [row["verdict"] for row in rows] == ["pass", "fail"]
    assert rows[1]["metric_velocity_x_error"] == pytest.approx(0.5, abs=1e-6)

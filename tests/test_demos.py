"""The paper's demos, walked: what their presets promise, in plan and in physics."""

import json

import numpy as np
import pytest

from ampm.planner.periodic import plan_gait
from ampm.presets import preset_names
from ampm.run_file import load_run
from validation.judge.profiles import own_profile
from validation.store.signals import load_signals


def swing(folder, source, axis="x"):
    """Peak to peak of an angular momentum after the first step [N m s]."""
    signals = load_signals(folder / "signals.parquet")
    values = signals[f"{source}_angular_momentum_{axis}"]
    return float(np.ptp(values[len(values) // 3 :]))


@pytest.mark.slow
def test_e12_angular_momentum_falls_with_c_y_in_physics(run_of):
    most, least = run_of("roll-0.1", steps=5), run_of("roll-0.7", steps=5)
    assert swing(most, "measured") > 3.0 * swing(least, "measured") > 3.0
    for folder in (most, least):
        assert swing(folder, "measured") == pytest.approx(swing(folder, "plan"), rel=0.05)


def test_the_pitch_demos_turn_the_body_in_opposite_senses(run_of):
    """Past mid-stance the weight's lever is -(c_s - 1) x: forward for c_s < 1, backward for c_s > 1."""
    for name, sign in (("pitch", -1.0), ("pitch-low", 1.0)):
        plan = plan_gait(load_run(name).gait, 60.0)
        end = plan.constants.single_support_duration
        moment = plan.sample([0.9 * end]).moment[0, 1]
        assert sign * moment > 30.0
    folder = run_of("pitch-low", steps=4)
    assert swing(folder, "measured", "y") == pytest.approx(swing(folder, "plan", "y"), rel=0.1)
    assert swing(folder, "plan", "y") > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("name", preset_names())
def test_every_preset_walks_thirty_steps_within_its_profile(name, run_of):
    summary = json.loads((run_of(name, steps=30) / "summary.json").read_text(encoding="utf-8"))
    assert summary["outcome"] == "completed"
    assert summary["steps_completed"] == 30
    judged = [item for item in own_profile(name).tolerances if item.metric in summary["metrics"]]
    assert len(judged) == 18  # all but the joint rates, which the human does not limit
    for tolerance in judged:
        value = summary["metrics"][tolerance.metric]["value"]
        assert value <= tolerance.limit_for(summary["scales"]), tolerance.metric

"""Real runs keep to their plans; figures are taken from ``signals.parquet``, not from the verdict.

Row k is held against the plan at t_k, the first step left out, nothing shifted, fitted or masked.
"""

import json

import numpy as np
import pytest

from ampm.presets import preset_names
from ampm.run_file import load_run
from validation.judge.profiles import own_profile
from validation.store.signals import load_signals

SLOPES = {"c_y": (0.2, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2), "c_s": (0.8, 0.9, 1.1, 1.3, 1.4)}
"""Of the force line: other ones of ``normal``, which take twice the limits."""
WALKS = [
    *((name, {}, 30) for name in preset_names()),
    *(("normal", {f"gait.{key}": value}, 30) for key, values in SLOPES.items() for value in values),
    ("normal", {}, 200),
    ("momentum", {}, 200),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "settings", "steps"), WALKS, ids=str)
def test_long_walks_keep_within_their_profile(run_of, name, settings, steps):
    summary = json.loads((run_of(name, settings, steps=steps) / "summary.json").read_text(encoding="utf-8"))
    assert (summary["outcome"], summary["steps_completed"]) == ("completed", steps)
    assert summary["solver"]["unsolved"] == 0
    judged = [item for item in own_profile(name).tolerances if item.metric in summary["metrics"]]
    assert len(judged) == 18  # all but the joint rates, which the human does not limit
    for tolerance in judged:
        limit = tolerance.limit_for(summary["scales"]) * (2.0 if settings else 1.0)
        assert summary["metrics"][tolerance.metric]["value"] <= limit, tolerance.metric


@pytest.mark.parametrize(("gait", "least", "most"), [("normal", 0.0, 1.0), ("momentum", 10.0, np.inf)])
def test_verdict_causes_and_measurement_are_those_of_the_signals(run_of, gait, least, most):
    folder = run_of(gait)
    summary = json.loads((folder / "summary.json").read_text())
    signals, run = load_signals(folder / "signals.parquet"), load_run(folder / "run.toml")
    rows = signals["time"] >= signals["time"][-1] / run.gait.steps + run.simulation.time_step
    assert summary["verdict"] == "pass"
    for axis in "xy":
        measured = signals[f"measured_zmp_{axis}"][rows]
        error = measured - signals[f"plan_zmp_{axis}"][rows]
        judged = summary["metrics"][f"zmp_{axis}_rmse"]["value"]
        assert judged == pytest.approx(rms(error), rel=0.02)
        parts = [n for n in signals.columns if n.startswith("zmp_error_") and n.endswith(f"_{axis}")]
        total = sum(signals[name][rows] for name in parts)
        np.testing.assert_allclose(total, error, rtol=0.0, atol=1e-9)
        assert rms(measured - signals[f"measured_zmp_momentum_{axis}"][rows]) < 0.5e-3
    # Normal walks almost without L_x, momentum with several N m s: both are measured, not assumed.
    assert least <= np.ptp(signals["measured_angular_momentum_x"]) < most


def rms(error):
    return float(np.sqrt(np.mean(error**2)))

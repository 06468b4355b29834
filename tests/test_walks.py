"""The walks of walks.csv end as they should: floors, engines, stabilisers, estimators and planners.

A row a walk: gait, settings, footsteps and planner; its outcome or verdict; upper bounds of metrics.
"""

import csv
import json
from pathlib import Path

import pytest

import ampm
import validation as val
from ampm.planner import routes
from ampm.presets import preset_names
from validation.judge.profiles import own_profile

with Path(__file__).with_name("walks.csv").open(encoding="utf-8", newline="") as file:
    ROWS = list(csv.DictReader(file))


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, marks=[pytest.mark.slow] * ("pushed by" in row["name"]), id=row["name"])
        for row in ROWS
    ],
)
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP, in planners that go on planning
def test_a_walk_ends_as_it_should(row):
    if "engine=drake" in row["settings"]:
        pytest.importorskip("pydrake", reason="pip install 'ampm-testbed[drake]'")
    run = ampm.load_run(row["gait"], row["settings"].split())
    route, *numbers = row["footsteps"].split() or [""]
    footsteps = getattr(routes, route)(int(numbers[0]), *map(float, numbers[1:])) if route else None
    trial = val.walk(run.as_is(), footsteps=footsteps, planner=row["planner"] or None)
    assert row["ends"] in (trial.record.outcome.name, trial.verdict.name), trial.sentence
    for bound in row["most"].split():
        name, most = bound.split("=")
        assert trial.metrics[name].value < float(most), name


SLOPES = {"c_y": (0.2, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2), "c_s": (0.8, 0.9, 1.1, 1.3, 1.4)}
"""Parameters of the force line; one of them is changed in ``normal``."""
LONG = [
    *((name, {}, 30) for name in preset_names()),
    *(("normal", {f"gait.{key}": value}, 30) for key, values in SLOPES.items() for value in values),
    *((name, {}, 200) for name in ("normal", "momentum")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "settings", "steps"), LONG, ids=str)
def test_long_walks_keep_within_their_profile(run_of, name, settings, steps):
    summary = json.loads((run_of(name, settings, steps=steps) / "summary.json").read_text(encoding="utf-8"))
    assert (summary["outcome"], summary["steps_completed"]) == ("completed", steps)
    assert summary["solver"]["unsolved"] == 0
    for tolerance in own_profile(name, ampm.load_run(name)).tolerances:
        # No joint has a limit of speed, nothing is commanded, and a log's strides alone have a mean.
        if tolerance.metric.startswith(("speed_", "velocity_", "yaw_", "stride_")):
            continue
        limit = tolerance.limit_for(summary["scales"])
        assert summary["metrics"][tolerance.metric]["value"] <= limit, tolerance.metric

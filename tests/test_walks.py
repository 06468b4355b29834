"""The walks of walks.csv end as they should: floors, engines, stabilisers, estimators and planners.

A row a walk: gait, settings, footsteps and planner; its outcome or verdict; upper bounds of metrics.
"""

import csv
from pathlib import Path

import pytest

import ampm
import validation as val
from ampm.planner import routes

with Path(__file__).with_name("walks.csv").open(encoding="utf-8", newline="") as file:
    ROWS = list(csv.DictReader(file))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["name"])
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

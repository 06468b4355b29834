"""A metric of one entry appears in profile, verdict, report, sweep, diff and comparison by itself.

That it appears in a convergence study, too, is in test_convergence.
"""

import json
import math
import sys
from dataclasses import replace

import cloudpickle
import pytest

from ampm.exceptions import InputError
from tests.saved_run import make_run
from tests.test_verdict import compared, named, verdict_of
from tests.walk import perfect_walk
from validation.cli.app import call
from validation.judge.metrics import (
    METRICS,
    Metric,
    add_metrics,
    added_metrics,
    evaluate,
    register,
    unregister,
)
from validation.judge.profiles import DEFAULT, STRICT, WIDE
from validation.judge.verdict import build_summary
from validation.show.report import render
from validation.store.saved import load_saved_run


@pytest.fixture
def drop():
    entry = Metric(
        name="com_drop",
        unit="m",
        label="COM, lowest below the plan",
        meaning="largest distance of the COM below its planned height",
        kind="walk",
        compute=lambda walk: float((walk.sample.com - walk.measured.com)[walk.inside, 2].max()),
        tolerances={"default": 0.01},
        reason="More is visible.",
        by_window=True,
    )
    yield register(entry)
    unregister(entry.name)


def test_profiles_verdict_summary_and_worker_processes(drop):
    assert [item.tolerances[-1].limit for item in (DEFAULT, STRICT, WIDE)] == [0.01, 0.01, 0.02]
    comparison = compared(perfect_walk(), com_shift=(0.0, 0.0, -0.015))
    verdict = verdict_of(comparison, DEFAULT)
    assert drop.name in [item.name for item in verdict.failed]
    entry = build_summary(comparison, verdict)["metrics"][drop.name]
    assert (entry["value"], entry["first_step"]) == (pytest.approx(0.015), pytest.approx(0.015))
    assert entry["display"]["tolerance"] == 10.0
    assert verdict_of(comparison, WIDE).passed
    data = cloudpickle.dumps(added_metrics())
    unregister(drop.name)
    add_metrics(cloudpickle.loads(data))  # as in a worker process
    add_metrics(cloudpickle.loads(data))
    assert METRICS[drop.name].compute(comparison) == pytest.approx(0.015)


@pytest.mark.slow
def test_report_also_of_a_process_that_does_not_know_the_metric(drop, tmp_path):
    folder = make_run(tmp_path / "run")
    assert drop.label in render(load_saved_run(folder))
    unregister(drop.name)
    try:
        assert drop.label in render(load_saved_run(folder))
    finally:
        register(drop)


def test_comparison(drop, tmp_path, capsys):
    folder = str(make_run(tmp_path / "run"))
    assert call(["compare", folder, folder, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["quantities"][drop.name]["label"] == drop.label


def test_one_that_fails_names_itself_and_one_without_an_instant_is_not_measured(drop):
    assert math.isnan(named(verdict_of(compared(perfect_walk(count=40)), DEFAULT), drop.name).value)
    for change in ({"compute": lambda walk: walk.nonsense}, {"compute": sys.exit}, {"scales": ("none",)}):
        register(replace(drop, name="broken", **change))
        try:
            with pytest.raises(InputError, match="broken"):
                evaluate(compared(perfect_walk()))
        finally:
            unregister("broken")


@pytest.mark.parametrize(
    ("change", "why"),
    [({}, "exists"), ({"name": "a b"}, "identifier"), ({"name": "new", "reason": ""}, "reason"),
     ({"kind": "foo"}, "instrument"),
     *(({"tolerances": {"default": limit}}, "give a number") for limit in (math.nan, "0.01"))],
)  # fmt: skip
def test_one_that_cannot_be_is_refused(drop, change, why):
    with pytest.raises(InputError, match=why):
        register(replace(drop, **change))
    with pytest.raises(InputError, match=drop.name):
        unregister("zmp_x_rmse")

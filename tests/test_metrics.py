"""A metric of one entry appears in profile, verdict, report, sweep, diff and comparison by itself.

That it appears in a convergence study, too, is in test_convergence.
"""

import math
import re
from dataclasses import replace

import cloudpickle
import numpy as np
import pytest

import validation as val
from tests.saved_run import make_run
from tests.sweep_table import make_table, sweep_of
from tests.test_verdict import compared, verdict_of
from tests.walk import perfect_walk
from validation.judge.metrics import METRICS, added_metrics, evaluate, register, set_metrics, unregister
from validation.judge.profiles import DEFAULT, JUMPS, STRICT
from validation.judge.verdict import build_summary
from validation.study.sweep.report import sweep_metric_table

DROP = val.Metric(
    name="com_drop",
    unit="m",
    label="COM, lowest below the plan",
    meaning="largest distance of the COM below its planned height",
    kind="walk",
    compute=lambda walk: float((walk.sample.com - walk.measured.com)[walk.inside, 2].max()),
    tolerances={"default": 0.01, "jumps": 0.02},
    reason="More is visible.",
)


@pytest.fixture
def drop():
    """A metric, which is gone after the test with all others that it registers."""
    yield register(DROP)
    for metric in added_metrics():
        unregister(metric.name)


def test_profiles_verdict_summary_and_worker_processes(drop):
    assert [item.tolerances[drop.name].limit for item in (DEFAULT, STRICT, JUMPS)] == [0.01, 0.01, 0.02]
    comparison = compared(perfect_walk(), com_shift=(0.0, 0.0, -0.015))
    verdict = verdict_of(comparison, DEFAULT)
    assert drop.name in [item.name for item in verdict.failed]
    entry = build_summary(comparison, verdict)["metrics"][drop.name]
    assert entry["value"] == pytest.approx(0.015)
    assert entry["display"]["tolerance"] == 10.0
    assert verdict_of(comparison, JUMPS).passed
    data = cloudpickle.dumps(added_metrics())
    unregister(drop.name)
    for _ in range(2):  # as in a worker process, which may have others of earlier runs
        set_metrics(cloudpickle.loads(data))
        assert [metric.name for metric in added_metrics()] == [drop.name]
        register(replace(drop, name="other", label=""))
    unregister("other")
    register(replace(drop, name="other", label="", tolerances={"default": -0.0}))
    assert verdict_of(comparison, DEFAULT).reason.endswith("other: 15 mm, limit 0.")


def test_every_metric_has_a_readable_name_of_its_own_and_its_facts(drop):
    labels = [item.label for item in METRICS.values()]
    assert len(set(labels)) == len(labels)
    assert not [label for label in labels if "_" in label]
    assert replace(drop, label="").label == "com drop"
    assert all(item.unit and item.meaning for item in METRICS.values())
    assert all(item.reason.endswith(".") for item in METRICS.values() if item.tolerances)


def test_tables_keep_the_readable_name_and_no_process_without_the_metric_explains(drop, tmp_path, ampm):
    table, folder = sweep_of(make_table(20)), make_run(tmp_path / "run")
    assert ampm("compare", folder, folder, "--json").json["metrics"][drop.name]["label"] == drop.label
    unregister(drop.name)
    assert [row[0] for row in sweep_metric_table(table).rows].count(drop.label) == 1
    assert f"metrics not known here: {drop.name};" in ampm("explain", folder).err


def test_a_metric_that_a_run_lacks_or_no_profile_judges_is_refused(drop, tmp_path, ampm):
    folder = make_run(tmp_path / "run")
    limits = dict(drop.tolerances)
    register(replace(drop, name="later", tolerances=limits))
    assert "has no values of later; walk it again with --metric." in ampm("explain", folder).err
    limits["defualt"] = 1.0
    assert ampm("validate").err.startswith("ampm: unknown profile for a limit of 'later': 'defualt'; did")


NO_NUMBERS = (None, "1", 1j, [1.0], np.zeros(3), -math.inf)


@pytest.mark.parametrize(
    ("compute", "why"),
    [
        (lambda walk: walk.nonsense, "AttributeError"),
        (lambda walk: walk.signals["zmp_x"].clear(), "AttributeError"),  # what is judged stays
        (lambda walk: walk.measured.zmp.fill(0.0), "ValueError: .* read-only"),
        (lambda walk: (_ for _ in ()).throw(GeneratorExit), "GeneratorExit"),  # as a panic of Rust
        *((lambda walk, value=value: value, "TypeError: it returned .* not a") for value in NO_NUMBERS),
    ],
)
def test_one_that_fails_or_returns_no_number_is_not_measured_and_names_itself(drop, caplog, compute, why):
    register(replace(drop, name="own", compute=compute))
    assert math.isnan(evaluate(compared(perfect_walk(count=40)))[drop.name])  # without an instant
    values = evaluate(compared(perfect_walk()))
    assert math.isnan(values["own"])
    assert values["zmp_x_rmse"] < 1e-12
    assert re.match(f"metric 'own' is not measured .{why}", caplog.messages[-1])

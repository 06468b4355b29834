"""Two canned sweeps compared: regressions are found, noise does not count, and runs find their partners."""

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.sweep_table import make_table, replaced, write_sweep
from validation.judge.uncertainty import ABSOLUTE_FLOOR
from validation.study.compare.report import REPORT
from validation.study.compare.sweeps import compare_sweeps
from validation.study.sweep.table import METRIC, SweepTable

LIMITS = {"zmp_x_rmse": 2.5e-3, "zmp_y_rmse": 1.5e-3, "failed_qp": 0.0}
GRID = {"gait.c_y": [round(0.5 + 0.05 * run, 2) for run in range(10)]}
METRICS = {
    "zmp_x_rmse": 1e-3 + 1e-5 * np.arange(10),
    "zmp_y_rmse": np.full(10, 5e-4),
    "failed_qp": np.zeros(10),
}


def table(**changes) -> pa.Table:
    """Ten completed runs; ``zmp_x_rmse=[...]`` replaces the first values of a column."""
    found = make_table(grid=GRID, failures=False)
    found = replaced(found, "verdict", ["pass"] * 10)
    for name, values in {**METRICS, **changes}.items():
        key = name if name in found.column_names else METRIC + name
        found = replaced(found, key, [*values, *(METRICS.get(name, found[key].to_pylist()))[len(values) :]])
    return found


def sweep(name: str = "A", rows: slice = slice(None), **changes) -> SweepTable:
    return SweepTable(table(**changes).take(np.arange(10)[rows]), None, name)


def kinds(*sides) -> list[str]:
    return [row[0] for row in compare_sweeps(*sides).changes.rows]


def test_equal_sweeps_have_no_difference_in_any_order():
    found = compare_sweeps(sweep(), sweep("B", slice(None, None, -1)))
    assert found.sentence == "No regression in 10 matched runs."
    assert not found.changes.notes


def test_equal_runs_of_a_sweep_are_matched_one_by_one():
    alike = SweepTable(replaced(table(), "gait.c_y", [0.5] * 10), None, "A")
    assert compare_sweeps(alike, alike).sentence == "No regression in 10 matched runs."


@pytest.mark.parametrize("factor", [1.0 + 1e-10, 1.0 - 5e-7])
def test_rounding_is_no_difference(factor):
    other = sweep("B", zmp_x_rmse=[1e-3 * factor], failed_qp=[0.1 * ABSOLUTE_FLOOR["1"]])
    assert kinds(sweep(), other) == []


def test_growth_is_a_regression_beyond_the_share_of_the_limit_that_is_allowed():
    grown = sweep("B", zmp_x_rmse=[1e-3 + 0.15 * LIMITS["zmp_x_rmse"]])
    assert kinds(sweep(), grown) == ["worse"]
    assert kinds(sweep(), sweep("B", zmp_x_rmse=[1e-3 + 0.09 * LIMITS["zmp_x_rmse"]])) == []
    assert compare_sweeps(sweep(), grown).sentence == "Regression in 10 matched runs: 1 worse."
    assert compare_sweeps(grown, sweep()).sentence == "No regression in 10 matched runs."
    assert kinds(sweep(), sweep("B", failed_qp=[1.0])) == ["worse"]  # its limit is 0


def test_a_lost_value_is_a_regression_and_a_found_one_is_none():
    lost = sweep("B", zmp_x_rmse=[None, float("inf")])
    assert kinds(sweep(), lost) == ["worse"] * 2
    assert kinds(lost, sweep()) == []


@pytest.mark.parametrize(
    ("before", "after", "kind"),
    [
        (("completed", "pass"), ("fell", "not_measured"), ["newly failing"]),
        (("completed", "pass"), ("refused", None), ["newly failing"]),
        (("completed", "pass"), ("timed_out", None), ["newly failing"]),
        (("completed", "fail"), ("fell", "not_measured"), ["worse"]),
        (("fell", "not_measured"), ("diverged", "not_measured"), []),
        (("fell", "not_measured"), ("completed", "pass"), []),
        (("crashed", None), ("completed", "fail"), []),
    ],
)
def test_outcomes(before, after, kind):
    sides = (sweep(name, outcome=[end[0]], verdict=[end[1]]) for name, end in (("A", before), ("B", after)))
    found = compare_sweeps(*sides)
    assert [row[0] for row in found.changes.rows] == kind
    assert bool(found.counts) == bool(kind)


def test_a_step_across_the_limit_counts_only_beyond_noise():
    limit = LIMITS["zmp_y_rmse"]
    below, above, far = (
        sweep("B", zmp_y_rmse=[value], verdict=[verdict])
        for value, verdict in (
            (limit * (1 - 1e-8), "pass"),
            (limit * (1 + 1e-8), "fail"),
            (2 * limit, "fail"),
        )
    )
    assert kinds(below, above) == kinds(above, below) == []
    (row,) = compare_sweeps(sweep(), far).changes.rows
    assert row == ("newly failing", "0", "pass", "out of tolerance", "ZMP, RMS error along y", "gait.c_y 0.5")
    assert kinds(far, sweep()) == []
    other_verdict = sweep("B", verdict=["fail"])  # without another metric
    assert kinds(sweep(), other_verdict) == ["newly failing"]


def test_missing_runs_are_regressions():
    found = compare_sweeps(sweep(), sweep("B", slice(2, None)))
    assert found.sentence == "Regression in 8 matched runs: 2 missing."
    assert found.counts == {"missing": 2}
    assert not compare_sweeps(sweep("A", slice(2, None)), sweep("B")).counts


def test_a_parameter_that_was_changed_for_all_runs_is_noted():
    heavy: dict[str, Any] = {"key": [f"h{n}" for n in range(10)], "body.mass": [70.0] * 10}
    found = compare_sweeps(sweep(), sweep("B", **heavy))
    assert found.matched == 10
    assert found.changes.notes == ("body.mass is 60.0 in all runs of A, 70.0 in those of B",)


def test_command_line(tmp_path, ampm):
    a = write_sweep(tmp_path / "a", table())
    b = write_sweep(tmp_path / "b", table(zmp_y_rmse=[2e-3], verdict=["fail"]))
    out = tmp_path / "both"
    found = ampm("compare", a, b, "--out", out)
    assert found.status == 1
    assert found.out.splitlines()[0] == "Regression in 10 matched runs: 1 newly failing."
    assert "newly failing" in (out / REPORT).read_text(encoding="utf-8")
    assert "compares two sweeps" in ampm("report", out).err
    assert ampm("compare", a, b, "--json").json["counts"]["newly failing"] == 1
    assert [ampm("compare", *pair).status for pair in ((b, a), (a, a))] == [0, 0]
    assert ampm("compare", a, b, "--uncertainty", out).status == 2

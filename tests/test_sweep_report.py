"""A sweep's page is true to its table and self-contained; two sweeps compared show what got worse.

Noise does not count, and runs find their partners.
"""

import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.sweep_table import make_table, replaced, sweep_of, write_sweep
from tests.test_report import Page, assert_self_contained
from validation.cli.app import call
from validation.judge.uncertainty import ABSOLUTE_FLOOR
from validation.study.compare.report import REPORT
from validation.study.compare.sweeps import compare_sweeps
from validation.study.sweep.figures import draw_sweep
from validation.study.sweep.report import judge_sweep, render, sweep_metric_table, worst_runs
from validation.study.sweep.table import METRIC, SweepTable, read_sweep
from validation.table import is_heading
from validation.trial.files import RunFile


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_sweep(tmp_path_factory.mktemp("sweep") / "s", make_table(120))
    assert call(["report", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def html(folder):
    return (folder / RunFile.REPORT).read_text(encoding="utf-8")


def test_page_is_self_contained_and_says_what_the_table_says_escaped(folder, html):
    links = [link for link in assert_self_contained(html).links if not link.startswith(("#", "data:"))]
    assert links
    assert all(link.startswith("recordings/") and (folder / link).is_file() for link in links)
    sweep = read_sweep(folder)
    top, _, below = " ".join(Page(html).text.split()).partition("Where it passes")
    assert judge_sweep(sweep)[2] in top
    assert all(" ".join(cell.split()) in top for row in sweep.tables()[0].rows for cell in row)
    assert "run 009: the legs are too short; shorten the step." in top
    for picture in draw_sweep(sweep):
        assert picture.text in below
    table = replaced(make_table(40), "cause", ["<img src=x onerror=alert(1)>"] * 40)
    assert "<img src=x" not in render(sweep_of(table))
    assert "a &lt;/script&gt; broke" in html


def test_every_run_is_drawn_in_the_colour_of_its_state(folder):
    sweep = read_sweep(folder)
    pair, *shares = draw_sweep(sweep)
    labels = "gait.step_length [m], gait.switching_velocity [m/s], gait.c_s, gait.c_y, body.height [m]"
    assert [picture.charts[0].xlabel for picture in shares[:5]] == labels.split(", ")
    dots = [mark for mark in pair.charts[0].marks if mark.round]
    assert sorted(len(mark.points) for mark in dots) == sorted(filter(None, sweep.counts.values()))
    drawn = np.concatenate([mark.points for mark in shares[2].charts[0].marks if mark.round])
    used = np.column_stack([sweep.numbers("gait.c_s"), 100.0 * sweep.worst_used])
    assert sorted(drawn.tolist()) == sorted(used[sweep.measured].tolist())


def test_axes_have_the_units_of_their_keys():
    table = make_table(failures=False, grid={"controller.com_stiffness": [20.0, 25.0, 30.0]})
    assert draw_sweep(sweep_of(table))[1].charts[0].xlabel == "controller.com_stiffness [1/s^2]"


def test_texts_and_infinities():
    names = ["ampm", "dcm", "mine:Lipm"]
    grid: dict[str, Any] = {"gait.c_s": [0.6, 1.0], "gait.a_s": [2.63, np.inf], "gait.planner": names}
    table = make_table(failures=False, grid=grid)
    values = [*table["metric_zmp_y_rmse"].to_pylist()[:-1], np.inf]
    sweep = sweep_of(replaced(table, "metric_zmp_y_rmse", values))
    assert sweep.worst[0] == len(sweep) - 1
    assert any("inf mm" in row for row in sweep_metric_table(sweep).rows)
    headings = [row[0] for row in sweep_metric_table(sweep).rows if is_heading(row)]
    assert headings == ["gait.planner ampm", "gait.planner dcm", "gait.planner mine:Lipm"]
    charts = [picture.charts[0] for picture in draw_sweep(sweep)]
    (planners,) = (chart for chart in charts if chart.xlabel == "gait.planner")
    assert planners.xticks == {"ampm": 0.0, "dcm": 1.0, "Lipm": 2.0}
    (zmp,) = (chart for chart in charts if chart.title.startswith("ZMP, RMS error along x"))
    assert zmp.xlabel == "gait.c_s"
    assert [mark.label for mark in zmp.marks if mark.label] == [*planners.xticks]
    dots = [mark.points for chart in charts for mark in chart.marks if mark.round]
    assert all(np.isfinite(points).all() for points in dots)


def test_sweeps_of_one_run_and_of_refusals():
    assert "No parameter varies" in render(sweep_of(make_table(failures=False, grid={"gait.c_s": [1.0]})))
    table = make_table(20)
    for name, value in (("outcome", "refused"), ("reason", "too_slow"), ("verdict", None)):
        table = replaced(table, name, pa.array([value] * 20, pa.string()))
    text = render(sweep_of(table))
    assert "No run completed, so there are no metrics." in text
    assert "No run walked." in text


def test_verdict_of_a_sweep():
    easy = make_table(failures=False, grid={"gait.c_y": np.linspace(0.9, 1.1, 30).tolist()})
    for table, verdict, headline in (
        (easy, "pass", "pass"),
        (make_table(120), "fail", None),
        (replaced(easy, "outcome", ["timed_out"] * 30), "open", "not every run has an answer"),
        (replaced(easy, "outcome", ["refused"] * 30), "open", "nothing walked"),
        (easy.slice(0, 10), "open", "unfinished"),
    ):
        found = judge_sweep(sweep_of(table))
        assert found[0] == verdict
        assert found[1] == headline or headline is None
    assert "20 of 30" in found[2]


def test_walks_that_ended_first_are_the_worst():
    table = make_table(4, failures=False)
    ends = {"outcome": ["fell"] * 4, "verdict": ["not_measured"] * 4, "outcome_time": [3.0, 1.0, None, 2.0]}
    for name, values in ends.items():
        table = replaced(table, name, values)
    assert sweep_of(table).worst == [1, 3, 0, 2]


@pytest.mark.parametrize("name", ["/etc", "javascript:alert(1)"])
def test_only_links_beside_the_page(name, tmp_path):
    table = replaced(make_table(5, failures=False), "recording", [name] + [None] * 4)
    (tmp_path / "sweep.toml").touch()
    pq.write_table(table, tmp_path / "results.parquet")
    assert len(rows := worst_runs(read_sweep(tmp_path)).rows) == 5
    assert "href" not in str(rows)


def test_forces_are_judged_in_body_weights_and_a_tolerance_may_be_zero():
    mass = np.array([30.0, 60.0, 90.0, 120.0])
    table = replaced(make_table(4, failures=False), "body.mass", mass)
    table = replaced(table, "metric_force_x_rmse", [2.0] * 4)
    sweep = sweep_of(replaced(table, "metric_failed_qp", [4.0, 4.0, 4.0, 0.0]))
    assert sweep.used("force_x_rmse") == pytest.approx(2.0 / (0.008 * 9.81 * mass))
    values, limits, unit = sweep.shown("force_x_rmse")
    assert values == pytest.approx(100 * 2.0 / (9.81 * mass))
    assert (limits.tolist(), unit) == (pytest.approx([0.8] * 4), "% of body weight")
    assert sweep.used("failed_qp").tolist() == [np.inf] * 3 + [0.0]
    text = Page(render(sweep)).text
    assert not re.search(r"inf\s%", text)
    assert "4, limit 0" in text


LIMITS = {"zmp_x_rmse": 2.5e-3, "zmp_y_rmse": 1.5e-3, "failed_qp": 0.0}
SLOPES = {"gait.c_y": [round(0.5 + 0.05 * run, 2) for run in range(10)]}
GOOD = {"zmp_x_rmse": 1e-3 + 1e-5 * np.arange(10), "zmp_y_rmse": np.full(10, 5e-4), "failed_qp": np.zeros(10)}


def table(**changes) -> pa.Table:
    """Ten completed runs; ``zmp_x_rmse=[...]`` replaces the first values of a column."""
    found = make_table(grid=SLOPES, failures=False)
    found = replaced(found, "verdict", ["pass"] * 10)
    for name, values in {**GOOD, **changes}.items():
        key = name if name in found.column_names else METRIC + name
        found = replaced(found, key, [*values, *(GOOD.get(name, found[key].to_pylist()))[len(values) :]])
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
    alike = replaced(table(zmp_x_rmse=[2e-3] * 5), "gait.c_y", [0.5] * 10)
    alike = replaced(alike, "gait", ["normal"] * 5 + ["flat"] * 5)
    one, other = (SweepTable(alike.take(rows), None, "A") for rows in (np.r_[0:10], np.r_[5:10, 0:5]))
    assert compare_sweeps(one, other).sentence == "No regression in 10 matched runs."


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
    below = sweep("B", zmp_y_rmse=[limit * (1 - 1e-8)], verdict=["pass"])
    above = sweep("B", zmp_y_rmse=[limit * (1 + 1e-8)], verdict=["fail"])
    far = sweep("B", zmp_y_rmse=[2 * limit], verdict=["fail"])
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
    assert (found.status, found.out.splitlines()[0]) == (1, "Regression in 10 matched runs: 1 newly failing.")
    assert "newly failing" in (out / REPORT).read_text(encoding="utf-8")
    assert "compares two sweeps" in ampm("report", out).err
    assert ampm("compare", a, b, "--json").json["counts"]["newly failing"] == 1
    assert [ampm("compare", *pair).status for pair in ((b, a), (a, b / "../a"))] == [0, 2]
    assert ampm("compare", a, b, "--uncertainty", out).status == 2

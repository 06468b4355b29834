"""A sweep's page: true to its table, and self-contained."""

import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.sweep_table import make_table, replaced, sweep_of, write_sweep
from tests.test_report import Page, assert_self_contained
from validation.cli.app import call
from validation.study.sweep.figures import draw_sweep
from validation.study.sweep.report import judge_sweep, render, sweep_metric_table, worst_runs
from validation.study.sweep.table import read_sweep
from validation.table import is_heading
from validation.trial.files import RunFile

GRID: dict[str, Any] = {
    "gait.c_s": [0.6, 1.0],
    "gait.a_s": [2.63, float("inf")],
    "gait.planner": ["ampm", "dcm", "lipm"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_sweep(tmp_path_factory.mktemp("sweep") / "s", make_table(120))
    assert call(["report", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def html(folder):
    return (folder / RunFile.REPORT).read_text(encoding="utf-8")


def test_page_is_self_contained(folder, html):
    links = [link for link in assert_self_contained(html).links if not link.startswith(("#", "data:"))]
    assert links
    assert all(link.startswith("recordings/") and (folder / link).is_file() for link in links)


def test_page_says_what_the_table_says(folder, html):
    sweep = read_sweep(folder)
    top, _, below = " ".join(Page(html).text.split()).partition("Where it passes")
    assert judge_sweep(sweep)[2] in top
    assert all(" ".join(cell.split()) in top for row in sweep.tables()[0].rows for cell in row)
    assert "run 009: the legs are too short; shorten the step." in top
    for picture in draw_sweep(sweep):
        assert picture.text in below


def test_every_run_is_drawn_in_the_colour_of_its_state(folder):
    sweep = read_sweep(folder)
    pair, *shares = draw_sweep(sweep)
    assert [picture.charts[0].xlabel for picture in shares[:5]] == [
        "gait.step_length [m]",
        "gait.switching_velocity [m/s]",
        "gait.c_s",
        "gait.c_y",
        "body.height [m]",
    ]
    dots = [mark for mark in pair.charts[0].marks if mark.round]
    assert sorted(len(mark.points) for mark in dots) == sorted(filter(None, sweep.counts.values()))
    drawn = np.concatenate([mark.points for mark in shares[2].charts[0].marks if mark.round])
    used = np.column_stack([sweep.numbers("gait.c_s"), 100.0 * sweep.worst_used])
    assert sorted(drawn.tolist()) == sorted(used[sweep.measured].tolist())


def test_axes_have_the_units_of_their_keys():
    table = make_table(failures=False, grid={"controller.com_stiffness": [20.0, 25.0, 30.0]})
    assert draw_sweep(sweep_of(table))[1].charts[0].xlabel == "controller.com_stiffness [1/s^2]"


def test_texts_and_infinities():
    table = make_table(failures=False, grid=GRID)
    values = [*table["metric_zmp_y_rmse"].to_pylist()[:-1], np.inf]
    sweep = sweep_of(replaced(table, "metric_zmp_y_rmse", values))
    assert sweep.worst[0] == len(sweep) - 1
    assert "inf mm" in sweep_metric_table(sweep).rows[-24]
    headings = [row[0] for row in sweep_metric_table(sweep).rows if is_heading(row)]
    assert headings == ["gait.planner ampm", "gait.planner dcm", "gait.planner lipm"]
    charts = [picture.charts[0] for picture in draw_sweep(sweep)]
    (planners,) = (chart for chart in charts if chart.xlabel == "gait.planner")
    assert planners.xticks == {"ampm": 0.0, "dcm": 1.0, "lipm": 2.0}
    (zmp,) = (chart for chart in charts if chart.title.startswith("ZMP, RMS error along x"))
    assert zmp.xlabel == "gait.c_s"
    assert [mark.label for mark in zmp.marks if mark.label] == ["ampm", "dcm", "lipm"]
    dots = [mark.points for chart in charts for mark in chart.marks if mark.round]
    assert all(np.isfinite(points).all() for points in dots)


def test_sweeps_of_one_run_and_of_refusals():
    one = make_table(failures=False, grid={"gait.c_s": [1.0]})
    assert "No parameter varies" in render(sweep_of(one))
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


def test_text_is_escaped(html):
    table = replaced(make_table(40), "cause", ["<img src=x onerror=alert(1)>"] * 40)
    assert "<img src=x" not in render(sweep_of(table))
    assert "a &lt;/script&gt; broke" in html


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

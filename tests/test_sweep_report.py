"""A sweep's page: true to its table, self-contained, and alive in a browser."""

import json
import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ampm.exceptions import InputError
from tests.browser import look
from tests.sweep_table import make_table, replaced, sweep_of, write_sweep
from tests.test_report import Page
from validation.cli.app import call
from validation.store.saved import REPORT_FILE
from validation.study.sweep import figures
from validation.study.sweep.figures import links_of
from validation.study.sweep.report import judge_sweep, metric_table, render
from validation.study.sweep.table import read_sweep
from validation.table import is_heading

GRID: dict[str, Any] = {
    "gait.c_s": [0.6, 1.0],
    "gait.a_s": [2.63, float("inf")],
    "gait.planner": ["ampm", "dcm", "lipm"],
}


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without pictures, where only words are read."""
    monkeypatch.setattr(figures, "vega_script", lambda: "")


def data_of(html: str) -> list[dict[str, Any]]:
    """Runs that a page draws."""
    return json.loads(re.findall(r"const data = { values: (\[.*\]) };\n", html)[0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_sweep(tmp_path_factory.mktemp("sweep") / "s", make_table(120))
    assert call(["report", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def html(folder):
    return (folder / REPORT_FILE).read_text(encoding="utf-8")


def test_page_is_self_contained(folder, html):
    page = Page(html)
    markup = html.replace(figures.vega_script(), "")
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\((?!#)", markup)
    assert page.open == []
    assert set(re.findall(r"var\(--([\w-]+)\)", html)) <= set(re.findall(r"--([\w-]+):", html))
    links = [link for link in page.links if not link.startswith(("#", "data:,"))]
    assert links
    assert all(link.startswith("recordings/") and (folder / link).is_file() for link in links)


def test_page_says_what_the_table_says(folder, html):
    sweep, runs = read_sweep(folder), data_of(html)
    top = " ".join(Page(html).text.split()).partition("Where it passes")[0]
    assert judge_sweep(sweep)[2] in top
    assert all(" ".join(cell.split()) in top for row in sweep.tables()[0].rows for cell in row)
    assert "run 009: the legs are too short; shorten the step." in top
    assert [run["run"] for run in runs] == sweep.words("name")
    assert [run["outcome"] for run in runs] == [sweep.states[row].label for row in range(len(sweep))]
    assert [run["gait.c_s"] for run in runs] == pytest.approx(sweep.numbers("gait.c_s"), rel=1e-4)
    used = np.array([run["largest share of a tolerance [%]"] for run in runs], dtype=float)
    assert used == pytest.approx(100.0 * sweep.worst_used, rel=1e-4, nan_ok=True)


def test_texts_and_infinities(undrawn):
    sweep = sweep_of(make_table(failures=False, grid=GRID))
    runs = data_of(render(sweep))
    assert {run["gait.planner"] for run in runs} == {0.0, 1.0, 2.0}
    assert figures.texts(sweep) == {"gait.planner": ["ampm", "dcm", "lipm"]}
    headings = [row[0] for row in metric_table(sweep).rows if is_heading(row)]
    assert headings == ["gait.planner ampm", "gait.planner dcm", "gait.planner lipm"]
    assert {run["gait.a_s"] for run in runs} == {2.63, None}
    assert "gait.a_s inf" in runs[-1]["parameters"]


def test_sweeps_of_one_run_and_of_refusals(undrawn):
    one = make_table(failures=False, grid={"gait.c_s": [1.0]})
    assert "No parameter varies" in render(sweep_of(one))
    table = make_table(20)
    for name, value in (("outcome", "refused"), ("reason", "too_slow"), ("verdict", None)):
        table = replaced(table, name, pa.array([value] * 20, pa.string()))
    text = render(sweep_of(table))
    assert "No run completed, so there are no metrics." in text
    assert "No run walked." in text


def test_verdict_of_a_sweep():
    easy = make_table(30, failures=False, vary={"gait.c_y": (0.9, 1.1)})
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
    assert links_of(read_sweep(tmp_path)) == {}


def test_text_is_escaped(html, undrawn):
    table = replaced(make_table(40), "cause", ["<img src=x onerror=alert(1)>"] * 40)
    assert "<img" not in render(sweep_of(table))
    assert "a &lt;/script&gt; broke" in html


def test_tables_that_are_of_no_sweep(tmp_path):
    (tmp_path / "sweep.toml").touch()
    pq.write_table(pa.table({"a": [1]}), tmp_path / "results.parquet")
    with pytest.raises(InputError, match="not a table of a sweep"):
        read_sweep(tmp_path)


def test_forces_are_judged_in_body_weights_and_a_tolerance_may_be_zero(undrawn):
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


PROBE = """
const sleep = (time) => new Promise((done) => setTimeout(done, time));
const points = () => document.querySelectorAll("#scatter .mark-symbol.role-mark path").length;
await sleep(500);
const [right] = document.querySelectorAll("#scatter select"), before = points(), drawn = [];
for (const option of [...right.options].map((item) => item.value)) {
  right.value = option;
  right.dispatchEvent(new Event("input"));
  right.dispatchEvent(new Event("change"));
  await sleep(100);
  drawn.push(points());
}
tell({ before, drawn,
  width: innerWidth, scroll: document.documentElement.scrollWidth,
  fetched: performance.getEntriesByType("resource").map((e) => e.name).filter((n) => /^http/.test(n)) });
"""


def test_page_lives(html, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    seen = look(path, tmp_path, PROBE, size=(390, 844))
    assert seen.console == []
    told = seen.told
    assert (told["before"], told["fetched"]) == (120, [])
    assert min(told["drawn"]) > 100  # every choice draws something
    assert told["scroll"] <= told["width"]  # nothing sticks out sideways

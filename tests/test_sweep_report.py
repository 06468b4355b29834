"""A sweep's page: true to its table, self-contained, small, and alive in a browser."""

import json
import re
from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import vl_convert

from ampm.exceptions import InputError
from tests.browser import look
from tests.sweep_table import RANGES, make_table, replaced, sweep_of, write_sweep
from tests.test_report import Page
from validation.cli.app import call
from validation.store.saved import REPORT_FILE
from validation.study.sweep import figures
from validation.study.sweep.report import judge_sweep, links_of, render, share
from validation.study.sweep.table import State, read_sweep

GRID = {"gait.c_s": [0.6, 1.0, 1.4], "gait.a_s": [2.0, 2.63, float("inf")], "foot.schedule": ["flat", "roll"]}


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without pictures, where only words are read."""
    monkeypatch.setattr(figures, "vega_script", lambda: "")


def data_of(html):
    """Columns of the runs that a page draws."""
    fields, rows = (
        json.loads(part) for part in re.findall(r"const fields = (\[.*?\]), rows = (\[.*\]);\n", html)[0]
    )
    return {field: [row[place] for row in rows] for place, field in enumerate(fields)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_sweep(tmp_path_factory.mktemp("sweep") / "s", make_table(400))
    assert call(["report", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def html(folder):
    return (folder / REPORT_FILE).read_text(encoding="utf-8")


# ----------------------------------------------------------------------------------------- the page


def test_page_is_small_and_self_contained(folder, html):
    page = Page(html)
    assert len(html.encode()) < 2_000_000
    markup = html.replace(figures.vega_script(), "")
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\((?!#)", markup)
    assert "src" not in re.findall(r"<script[^>]*?\b(src)\b", markup)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    styles = set(re.findall(r"--([\w-]+):", html))
    assert set(re.findall(r"var\(--([\w-]+)\)", html)) <= styles
    links = [link for link in page.links if not link.startswith(("#", "data:,"))]
    assert links
    assert all(link.startswith("recordings/") and (folder / link).is_file() for link in links)


def test_page_says_what_the_table_says(folder, html):
    sweep, data = read_sweep(folder), data_of(html)
    top = " ".join(Page(html).text.split()).partition("Where it passes")[0]
    assert judge_sweep(sweep)[2] in top
    assert all(f"{count:,}" in top and state.label in top for state, count in sweep.counts.items() if count)
    assert data["run"] == sweep.words("name")
    assert data["outcome"] == [sweep.state(row).label for row in range(len(sweep))]
    assert html.count('aria-label="Distribution of') > 3
    assert "ampm validate normal --set" in html
    assert np.array(data["gait.c_s"]) == pytest.approx(sweep.numbers("gait.c_s"), rel=1e-4)
    used = np.array(data["largest share of a tolerance [%]"], dtype=float)
    assert used == pytest.approx(100.0 * sweep.worst_used, rel=1e-4, nan_ok=True)


def test_specifications_draw_every_run_and_link_the_kept_ones(folder):
    sweep = read_sweep(folder)
    links = links_of(sweep)
    runs = figures.run_data(sweep, range(len(sweep)), links)
    scatter, parallel = (
        vl_convert.vegalite_to_svg(json.dumps({**spec, "width": 600, "data": {"values": runs}}))
        for spec in (figures.scatter(sweep), figures.parallel(sweep))
    )
    assert scatter.count('aria-roledescription="point"') == len(sweep)
    assert scatter.count("xlink:href") == len(links) > 0
    assert parallel.count('aria-roledescription="line mark"') == len(sweep)
    assert "gait.c_s" in parallel


@pytest.mark.slow
def test_many_runs_make_no_larger_page(undrawn):
    large = render(sweep_of(make_table(5000)))
    assert len(large.encode()) < 800_000  # and 0.9 MB of Vega
    kept = len(data_of(large)["run"])
    assert figures.MOST_POINTS <= kept <= figures.MOST_POINTS + 24
    assert 4321 in figures.drawn_rows(sweep_of(make_table(5000)), [4321])


@pytest.mark.parametrize(
    ("options", "phrase", "parameters"),
    [
        ({"count": 2}, "", set(RANGES)),
        ({"grid": {"gait.c_s": [1.0]}}, "No parameter varies", set()),
        ({"count": 40, "vary": {"gait.c_s": (0.8, 1.2)}}, "", {"gait.c_s"}),
        ({"grid": GRID}, "", set(GRID)),  # texts and infinities
    ],
)
def test_odd_sweeps(undrawn, options, phrase, parameters):
    text = render(sweep_of(make_table(failures=False, **options)))
    assert Page(text).open == []
    assert phrase in text
    if parameters:
        assert parameters <= {field.partition(" [")[0] for field in data_of(text)}


def test_a_sweep_of_refusals_has_no_metrics(undrawn):
    table = make_table(20)
    for name, value in (("outcome", "refused"), ("reason", "too_slow"), ("verdict", None)):
        table = replaced(table, name, pa.array([value] * 20, pa.string()))
    text = render(sweep_of(table))
    assert "No run completed, so there are no metrics." in text
    assert "No run walked." in text


def test_verdict_of_a_sweep():
    easy = make_table(30, failures=False, vary={"gait.c_y": (0.9, 1.1)})
    late = replaced(easy, "outcome", ["timed_out"] * 30)
    for table, verdict, headline in (
        (easy, "pass", "pass"),
        (make_table(400), "fail", None),
        (late, "open", None),
        (replaced(easy, "outcome", ["refused"] * 30), "open", "nothing walked"),
        (easy.slice(0, 10), "open", "unfinished"),
    ):
        found = judge_sweep(sweep_of(table))
        assert found[0] == verdict
        assert found[1] == headline or headline is None
    assert "20 of 30" in found[2]


@pytest.mark.parametrize("name", ["../../etc", "/etc", "https://example.org/x", "javascript:alert(1)"])
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
    pq.write_table(pa.table({"a": [1]}), tmp_path / "y.parquet")
    with pytest.raises(InputError, match="no table of a sweep"):
        read_sweep(tmp_path / "y.parquet")
    table = replaced(make_table(3, failures=False), "outcome", ["completed", "flew", "completed"])
    with pytest.raises(InputError, match="'flew'"):
        render(sweep_of(table))


# -------------------------------------------------------------------------------------------- parts


@pytest.mark.parametrize(
    ("part", "whole", "text"),
    [
        (0, 0, "0"),
        (9, 9, "100"),
        (1, 100_000, "< 0.1"),
        (99_999, 100_000, "> 99.9"),
        (1, 3, "33"),
        (1, 300, "0.3"),
    ],
)
def test_shares_never_round_to_all_or_nothing(part, whole, text):
    assert share(part, whole) == f"{text} %"


def test_worst_runs_come_first(folder):
    sweep = read_sweep(folder)
    lost = [row for row in sweep.worst if not sweep.measured[row]]
    furthest = [row for row in sweep.worst if sweep.measured[row]]
    assert sweep.worst == [*lost, *furthest]
    assert {sweep.state(row) for row in lost} == {State.FELL, State.DIVERGED}
    used = sweep.worst_used[furthest]
    assert (np.diff(used) <= 0).all()
    assert used[0] == np.nanmax(sweep.worst_used)


def test_forces_are_judged_in_body_weights_and_a_tolerance_may_be_zero(undrawn):
    table = replaced(make_table(4, failures=False), "body.mass", [30.0, 60.0, 90.0, 120.0])
    table = replaced(table, "metric_force_x_rmse", [2.0] * 4)
    sweep = sweep_of(replaced(table, "metric_failed_qp", [4.0, 4.0, 4.0, 0.0]))
    assert sweep.used("force_x_rmse") == pytest.approx(2.0 / (0.008 * 9.81 * np.array([30, 60, 90, 120])))
    values, unit = sweep.shown("force_x_rmse")
    assert values == pytest.approx(100 * 2.0 / (9.81 * np.array([30, 60, 90, 120])))
    limits, _ = sweep.shown_limits("force_x_rmse")
    assert (limits.tolist(), unit) == (pytest.approx([0.8] * 4), "% of body weight")
    assert sweep.used("failed_qp").tolist() == [np.inf] * 3 + [0.0]
    text = Page(render(sweep)).text
    assert not re.search(r"inf\s%", text)
    assert "4, limit 0" in text


def drawn(values, limit):
    """Layers of a histogram: the specification that is drawn."""
    specs = []
    with patch.object(figures, "svg", lambda spec, _: specs.append(spec)):
        figures.distribution(np.array(values), limit, "mm", "ZMP, RMS error along x")
    return specs[0]


@pytest.mark.parametrize("count", [1, 2, 7, 60, 900])
def test_counts_of_histograms_are_whole_numbers(count):
    values = np.random.default_rng(count).gamma(4.0, 0.4, count)
    spec = drawn(values, 2.5)
    bars = spec["layer"][-1]["encoding"]
    ticks = bars["y"]["axis"]["values"]
    assert all(isinstance(tick, int) for tick in ticks)
    assert np.all(np.diff(ticks) > 0)
    assert 2 <= len(ticks) <= 6
    shown = re.findall(r">(\d+)</text>", figures.distribution(values, 2.5, "mm", "a"))
    assert shown[-len(ticks) :] == [f"{tick}" for tick in ticks]
    counts = [bar["runs"] for bar in spec["data"]["values"]]
    low, high = bars["x"]["scale"]["domain"]
    assert sum(counts) == np.count_nonzero((values >= low) & (values <= high))


@pytest.mark.parametrize("limit", [0.0, 0.37, 1.0, 2.5])
def test_a_limit_covers_no_bar(limit):
    spec = drawn(np.r_[0.0, np.random.default_rng(1).gamma(4.0, 0.4, 300)], limit)
    bars = [bar for bar in spec["data"]["values"] if not bar["from"] == limit == 0.0]
    assert not [bar for bar in bars if bar["from"] + 1e-9 < limit < bar["to"] - 1e-9]
    assert all((bar["group"] == figures.OVER) == (bar["from"] > limit - 1e-9) for bar in bars)
    rule, _ = spec["layer"]  # drawn first, so below the bars
    assert rule["encoding"]["x"]["datum"] == limit


def test_parameters_with_texts_have_their_texts_on_axes_and_a_colour_each_in_histograms():
    planners = ["ampm", "dcm", "lipm"]
    grid: dict[str, Sequence[Any]] = {
        "foot.schedule": ["flat", "roll"],
        "gait.c_s": [0.6, 1.0],
        "gait.planner": planners,
    }
    sweep = sweep_of(make_table(failures=False, grid=grid))
    assert figures.category(sweep) == ("gait.planner", planners)
    text = render(sweep)
    assert set(data_of(text)["gait.planner"]) == set(planners)
    for name, hue in zip(planners, figures.HUES, strict=False):
        assert f'<i class="area" style="background:{hue};opacity:1"></i>{name}</li>' in text
    runs = {"values": figures.run_data(sweep, range(len(sweep)), {})}
    spec = figures.scatter(sweep)
    for item in spec["params"]:
        if item["name"] == "x":
            item["value"] = "gait.planner"
    drawing = vl_convert.vegalite_to_svg(json.dumps({**spec, "width": 600, "data": runs}))
    ticks = re.findall(r">([^<>]+)</text>", drawing)
    assert ticks[: len(planners)] == planners
    values, rows = np.array([1.0, 1.1, 3.0]), np.array([True, False, True])
    picture = figures.distribution(values, 2.5, "mm", "a", {"ampm": rows, "dcm": ~rows})
    assert picture.count(f'fill="{figures.HUES[0]}"') == 2
    assert picture.count(f'fill="{figures.HUES[1]}"') == 1
    assert 'fill="var(--bad)"' not in picture


# ---------------------------------------------------------------------------------------- in a browser

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
tell({ before, drawn, choices: document.querySelectorAll("#scatter select").length,
  lines: document.querySelectorAll("#parallel .mark-line.role-mark path").length,
  width: innerWidth, scroll: document.documentElement.scrollWidth,
  fetched: performance.getEntriesByType("resource").map((e) => e.name).filter((n) => /^http/.test(n)) });
"""


@pytest.mark.parametrize("size", [(1366, 768), (390, 844)], ids=["laptop", "phone"])
def test_page_lives(html, tmp_path, size):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    seen = look(path, tmp_path, PROBE, size=size)
    assert seen.console == []
    told = seen.told
    assert told["choices"] == 2
    assert told["before"] == 400
    assert min(told["drawn"]) > 100  # every choice draws something
    assert told["lines"] == 400
    assert told["fetched"] == []
    assert told["scroll"] <= told["width"]  # nothing sticks out sideways

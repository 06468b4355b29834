"""A sweep's page: true to its table, self-contained, small, and alive in a browser."""

from __future__ import annotations

import json
import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ampm.exceptions import InputError
from ampm.run_file import load_run
from tests.browser import assert_in_cards, look
from tests.sweep_table import RANGES, make_table, replaced, sweep_of, write_sweep
from tests.test_report import Page
from validation.cli.app import call
from validation.store.saved import REPORT_FILE
from validation.study.sweep import figures
from validation.study.sweep.report import (
    judge_sweep,
    links_of,
    render,
    run_rows,
    share,
    write_sweep_report,
)
from validation.study.sweep.table import STATES, State, read_sweep

GRID: dict[str, list[Any]] = {
    "gait.c_s": [0.6, 1.0, 1.4],
    "gait.a_s": [2.0, 2.63, float("inf")],
    "foot.schedule": ["flat", "roll"],
}
TOO_SLOW = {"gait.switching_velocity": (0.5, 0.6)}


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without pictures, where only words are read."""
    monkeypatch.setattr(figures, "svg", lambda *_: "")
    monkeypatch.setattr(figures, "vega_script", lambda: "")


def data_of(html):
    found = re.search(r'<script type="application/json" id="map-data">(.*?)</script>', html, re.DOTALL)
    assert found
    return json.loads(found[1])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_sweep(tmp_path_factory.mktemp("sweep") / "s", make_table(1000))


@pytest.fixture(scope="module")
def html(folder):
    assert write_sweep_report(folder) == folder / REPORT_FILE
    return (folder / REPORT_FILE).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


# ----------------------------------------------------------------------------------------- the page


def test_page_is_small_and_self_contained(folder, html, page):
    assert len(html.encode()) < 2_000_000  # it can be mailed; three are allowed
    markup = html.replace(figures.vega_script(), "")
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\((?!#)", markup)
    assert "src" not in re.findall(r"<script[^>]*?\b(src)\b", markup)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    used = set(re.findall(r"var\(--([\w-]+)\)", html))
    assert used <= set(re.findall(r"--([\w-]+):", html))
    links = [link for link in page.links if not link.startswith(("#", "data:,"))]
    assert links
    assert all(link.startswith("recordings/") and (folder / link).is_file() for link in links)
    # A crash of the synthetic sweep says "a worker's </script> broke", which must not end the script.
    assert "worker" in json.dumps(data_of(html))
    assert html.lower().count("</script") == 3
    still = html[html.index('id="map-still"') : html.index('id="map-live" hidden')]
    assert "<svg" in still  # the map without scripts


@pytest.mark.parametrize("count", [12_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_many_runs_make_no_larger_page(count):
    large = render(sweep_of(make_table(count)))
    assert len(large.encode()) < 3_000_000
    data = data_of(large)
    assert data["total"] == count
    assert len(data["columns"]["row"]) == pytest.approx(figures.MOST_POINTS, rel=0.02)


def test_verdict_and_counts_stand_at_the_top(folder, page):
    sweep = read_sweep(folder)
    words = " ".join(page.text.split())
    top = words[: words.index("Where it passes")]
    assert judge_sweep(sweep)[2] in top
    assert all(f"{count:,}" in top and state.label in top for state, count in sweep.counts.items() if count)


def test_data_say_what_the_table_says(folder, html):
    sweep, data = read_sweep(folder), data_of(html)
    columns = data["columns"]
    rows = columns["row"]
    assert sorted(rows) == list(range(len(sweep))) == list(range(data["total"]))
    assert columns["outcome"] == [STATES[sweep.states[row]].label for row in rows]
    expected: tuple[Any, Any, str]
    for axis in data["axes"]:
        values = np.array(columns[axis["field"]], dtype=float)
        if axis["parameter"]:
            assert np.array_equal(values, sweep.numbers(axis["key"])[rows])
            continue
        expected = np.minimum(100.0 * sweep.worst_used, 1000.0), 100.0, "%"
        if axis["key"] != "used":
            expected = sweep.shown(axis["key"].removeprefix("metric:"))
        assert (axis["limit"], axis["unit"]) == (expected[1], expected[2].replace("of body weight", "BW"))
        assert values == pytest.approx(expected[0][rows], rel=1e-3, nan_ok=True)


def test_a_limit_of_zero_that_was_passed_is_drawn_beyond_its_limit():
    sweep: Any = SimpleNamespace(worst_used=np.array([math.inf, math.nan, 0.5]), judged=())
    (axis,) = figures.metric_axes(sweep)
    assert axis.values == pytest.approx([1000.0, math.nan, 50.0], nan_ok=True)


def test_command_line_writes_it_again(folder, capsys):
    (folder / REPORT_FILE).unlink()
    assert call(["report", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / REPORT_FILE)
    assert (folder / REPORT_FILE).is_file()


# --------------------------------------------------------------------------------------- odd sweeps


@pytest.mark.parametrize(
    ("options", "phrase", "parameters"),
    [
        ({"count": 2}, "too few", set(RANGES)),
        ({"count": 7}, "too few", set(RANGES)),
        ({"grid": {"gait.c_s": [1.0]}}, "No parameter varies", set()),
        ({"count": 40, "vary": {"gait.c_s": (0.8, 1.2)}}, "", {"gait.c_s"}),
        (
            {"count": 20, "vary": {"gait.switching_velocity": (0.5, 0.6)}, "failures": True},
            "no metrics",
            None,
        ),
        ({"grid": GRID}, "", set(GRID)),  # words and infinities
    ],
)
def test_odd_sweeps(undrawn, options, phrase, parameters):
    text = render(sweep_of(make_table(**{"failures": False} | options)))
    assert Page(text).open == []
    assert phrase in text
    assert text == render(sweep_of(make_table(**{"failures": False} | options)))  # the same again
    assert ("<script" in text) == (parameters != set())
    if parameters:
        axes = data_of(text)["axes"]  # JSON without infinities
        assert {axis["key"] for axis in axes if axis["parameter"]} == parameters
        assert not all(axis["parameter"] for axis in axes)


def test_words_and_infinities_are_levels():
    sweep = sweep_of(make_table(grid=GRID, failures=False))
    axes = {key: figures.parameter_axis(sweep, key) for key in sweep.varied}
    assert axes["foot.schedule"].levels == ("flat", "roll")
    assert axes["gait.a_s"].levels == ("2", "2.63", "inf")
    assert axes["gait.a_s"].column(np.array([0, 1])) == ["2", "2"]
    values = [np.inf, *np.linspace(1.0, 5.0, 199)]  # one infinity within a range
    axis = figures.parameter_axis(sweep_of(replaced(make_table(200), "gait.a_s", values)), "gait.a_s")
    assert axis.levels is None
    assert axis.column(np.array([0, 1])) == [None, 1.0]


def test_verdict_of_a_sweep():
    easy = make_table(30, failures=False, vary={"gait.c_y": (0.9, 1.1)})
    late = replaced(replaced(easy, "outcome", ["timed_out"] * 30), "verdict", [None] * 30)
    refused = make_table(20, vary=TOO_SLOW)
    for table, verdict, headline in (
        (easy, "pass", "pass"), (make_table(1000), "fail", None), (late, "open", None),
        (refused, "open", "nothing walked"), (easy.slice(0, 10), "open", "unfinished"),
    ):  # fmt: skip
        found = judge_sweep(sweep_of(table))
        assert found[0] == verdict
        assert found[1] == headline or headline is None
    assert "20 of 30" in found[2]


def test_mixed_versions_are_flagged(page, undrawn):
    assert "mixed:" not in page.text
    for change, words in (
        ({"environment_revision": ["a" * 40] * 20 + ["b" * 40] * 20}, ("mixed:", "not one measurement")),
        ({"environment_modified": True}, ("differed from its revision",)),
    ):
        text = " ".join(Page(render(sweep_of(make_table(40, environment=change)))).text.split())
        assert all(word in text for word in words)


@pytest.mark.parametrize(
    "name", ["../../etc", "/etc", "https://example.org/x", "a\\..\\b", "javascript:alert(1)"]
)
def test_only_links_beside_the_page(name):
    table = make_table(5, failures=False)
    assert links_of(sweep_of(replaced(table, "recording", [name] + [None] * 4))) == {}


def test_text_is_escaped(undrawn):
    table = replaced(make_table(40), "cause", ["<img src=x onerror=alert(1)>"] * 40)
    assert "<img" not in render(sweep_of(table))


def test_files_that_hold_no_sweep(undrawn, tmp_path):
    (tmp_path / "x.parquet").write_bytes(b"PAR1 nonsense")
    pq.write_table(pa.table({"a": [1]}), tmp_path / "y.parquet")
    for name, words in (("x", "can be read"), ("y", "no table of a sweep")):
        with pytest.raises(InputError, match=words):
            read_sweep(tmp_path / f"{name}.parquet")
    table = replaced(make_table(3, failures=False), "outcome", ["completed", "flew", "completed"])
    with pytest.raises(InputError, match="'flew'"):
        render(sweep_of(table))


# -------------------------------------------------------------------------------------------- parts


@pytest.mark.parametrize(
    ("part", "whole", "text"),
    [
        (0, 0, "0"),
        (0, 9, "0"),
        (9, 9, "100"),
        (1, 100_000, "< 0.1"),
        (99_999, 100_000, "> 99.9"),
        (1, 3, "33"),
        (1, 300, "0.3"),
    ],
)
def test_shares_never_round_to_all_or_nothing(part, whole, text):
    assert share(part, whole) == f"{text}\u00a0%"


def test_worst_runs_come_first(folder):
    sweep = read_sweep(folder)
    lost = [row for row in sweep.worst if not sweep.measured[row]]
    furthest = [row for row in sweep.worst if sweep.measured[row]]
    assert {STATES[sweep.states[row]] for row in lost} <= {State.FELL, State.DIVERGED, State.INFEASIBLE}
    used = sweep.worst_used[furthest]
    assert (np.diff(used) <= 0).all()
    assert used[0] == np.nanmax(sweep.worst_used)
    assert used[0] > 1.0


def test_forces_are_judged_in_body_weights_and_a_tolerance_may_be_zero(undrawn):
    table = replaced(make_table(4, failures=False), "body.mass", [30.0, 60.0, 90.0, 120.0])
    table = replaced(table, "metric_force_x_rmse", [2.0] * 4)
    sweep = sweep_of(replaced(table, "metric_failed_qp", [4.0, 4.0, 4.0, 0.0]))
    assert sweep.used("force_x_rmse") == pytest.approx(2.0 / (0.008 * 9.81 * np.array([30, 60, 90, 120])))
    values, limit, unit = sweep.shown("force_x_rmse")
    assert values == pytest.approx(100 * 2.0 / (9.81 * np.array([30, 60, 90, 120])))
    assert (limit, unit) == (pytest.approx(0.8), "% of body weight")
    assert sweep.used("failed_qp").tolist() == [np.inf] * 3 + [0.0]
    text = Page(render(sweep)).text
    assert not re.search(r"inf\s%", text)
    assert "4, limit 0" in text


def test_a_run_is_repeated_with_every_digit(folder):
    sweep = read_sweep(folder)
    (shown,) = run_rows(sweep, [5], sweep.varied)
    command = shown["repeat"].split()
    assert command[:3] == ["ampm", "validate", "normal"]
    run = load_run("normal", [command[i + 1] for i, word in enumerate(command) if word == "--set"])
    for key in sweep.parameters:
        section, _, leaf = key.partition(".")
        assert getattr(getattr(run, section), leaf) == sweep.table.column(key)[5].as_py(), key


def test_rare_runs_are_drawn():
    sweep = sweep_of(make_table(9000))
    rows, counted = figures.drawn_rows(sweep, [4321])
    assert 4321 in rows
    assert len(rows) == len(set(rows.tolist()))
    for number, state in enumerate(STATES):
        drawn = int((sweep.states[rows] == number).sum())
        assert drawn >= min(sweep.counts[state], figures.MOST_OF_RARE)
    passes = sweep.is_state(State.PASS)
    assert passes[rows[counted]].mean() == pytest.approx(passes.mean(), abs=0.03)


# ---------------------------------------------------------------------------------------- in a browser

PROBE = """
const live = document.getElementById("map-live");
const sleep = (time) => new Promise((done) => setTimeout(done, time));
const part = (name) => live.querySelector(`[data-part="${name}"]`), plot = part("plot");
const drawn = () => plot.querySelectorAll(".mark-symbol.role-mark path, .mark-rect.role-mark path").length;
const choose = async (choices) => {
  for (const [name, value] of Object.entries(choices)) part(name).value = value;
  part("view").dispatchEvent(new Event("change"));
  await sleep(200); };
const click = async (mark) => {
  const box = mark.getBoundingClientRect();
  const at = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true };
  for (const kind of ["pointermove", "mousemove", "click"]) mark.dispatchEvent(new MouseEvent(kind, at));
  await sleep(200); };
await sleep(400);
const [keys, colours] = ["x", "colour"].map((name) => [...part(name).options].map((o) => o.value));
const marks = {};
for (const [i, x] of keys.slice(0, MOST).entries()) for (const view of ["points", "cells"]) {
  const colour = colours[(i + (view === "cells")) % colours.length], y = keys[(i + 1) % keys.length];
  await choose({ x, y, colour, view });
  marks[[x, y, colour, view]] = drawn();
}
await choose({ x: keys[0], y: keys[1] ?? keys[0], colour: "", view: "points" });
await click(plot.querySelector(".mark-path.role-mark path"));
const picked = part("picked").textContent;
const tip = document.getElementById("vg-tooltip-element")?.textContent;
const before = drawn();
await click(plot.querySelector(".role-legend-symbol path"));
const hidden = before - drawn();
await choose({ view: "cells" });
await click(plot.querySelector(".mark-rect.role-mark path"));
const cell = part("picked").textContent;
part("picked").querySelector("button")?.click();
const again = part("picked").textContent;
plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
tell({ live: !live.hidden, still: document.getElementById("map-still").hidden, keys, picked, tip, cell,
  hidden, again, key: part("picked").textContent, least: Math.min(...Object.values(marks)), marks,
  width: innerWidth, scroll: document.documentElement.scrollWidth,
  dark: matchMedia("(prefers-color-scheme: dark)").matches,
  fetched: performance.getEntriesByType("resource").map((entry) => entry.name).filter((n) => /^http/.test(n)),
  page: getComputedStyle(document.body).backgroundColor });
"""


@pytest.mark.parametrize(
    ("size", "dark"), [((1366, 768), False), ((390, 844), True)], ids=["laptop light", "phone dark"]
)
def test_page_lives(html, tmp_path, size, dark):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    seen = look(path, tmp_path, "const MOST = 99;" + PROBE, size=size, dark=dark)
    assert seen.console == []
    told = seen.told
    assert told["live"]
    assert told["still"]
    assert set(RANGES) < set(told["keys"])
    assert told["least"] > 0  # every choice draws something
    assert re.search(r"run \d{4}: \w+", told["picked"])
    assert "ampm validate normal" in told["picked"]
    assert re.search(r"outcome *\w", told["tip"])
    assert told["hidden"] > 0
    assert re.match(r"\d+/\d+ pass", told["cell"])
    assert re.search(r"run \d{4}: \w+", told["again"])
    assert re.search(r"run \d{4}: \w+", told["key"])
    assert told["fetched"] == []
    assert told["scroll"] <= told["width"]  # nothing sticks out sideways
    assert told["dark"] is dark
    assert told["page"] == ("rgb(20, 23, 27)" if dark else "rgb(251, 251, 250)")


@pytest.mark.parametrize("size", [(390, 844), (600, 800), (1366, 768)])
def test_nothing_decisive_is_hidden(folder, html, tmp_path, size):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    for selector, least in (('td[data-name="over"]', 11), (".driver", 6)):
        assert_in_cards(path, tmp_path, selector, least, size, whole=True)


@pytest.mark.parametrize("kind", ["grid", "large", "one parameter"])
def test_other_pages_live(tmp_path, kind):
    tables = {
        "grid": lambda: make_table(grid=GRID, failures=False),
        "large": lambda: make_table(3200),
        "one parameter": lambda: make_table(40, vary={"gait.c_s": (0.8, 1.2)}),
    }
    path = tmp_path / "report.html"
    path.write_text(render(sweep_of(tables[kind]())), encoding="utf-8")
    seen = look(path, tmp_path, "const MOST = 3;" + PROBE)
    assert seen.console == []
    assert seen.told["live"]
    assert seen.told["least"] > 0
    assert "pass" in seen.told["cell"]


def test_browser_hears_errors(tmp_path):
    path = tmp_path / "bad.html"
    path.write_text("<!doctype html><html><body></body></html>", encoding="utf-8")
    assert len(look(path, tmp_path, "tell({}); nothing();").console) == 1


def test_values_at_a_limit_of_zero_are_not_drawn_as_over_it():
    none, one = (
        figures.distribution(np.array([0.0, largest]), 0.0, "mm", "shortfall") for largest in (0.0, 1.0)
    )
    assert "--bad" not in none
    assert "--bad" in one
    assert "0.0000" not in none
    assert len(re.findall(">0</text>", figures.distribution(np.array([0.5]), None, "mm", "error"))) == 1

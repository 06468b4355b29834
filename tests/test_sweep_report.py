"""A sweep's page: true to its table, self-contained, small, and alive in a browser."""

from __future__ import annotations

import base64
import json
import re
from itertools import combinations
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ampm.exceptions import InputError
from tests.browser import look
from tests.sweep_table import RANGES, make_table, replaced, write_sweep
from tests.test_report import Page
from validation.cli.app import call
from validation.study.sweep import map_data
from validation.study.sweep.report import REPORT_FILE, render, worst_rows, write_sweep_report
from validation.study.sweep.report_rows import Repeat, facts, links_of
from validation.study.sweep.table import STATES, State, SweepTable, read_sweep
from validation.study.sweep.tally import judge_sweep, share

GRID: dict[str, list[Any]] = {
    "gait.c_s": [0.6, 1.0, 1.4],
    "gait.a_s": [2.0, 2.63, float("inf")],
    "foot.schedule": ["flat", "roll"],
}


def sweep_of(table, source="sweep"):
    return SweepTable(table, json.loads(table.schema.metadata[b"ampm_sweep"]), None, source)


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


def test_a_thousand_runs_can_be_mailed(folder, html):
    assert (folder / REPORT_FILE).stat().st_size < 1_000_000  # three are allowed


def test_many_runs_make_no_larger_page():
    large = render(sweep_of(make_table(12_000)))
    assert len(large.encode()) < 2_000_000
    data = data_of(large)
    assert data["total"] == 12_000
    assert map_data.MOST_POINTS <= data["points"] < 1.2 * map_data.MOST_POINTS
    assert len(data["pairs"]) == len(RANGES) * (len(RANGES) - 1) // 2


@pytest.mark.slow
def test_a_hundred_thousand_runs_can_be_mailed():
    assert len(render(sweep_of(make_table(100_000))).encode()) < 3_000_000


def test_page_is_self_contained(html, page):
    assert not re.search(r"https?://(?!www\.w3\.org/)", html)
    assert "@import" not in html
    assert "url(" not in html.replace("url(#", "")
    allowed = ("#", "recordings/", "data:,")
    assert all(link.startswith(allowed) for link in page.links)
    assert "src" not in re.findall(r"<script[^>]*?\b(src)\b", html)


def test_page_is_well_formed(page):
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))


def test_links_lead_to_kept_runs(folder, page):
    links = [link for link in page.links if link.startswith("recordings/")]
    assert links
    assert all((folder / link).is_file() for link in links)


def test_verdict_and_counts_stand_at_the_top(folder, page):
    sweep = read_sweep(folder)
    words = " ".join(page.text.split())
    top = words[: words.index("Where it passes")]
    for state in STATES:
        if sweep.counts[state]:
            assert f"{sweep.counts[state]:,}" in top
            assert state.label in top
    assert judge_sweep(sweep).sentence in top
    for always in (
        "pass",
        "out of tolerance",
        "fell",
        "diverged",
        "infeasible",
        "refused",
        "crashed",
        "timed out",
    ):
        assert always in top


def test_sections(page):
    for phrase in (
        "Where it passes", "How far from the plan", "Worst runs", "What drives what", "Refusals",
        "switching velocity too low", "This sweep", "Versions and platform", "3.17.0", "Why these tolerances",
    ):  # fmt: skip
        assert phrase in page.text, phrase


def test_colours_are_defined(html):
    used = set(re.findall(r"var\(--([\w-]+)\)", html))
    defined = set(re.findall(r"--([\w-]+):", html))
    assert used <= defined
    assert "#0101" not in html.lower()
    assert "#0102" not in html.lower()
    assert "prefers-color-scheme: dark" in html


def test_without_scripts_there_is_a_map(html):
    still = html[html.index('id="map-still"') : html.index('id="map-live"')]
    assert "<svg" in still
    assert re.search(r'id="map-live" hidden', html)


def test_no_text_ends_the_script(html):
    # A crash of the synthetic sweep says "a worker's </script> broke".
    assert "worker" in json.dumps(data_of(html))
    assert html.lower().count("</script") == html.lower().count("<script") == 2


def test_data_say_what_the_table_says(folder, html):
    sweep, data = read_sweep(folder), data_of(html)
    assert data["points"] == data["total"] == len(sweep)
    assert np.array_equal(np.frombuffer(base64.b64decode(data["state"]), "u1"), sweep.states)
    for axis in data["axes"]:
        packed = np.frombuffer(base64.b64decode(axis["values"]), "<u2").astype(float)
        values = axis["low"] + (axis["high"] - axis["low"]) * packed / 65533
        values[packed == map_data.ABSENT] = np.nan
        if axis["parameter"]:
            expected = sweep.numbers(axis["key"])
            exact = np.frombuffer(base64.b64decode(axis["exact"]), "<f8")
            assert np.array_equal(exact, expected)
        elif axis["key"] == "used":
            expected = 100.0 * sweep.worst_used
        else:
            expected, limit, unit = sweep.shown(axis["key"].removeprefix("metric:"))
            assert axis["limit"] == limit
            assert axis["unit"] == unit
        assert values == pytest.approx(expected, abs=(axis["high"] - axis["low"]) / 65533, nan_ok=True)


def test_command_line_writes_it_again(folder, capsys):
    (folder / REPORT_FILE).unlink()
    assert call(["report", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / REPORT_FILE)
    assert (folder / REPORT_FILE).is_file()


def test_report_is_the_same_again():
    table = make_table(60)
    assert render(sweep_of(table)) == render(sweep_of(table))


# --------------------------------------------------------------------------------------- odd sweeps


@pytest.mark.parametrize("count", [1, 2, 7])
def test_small_sweeps(count):
    text = render(sweep_of(make_table(count, failures=False)))
    assert Page(text).open == []
    assert "too few" in text or count == 1


def test_one_parameter():
    data = data_of(render(sweep_of(make_table(40, vary={"gait.c_s": (0.8, 1.2)}, failures=False))))
    assert [axis["key"] for axis in data["axes"] if axis["parameter"]] == ["gait.c_s"]
    assert any(not axis["parameter"] for axis in data["axes"])


def test_nothing_varies():
    table = make_table(3, vary={"gait.c_s": (0.9, 1.1)}, failures=False)
    text = render(sweep_of(replaced(table, "gait.c_s", [1.0] * 3)))
    assert "No parameter varies" in text
    assert "<script" not in text


def test_everything_is_refused():
    table = make_table(20, vary={"gait.switching_velocity": (0.5, 0.6)})
    sweep = sweep_of(table)
    assert sweep.counts[State.REFUSED] == 20
    verdict = judge_sweep(sweep)
    assert verdict.css == "open"
    assert verdict.sentence.startswith("None of 20 runs walked; 20 refused")
    text = render(sweep)
    assert "No run walked to its end" in text
    assert Page(text).open == []


def test_words_and_infinities_are_levels():
    sweep = sweep_of(make_table(grid=GRID, failures=False))
    axes = {key: map_data.parameter_axis(sweep, key) for key in sweep.varied}
    assert axes["foot.schedule"].levels == ("flat", "roll")
    assert axes["gait.a_s"].levels == ("2", "2.63", "inf")
    text = render(sweep)
    assert Page(text).open == []
    data_of(text)  # JSON without infinities


def test_infinity_within_a_range():
    table = make_table(200)
    values = np.linspace(1.0, 5.0, 200)
    values[17] = np.inf
    sweep = sweep_of(replaced(table, "gait.a_s", values))
    axis = map_data.parameter_axis(sweep, "gait.a_s")
    packed = np.frombuffer(base64.b64decode(map_data.pack(axis, np.arange(200))), "<u2")
    if axis.levels is None:
        assert packed[17] == map_data.INFINITE
        assert axis.range == (1.0, 5.0)
    json.loads(json.dumps(data_of(render(sweep)), allow_nan=False))


def test_unfinished_sweep(tmp_path):
    table = make_table(50)
    folder = write_sweep(tmp_path / "s", table.slice(0, 30))
    sweep = read_sweep(folder)
    verdict = judge_sweep(sweep)
    assert sweep.planned == 50
    assert "20 of 50 runs are still missing" in verdict.sentence
    assert verdict.headline == "unfinished"
    assert "unfinished" in (write_sweep_report(folder)).read_text(encoding="utf-8")


def test_mixed_versions_are_flagged(page):
    assert "mixed:" not in page.text
    table = make_table(40, environment={"environment_revision": ["a" * 40] * 20 + ["b" * 40] * 20})
    text = Page(render(sweep_of(table))).text
    assert "mixed:" in text
    assert "not one measurement" in text
    table = make_table(40, environment={"environment_modified": True})
    assert "the revision alone does not reproduce them" in Page(render(sweep_of(table))).text


def test_text_is_escaped():
    table = make_table(40)
    table = replaced(table, "cause", ["<img src=x onerror=alert(1)>"] * 40)
    text = render(sweep_of(table))
    assert "<img" not in text


@pytest.mark.parametrize(
    "name", ["../../etc", "/etc", "https://example.org/x", "a\\..\\b", "javascript:alert(1)"]
)
def test_only_links_beside_the_page(name):
    table = make_table(5, failures=False)
    assert links_of(sweep_of(replaced(table, "recording", [name] + [None] * 4))) == {}


def test_folders_that_hold_no_sweep(tmp_path):
    with pytest.raises(InputError, match="there is no"):
        read_sweep(tmp_path / "absent")
    with pytest.raises(InputError, match="holds no sweep"):
        read_sweep(tmp_path)
    (tmp_path / "x.parquet").write_bytes(b"PAR1 nonsense")
    with pytest.raises(InputError, match="can be read"):
        read_sweep(tmp_path / "x.parquet")
    pq.write_table(pa.table({"a": [1]}), tmp_path / "y.parquet")
    with pytest.raises(InputError, match="no table of a sweep"):
        read_sweep(tmp_path / "y.parquet")


def test_unknown_outcome_is_an_error():
    table = replaced(make_table(3, failures=False), "outcome", ["completed", "flew", "completed"])
    with pytest.raises(InputError, match="run 1 has the outcome 'flew'"):
        render(sweep_of(table))


# -------------------------------------------------------------------------------------------- parts


def test_verdict_of_a_sweep():
    assert judge_sweep(sweep_of(make_table(30, failures=False, vary={"gait.c_y": (0.9, 1.1)}))).css == "pass"
    assert judge_sweep(sweep_of(make_table(1000))).css == "fail"
    late = replaced(
        make_table(3, failures=False, vary={"gait.c_y": (0.9, 1.1)}), "outcome", ["timed_out"] * 3
    )
    late = replaced(late, "verdict", [None] * 3)
    assert judge_sweep(sweep_of(late)).css == "open"


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
    lost, furthest = worst_rows(sweep)
    assert {STATES[sweep.states[row]] for row in lost} <= {State.FELL, State.DIVERGED, State.INFEASIBLE}
    used = sweep.worst_used[furthest]
    assert (np.diff(used) <= 0).all()
    assert used[0] == np.nanmax(sweep.worst_used)
    assert used[0] > 1.0


def test_forces_are_judged_in_body_weights():
    table = replaced(make_table(4, failures=False), "body.mass", [30.0, 60.0, 90.0, 120.0])
    sweep = sweep_of(replaced(table, "metric_force_x_rmse", [2.0] * 4))
    assert sweep.used("force_x_rmse") == pytest.approx(2.0 / (0.008 * 9.81 * np.array([30, 60, 90, 120])))
    values, limit, unit = sweep.shown("force_x_rmse")
    assert values == pytest.approx(100 * 2.0 / (9.81 * np.array([30, 60, 90, 120])))
    assert (limit, unit) == (pytest.approx(0.8), "% of body weight")


def test_a_tolerance_of_zero():
    table = replaced(make_table(2, failures=False), "metric_failed_qp", [0.0, 1.0])
    assert sweep_of(table).used("failed_qp").tolist() == [0.0, np.inf]


def test_unsolved_problems_are_counted():
    table = make_table(20, failures=False)
    sweep = sweep_of(replaced(table, "metric_failed_qp", [4.0] * 12 + [0.0] * 8))
    found = dict(facts(sweep))
    assert found["over a limit of 0 (unsolved QPs)"] == "12 of 20"
    assert re.fullmatch(r"\d+\u00a0%", found["of its tightest tolerance above 0, the median run uses"])
    text = Page(render(sweep)).text
    assert "inf\u00a0%" not in text
    assert "unsolved QPs: 4, limit 0" in text
    assert "4.00" not in text
    assert not any("limit of 0" in label for label, _ in facts(sweep_of(table)))


def test_a_run_is_repeated_with_every_digit(folder):
    from ampm.parameters import load_run

    sweep = read_sweep(folder)
    command = Repeat.of(sweep).command(sweep, 5).split()
    assert command[:3] == ["ampm", "validate", "normal"]
    settings = [command[i + 1] for i, word in enumerate(command) if word == "--set"]
    run = load_run("normal", [*settings, f"gait.steps={command[command.index('--steps') + 1]}"])
    for key in sweep.parameters:
        section, _, leaf = key.partition(".")
        assert getattr(getattr(run, section), leaf) == sweep.table.column(key)[5].as_py(), key


def test_counts_of_cells_are_exact():
    sweep = sweep_of(make_table(500))
    axes = [map_data.parameter_axis(sweep, key) for key in sweep.varied[:3]]
    for a, b in combinations(axes, 2):
        raw = base64.b64decode(map_data.pack_cells(a, b, sweep.states))
        counts, place = [], 0
        while place < len(raw):
            value, shift = 0, 0
            while raw[place] > 127:
                value |= (raw[place] & 127) << shift
                shift, place = shift + 7, place + 1
            counts.append(value | raw[place] << shift)
            place += 1
        cube = np.array(counts).reshape(map_data.CELLS, map_data.CELLS, len(STATES))
        assert cube.sum() == 500
        assert cube.sum(axis=(0, 1)).tolist() == list(sweep.counts.values())
        low, high = a.range
        column = np.minimum(
            ((a.values - low) / (high - low) * map_data.CELLS).astype(int), map_data.CELLS - 1
        )
        assert cube.sum(axis=(0, 2)).tolist() == np.bincount(column, minlength=map_data.CELLS).tolist()


def test_varint():
    assert map_data.varint(np.array([0, 1, 127, 128, 300, 100_000])) == bytes(
        [0, 1, 127, 128, 1, 172, 2, 160, 141, 6]
    )


def test_rare_runs_are_drawn():
    sweep = sweep_of(make_table(9000))
    rows = map_data.drawn_rows(sweep, [4321])
    assert 4321 in rows
    assert len(rows) == len(set(rows.tolist()))
    for number, state in enumerate(STATES):
        drawn = int((sweep.states[rows] == number).sum())
        assert drawn >= min(sweep.counts[state], map_data.MOST_OF_RARE)


# ---------------------------------------------------------------------------------------- in a browser

PROBE = """
const live = document.getElementById("map-live"), still = document.getElementById("map-still");
const part = (name) => live.querySelector(`[data-part="${name}"]`);
const small = document.createElement("canvas"), c = small.getContext("2d", { willReadFrequently: true });
small.width = 200; small.height = 120;
const ink = (canvas) => {
  c.clearRect(0, 0, 200, 120); c.drawImage(canvas, 0, 0, 200, 120);
  const d = c.getImageData(0, 0, 200, 120).data;
  let n = 0; for (let k = 3; k < d.length; k += 4) n += d[k] > 0; return n / (d.length / 4); };
const choose = (name, value) => { part(name).value = value; part(name).dispatchEvent(new Event("change")); };
const canvas = part("canvas"), inks = {};
const keys = [...part("x").options].map((o) => o.value);
for (const x of keys.slice(0, 8)) for (const y of keys.slice(0, 2)) for (const view of ["points", "cells"]) {
  choose("x", x); choose("y", y); choose("view", view); inks[[x, y, view]] = ink(canvas);
}
for (const colour of [...part("colour").options].map((o) => o.value)) {
  choose("colour", colour); inks[`c ${colour}`] = ink(canvas);
}
choose("colour", ""); choose("x", keys[0]); choose("y", keys[1]); choose("view", "points");
canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
const picked = part("picked").textContent;
choose("view", "cells");
const r = canvas.getBoundingClientRect();
const tips = [];
for (let f = .15; f < 1; f += .1) {
  const at = { clientX: r.left + f * r.width, clientY: r.top + f * .85 * r.height, bubbles: true };
  canvas.dispatchEvent(new PointerEvent("pointermove", at));
  if (!part("tip").hidden) tips.push(part("tip").textContent);
  canvas.dispatchEvent(new MouseEvent("click", at));
}
part("legend").querySelector("button").click();
tell({ live: !live.hidden, still: still.hidden, keys, picked, tips, least: Math.min(...Object.values(inks)),
  legend: part("legend").textContent, width: innerWidth, scroll: document.documentElement.scrollWidth,
  dark: matchMedia("(prefers-color-scheme: dark)").matches,
  page: getComputedStyle(document.body).backgroundColor });
"""


@pytest.mark.parametrize(
    ("size", "dark"), [((1366, 768), False), ((390, 844), True)], ids=["laptop light", "phone dark"]
)
def test_page_lives(folder, html, tmp_path, size, dark):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    seen = look(path, tmp_path, PROBE, size=size, dark=dark)
    assert seen.console == []
    told = seen.told
    assert told["live"]
    assert told["still"]
    assert set(RANGES) < set(told["keys"])
    assert told["least"] > 0.005  # every choice draws something
    assert re.search(r"run 0000: \w+", told["picked"])
    assert "ampm validate normal" in told["picked"]
    assert told["tips"]
    assert all(re.match(r"[\d,]+ runs?", tip) for tip in told["tips"])
    assert "refused" in told["legend"]
    assert told["scroll"] <= told["width"]  # nothing sticks out sideways
    assert told["dark"] is dark
    assert told["page"] == ("rgb(20, 23, 27)" if dark else "rgb(251, 251, 250)")


@pytest.mark.parametrize("size", [(390, 844), (600, 800), (1366, 768)])
def test_nothing_decisive_is_hidden(folder, html, tmp_path, size):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    probe = """
    const inside = (cell) => {
      const box = cell.getBoundingClientRect(), card = cell.closest(".card").getBoundingClientRect();
      return box.width > 0 && box.left >= card.left && box.right <= card.right;
    };
    const table = (name) => document.querySelector(`table.${name}`);
    tell({
      head: table("figures").rows[0].cells[1].textContent,
      over: [...table("figures").rows].filter((r) => r.cells.length > 1).map((r) => inside(r.cells[1])),
      clear: [...document.querySelectorAll(".matrix .clear")].map(inside),
      fits: [table("figures"), table("matrix")].map((t) => t.parentElement)
        .every((card) => card.scrollWidth <= card.clientWidth),
    });
    """
    told = look(path, tmp_path, probe, size=size).told
    assert told["head"] == "over"
    assert len(told["over"]) > 10
    assert all(told["over"])
    assert len(told["clear"]) > 5
    assert all(told["clear"])
    assert told["fits"]


@pytest.mark.parametrize("kind", ["grid", "large", "one parameter"])
def test_other_pages_live(tmp_path, kind):
    tables = {
        "grid": lambda: make_table(grid=GRID, failures=False),
        "large": lambda: make_table(4200),
        "one parameter": lambda: make_table(40, vary={"gait.c_s": (0.8, 1.2)}),
    }
    path = tmp_path / "report.html"
    path.write_text(render(sweep_of(tables[kind]())), encoding="utf-8")
    seen = look(path, tmp_path, PROBE)
    assert seen.console == []
    assert seen.told["live"]
    assert seen.told["tips"]


def test_browser_hears_errors(tmp_path):
    path = tmp_path / "bad.html"
    path.write_text("<!doctype html><html><body></body></html>", encoding="utf-8")
    assert len(look(path, tmp_path, "tell({}); nothing();").console) == 1

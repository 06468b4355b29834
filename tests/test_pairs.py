"""Walks side by side: which differences count, and what is compared of finished runs, gaits and planners."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from ampm.run_file import load_run
from tests.saved_run import make_study
from validation.judge.metrics import added_metrics, unregister
from validation.judge.uncertainty import Uncertainty
from validation.store.environment import parameter_values
from validation.store.json import json_ready
from validation.store.saved import load_saved_run
from validation.study.compare.comparison import (
    JUDGED,
    SHARE,
    SHARE_OF_EXTREMES,
    MetricRow,
    Side,
    _fitting,
    comparison_of,
)
from validation.study.compare.report import NUMBERS, REPORT, render

FAST = ["--set", "simulation.time_step=0.002", "--steps", "3", "--workers", "0"]


@pytest.fixture(scope="module")
def folders(run_of):
    return run_of(), run_of("normal", {"gait.planner": "ipm"})


@pytest.fixture(scope="module")
def sides(folders):
    return [
        Side(name, load_saved_run(folder)) for name, folder in zip(("smooth", "jumps"), folders, strict=True)
    ]


def test_finished_runs_of_two_planners(folders, tmp_path, ampm):
    out = tmp_path / "both"
    answer = ampm("compare", *folders, "--out", out, "--json")
    found = answer.json
    assert answer.status == 0
    assert json.loads((out / NUMBERS).read_text(encoding="utf-8")) == found
    zmp = found["metrics"]["zmp_x_rmse"]
    assert zmp["values"][0] < 1e-3 < zmp["values"][1]
    assert (zmp["group"], zmp["better"]) == (JUDGED, 0)
    assert found["parameters"] == {"gait.planner": ["ampm", "ipm"]}
    assert f"{100 * SHARE:g} %" in found["walks"][0]["differences_count_from"]
    page = (out / REPORT).read_text(encoding="utf-8")
    assert found["sentence"] in page
    assert f"{folders[1].name}, planner ipm" in page
    assert page.count('<li><i style="background:#') == 2
    assert page.count("<img alt=") == 6
    assert ampm("compare", *folders, "--out", out).status == 2


def test_a_table_beside_our_planner_is_walked_once(tmp_path, ampm, monkeypatch):
    table, out = tmp_path / "ipm.csv", tmp_path / "both"
    samples = ["--samples", table, "--rate", "1000"]
    assert ampm("plan", "flat", "--planner", "ipm", "--steps", "3", *samples).status == 0
    command = ["compare", "flat", "--planner", "ampm", "--planner", table, *FAST, "--out", out, "--json"]
    first = ampm(*command)
    assert first.status == 0
    assert [walk["label"] for walk in first.json["walks"]] == ["flat, planner ampm", "flat, planner ipm.csv"]
    assert first.json["sentence"].startswith("flat, planner ampm is better in ")
    assert first.json["metrics"]["zmp_x_maximum"]["better"] == 0
    assert 'href="walk-2/report.html"' in (out / REPORT).read_text(encoding="utf-8")
    assert (out / "walk-2" / REPORT).is_file()
    monkeypatch.setattr(
        "validation.study.compare.comparison.walk_request", lambda *_, **__: pytest.fail("walked")
    )
    assert ampm(*command, "--resume").json == first.json


GAIN = """
from ampm.control.joint_pd import JointPD

class Own(JointPD):
    def __init__(self, robot, run, gain=1.0):
        super().__init__(robot, run)
"""


def test_options_are_for_those_that_take_them(tmp_path, ampm, monkeypatch):
    (tmp_path / "own_gain.py").write_text(GAIN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    table = tmp_path / "table.csv"
    table.write_text("time\n", encoding="utf-8")
    chosen = [{"controller": "ampm", "planner": str(table)}, {"controller": "own_gain:Own"}]
    gain, none = "controller.options.gain=2", "controller.options.none=2"
    assert _fitting([gain, "gait.steps=3"], chosen) == [["gait.steps=3"], [gain, "gait.steps=3"]]
    assert _fitting([none], chosen) == [[none], [none]]  # refused
    answer = ampm("compare", "--controller", "ampm", "--controller", "own_gain:Own", "--set", none)
    assert answer.status == 2
    assert "it takes" in answer.err


def test_bodies_of_two_sizes_are_told_and_scaled_each_by_its_own_weight(sides):
    scales = sides[0].run.summary["scales"]
    heavy = changed(sides[0], scales={**scales, "body_weight": 2.0 * scales["body_weight"]})
    found = comparison_of([sides[0], replace(heavy, label="heavy")])
    assert any(note.startswith("The bodies differ in size") for note in found.tables()[0].notes)
    row = next(row for row in found.rows if row.name == "force_z_rmse")
    light, half = (float(cell) for cell in found.cells(row)[1:3])
    assert light == pytest.approx(2.0 * half, rel=0.02)
    assert not any("differ in size" in note for note in comparison_of(sides).tables()[0].notes)


def test_two_equal_plans_agree(ampm):
    answer = ampm("compare", "normal", "--planner", "ampm", "--planner", "dcm", *FAST)
    assert answer.out.splitlines()[0].startswith("normal, planner ampm and normal, planner dcm agree: ")
    assert f"{100 * SHARE:g} %" in answer.out


@pytest.mark.parametrize(
    ("values", "least", "better"),
    [
        ((1.0, 2.0), 0.5, 0),
        ((2.0, 1.0), 0.5, 1),
        ((1.0, 2.0), 1.0, None),
        ((1.0, 9.0), math.inf, None),
        ((3.0, 1.0, 2.0), 0.5, 1),
        ((3.0, 1.0, 1.2), 0.5, None),
        ((3.0, 1.0, math.nan), 0.5, None),
    ],
)
def test_which_side_is_better(values, least, better):
    assert MetricRow(JUDGED, "zmp_x_rmse", "ZMP", "m", values, least).better == better


def changed(side: Side, metrics: dict[str, float] | None = None, **summary) -> Side:
    """A side with other metrics, in SI units, and other entries of its summary."""
    entries = dict(side.run.summary["metrics"])
    entries |= {name: {**entries[name], "value": value} for name, value in (metrics or {}).items()}
    return replace(side, run=replace(side.run, summary={**side.run.summary, "metrics": entries, **summary}))


def test_one_sentence_says_who_is_better_and_where_most(sides):
    a, b = sides[0], replace(sides[0], label="other")
    assert comparison_of([a, b]).sentence.startswith("smooth and other agree: ")
    worse = comparison_of([a, changed(b, {"zmp_x_rmse": 2e-3, "force_x_rmse": 5.0, "zmp_y_rmse": 1e-5})])
    words = "smooth is better in 2, other is better in 1 of 11 judged metrics by more than 10 %"
    assert worse.sentence.startswith(words)
    assert "they differ most in ground force, RMS error along x: 0.18" in worse.sentence
    fell = changed(b, outcome="fell", end={"time": 2.3, "cause": ""})
    assert comparison_of([a, fell]).sentence == (
        "smooth walked to the end, other did not walk to the end (fell after 2.30 s)."
    )


def test_a_study_takes_the_place_of_the_share_and_rounding_never_counts(sides):
    side = sides[0]
    assert side.change("zmp_x_rmse", "m") == pytest.approx(SHARE * side.value("zmp_x_rmse"))
    largest = side.value("zmp_x_maximum")
    assert side.change("zmp_x_maximum", "m") == pytest.approx(SHARE_OF_EXTREMES * largest)
    studied = replace(side, study=Uncertainty("a", 6, {"zmp_x_rmse": 1e-3, "zmp_y_rmse": 0.0}))
    assert studied.change("zmp_x_rmse", "m") == 1e-3
    assert studied.change("zmp_y_rmse", "m") == pytest.approx(1e-6 * side.value("zmp_y_rmse"))
    more = {"zmp_x_rmse": 1.15 * side.value("zmp_x_rmse"), "zmp_x_maximum": 1.35 * largest}
    rows = {row.name: row.better for row in comparison_of([side, changed(side, more)]).rows}
    assert (rows["zmp_x_rmse"], rows["zmp_x_maximum"]) == (0, None)
    equal = comparison_of([changed(side, {"failed_qp": 0.0, "zmp_x_rmse": v}) for v in (0.0, 1e-14)])
    assert all(row.better is None for row in equal.rows)


def test_a_study_must_be_of_both_gaits(folders, tmp_path, ampm):
    parameters = json_ready(parameter_values(load_run(folders[0] / "run.toml")))
    make_study(tmp_path, {"zmp_x_rmse": 1e-3}, parameters=parameters)
    same = ampm("compare", folders[0], folders[0], "--uncertainty", tmp_path, "--json")
    assert same.json["metrics"]["zmp_x_rmse"]["least"] == pytest.approx(2e-3)
    assert [walk["label"][-4:] for walk in same.json["walks"]] == [" (1)", " (2)"]
    other = ampm("compare", *folders, "--uncertainty", tmp_path)
    assert other.status == 2
    assert "gait.planner" in other.err


def test_refused_and_fallen_walks_are_told_by_the_status(sides, ampm, monkeypatch):
    refused = ampm("compare", "normal", "ipm", "--set", "gait.step_length=3", "--as-is", "--workers", "0")
    assert refused.status == 2
    assert refused.err.count("\n") <= 3
    found = comparison_of([sides[0], changed(sides[1], outcome="fell")])
    monkeypatch.setattr("validation.study.compare.comparison.compare_gaits", lambda *_, **__: found)
    assert ampm("compare").status == 3


def test_a_page_escapes_names(sides):
    page = render(comparison_of([replace(sides[0], label="<script>"), sides[1]]), Path())
    assert "<script>" not in page


OWN = """
import validation as val

HEIGHT = val.Metric(
    name="height_error", unit="m", label="height of the COM, largest error", kind="walk",
    meaning="of the COM",
    compute=lambda walk: abs((walk.measured.com - walk.sample.com)[walk.inside, 2]).max(),
    tolerances={"default": 0.01}, reason="More than 1 cm is visible.",
)

class Rope:
    def apply(self, time, plant):
        plant.push("chest", (0.0, -50.0 * plant.position("com")[1], 0.0))
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A module of a user's in the working directory."""
    (tmp_path / "own_parts.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    yield "own_parts"
    sys.modules.pop("own_parts", None)
    if any(metric.name == "height_error" for metric in added_metrics()):
        unregister("height_error")


def test_own_metrics_and_disturbances_of_saved_runs_are_compared(own, folders, tmp_path, ampm):
    mine = tmp_path / "mine"
    more = ["--metric", f"{own}:HEIGHT", "--disturbance", f"{own}:Rope"]
    assert ampm("validate", "normal", *FAST[:4], *more, "--out", mine).status == 1
    unregister("height_error")  # another process would not know it
    told = ampm("compare", mine, folders[0], folders[1])
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in told.out.splitlines() if "│" in line]
    values = {name: cells for name, *cells in rows}
    assert values["disturbances"] == ["own_parts:Rope", "none", "none"]
    assert values["planner"] == ["ampm", "ampm", "ipm"]
    assert 0.0 < float(values["height of the COM, largest error"][0]) < 10.0
    assert values["height of the COM, largest error"][1:4] == ["–", "–", "mm"]
    assert values["verdict"][0] == "fail"
    assert told.out.splitlines()[0].startswith(f"mine, {folders[0].name} and {folders[1].name} differ in ")
    assert "nothing is kept; --out DIR keeps" in told.err

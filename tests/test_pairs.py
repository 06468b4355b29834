"""Walks side by side: which differences count, and what is compared of finished runs, gaits and planners."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from markupsafe import Markup

from ampm import InputError, load_run
from ampm import plan as plan_of
from tests.saved_run import make_study
from tests.test_controllers import JOINT_PD
from validation.judge.uncertainty import Uncertainty
from validation.store.environment import parameter_values
from validation.store.json import json_ready
from validation.store.saved import load_saved_run
from validation.study.compare import comparison
from validation.study.compare.comparison import JUDGED, SHARE, MetricRow, Side, WalkComparison
from validation.study.compare.report import COMPARISON_FILE, REPORT, draw_walks, render
from validation.study.robustness.cells import Cell
from validation.study.robustness.study import CellResult, Robustness

PLANNERS = {"gait.planner": ["ampm", "dcm"]}
FAST = ["--set", "simulation.time_step=0.002", "--steps", "3", "--workers", "0"]


@pytest.fixture(scope="module")
def folders(run_of):
    return run_of(), run_of("normal", {"gait.planner": "ipm"})


@pytest.fixture(scope="module")
def sides(folders):
    return [Side(name, load_saved_run(at)) for name, at in zip(("smooth", "jumps"), folders, strict=True)]


def test_finished_runs_of_two_planners(folders, tmp_path, ampm):
    out = tmp_path / "both"
    answer = ampm("compare", *folders, "--out", out, "--json")
    found, kept = answer.json, json.loads((out / COMPARISON_FILE).read_text(encoding="utf-8"))
    assert answer.status == 0
    assert kept == found | {"walks": kept["walks"]}  # with the places of the runs
    zmp = found["metrics"]["zmp_x_rmse"]
    assert zmp["values"][0] < 1.0 < zmp["values"][1]
    assert (zmp["group"], zmp["better"]) == (JUDGED, 0)
    assert found["parameters"] == {"gait.planner": ["ampm", "ipm"]}
    speed = load_run(folders[0] / "run.toml").gait.step_length / plan_of("normal").constants.step_duration
    assert found["walks"][0]["planned"]["planned speed [m/s]"] == pytest.approx(speed, rel=0.01)
    page = (out / REPORT).read_text(encoding="utf-8")
    assert str(Markup.escape(found["sentence"])) in page
    for walk, folder in zip(kept["walks"], folders, strict=True):
        assert (out / walk["run"]).samefile(folder)
        assert f'<a href="{walk["run"]}/recording.rrd">' in page
        assert (folder / "recording.rrd").is_file()
    assert (ampm("report", out).status, (out / REPORT).read_text(encoding="utf-8")) == (0, page)
    assert page.count("<img alt=") == 6


def test_a_table_beside_our_planner_is_walked_once(tmp_path, ampm, monkeypatch):
    table, out = tmp_path / "ipm.csv", tmp_path / "both"
    samples = ["--samples", table, "--rate", "1000"]
    assert ampm("plan", "flat", "--planner", "ipm", "--steps", "3", *samples).status == 0
    command = ["compare", "flat", "--planner", "ampm", "--planner", table, *FAST, "--out", out, "--json"]
    first = ampm(*command)
    assert first.status == 0
    assert [walk["label"] for walk in first.json["walks"]] == ["ampm", "ipm.csv"]
    assert first.json["metrics"]["zmp_x_maximum"]["better"] == 0
    assert (out / "walk-2" / REPORT).is_file()
    monkeypatch.setattr("validation.study.many.walk_request", lambda *_, **__: pytest.fail("walked"))
    assert ampm(*command, "--resume").json == first.json


@pytest.mark.parametrize(
    ("gaits", "choices", "labels"),
    [
        ([], {}, ["normal", "ipm"]),
        (["flat"], {"gait.planner": ["dcm"]}, ["ampm", "dcm"]),
        (["flat"], {"body.source": ["suite-humanoid"]}, ["ampm", "ipm"]),
        (["flat"], PLANNERS | {"controller.name": ["ampm"]}, ["ampm", "dcm"]),
        (["flat"], PLANNERS | {"controller.name": ["ampm", JOINT_PD]}, ["ampm, ampm", f"dcm, {JOINT_PD}"]),
        (["flat", "normal"], PLANNERS, ["flat", "normal"]),
    ],
)
def test_options_may_vary_together(monkeypatch, gaits, choices, labels):
    monkeypatch.setattr(comparison, "walk_many", lambda *_, **__: ())
    monkeypatch.setattr(comparison, "plan_walk", lambda request, _: SimpleNamespace(request=request))
    monkeypatch.setattr(comparison, "compare_runs", lambda folders, labels, *_: labels)
    assert comparison.compare_gaits(gaits, choices=choices) == labels


def test_bodies_of_two_sizes_are_told_and_compared_in_shares_of_their_size(sides):
    scales = sides[0].run.summary["scales"]
    assert not any("differ in size" in note for note in WalkComparison(sides).tables()[0].notes)
    twice = {**scales, "foot_length": 2.0 * scales["foot_length"]}
    large = changed(sides[0], {"zmp_x_rmse": 2.0 * sides[0].number("zmp_x_rmse")}, scales=twice)
    found = WalkComparison([sides[0], replace(large, label="large")])
    assert any(note.startswith("The bodies differ in size") for note in found.tables()[0].notes)
    rows = {row.name: row for row in found.rows}
    assert rows["zmp_x_rmse"].unit == "% of foot"
    assert rows["zmp_x_rmse"].values == pytest.approx([rows["zmp_x_rmse"].values[0]] * 2)
    assert rows["zmp_y_rmse"].better == 1
    assert (rows["zmp_x_rmse"].better, rows["force_x_rmse"].better) == (None, None)


@pytest.mark.parametrize(
    ("values", "doubt", "better"),
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
def test_which_side_is_better(values, doubt, better):
    assert MetricRow(JUDGED, "zmp_x_rmse", "ZMP", "m", values, doubt).better == better
    room = MetricRow(JUDGED, "margin_knee", "knee", "rad", tuple(-value for value in values), doubt)
    assert room.better == better


def test_a_limit_of_zero_is_kept_by_zero_alone():
    row = MetricRow(JUDGED, "failed_qp", "unsolved QPs", "1", (0.0, 2.0, math.nan), 0.0, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(row.used, [0.0, math.inf, math.nan])


def changed(side: Side, metrics: dict[str, float] | None = None, **summary) -> Side:
    """A side with other metrics, in SI units, and other entries of its summary."""
    entries = dict(side.run.summary["metrics"])
    entries |= {name: {**entries[name], "value": value} for name, value in (metrics or {}).items()}
    return replace(side, run=replace(side.run, summary={**side.run.summary, "metrics": entries, **summary}))


def test_the_conclusion_says_who_tracks_best_at_which_cost_and_how_near_to_limits(sides):
    a, b = sides[0], replace(sides[0], label="other")
    equal = WalkComparison([a, b]).sentence
    assert equal.startswith("smooth and other track the ZMP equally well: the difference is")
    nearest = "(largest torque, of the motor's limit, 78 % and 78 %)"
    assert f"smooth and other stayed below every limit {nearest}" in equal
    margins = json.loads(json.dumps(a.run.summary["margins"]))
    margins["torque"]["value"] *= 1.12
    margins["friction"]["value"] *= 2.5
    spent = changed(b, {"zmp_x_rmse": 2e-3, "zmp_y_rmse": 1e-5, "force_x_rmse": 50.0}, margins=margins)
    said = WalkComparison([a, spent]).sentence
    assert re.match(r"smooth tracks the ZMP best along x \(.*\), other tracks the ZMP best along y \(", said)
    assert "other takes 12 % more torque relative to limits than smooth and uses 2.5 times as much fr" in said
    assert "other exceeded 1 of 13 limits (ground force, RMS error along x, " in said
    margins["torque"]["value"] = 1.0
    said = WalkComparison([a, changed(b, margins=margins)]).sentence
    assert "other reached a limit (largest torque, of the motor's limit, 100 %)" in said
    no = dict.fromkeys(("zmp_x_rmse", "zmp_y_rmse"), math.nan)
    said = WalkComparison([a, changed(b, no, margins={**margins, "torque": None, "friction": None})]).sentence
    assert said.startswith("No error of the ZMP is judged in every walk. No difference in mech")
    said = WalkComparison([a, changed(b, verdict="not_measured", profile="jumps")]).sentence
    assert re.search(r"smooth stayed below .* default \(.*other was not measured by .* jumps \(", said)
    fell = WalkComparison([a, changed(b, outcome="fell", end={"time": 2.3, "cause": ""}, steps_completed=2)])
    assert fell.sentence.endswith("other did not walk to the end (fell after 2.30 s).")
    assert ("steps completed", "8", "2") in fell.tables()[0].rows
    fallen = WalkComparison([changed(a, outcome="fell"), replace(sides[1], label="jumps")])
    cells = [cell for table in fallen.tables()[1:3] for row in table.rows for cell in (row[-1], *row[2:5:2])]
    assert not {"smooth", "0 %"} & {*cells}  # of a limit of zero there is no share


def test_a_study_takes_the_place_of_the_share_and_rounding_never_counts(sides):
    side = sides[0]
    assert side.doubt("zmp_x_rmse", "m") == pytest.approx(SHARE * side.number("zmp_x_rmse"))
    assert side.doubt("zmp_x_maximum", "m") == pytest.approx(SHARE * side.number("zmp_x_maximum"))
    small = changed(side, margins={"measured_polygon": {"value": 1e-5}})  # whose share would be nothing
    assert small.doubt("margin_measured_polygon", "m") == 1e-3
    studied = replace(side, study=Uncertainty("a", 6, {"zmp_x_rmse": 1e-3, "zmp_y_rmse": 0.0}))
    assert studied.doubt("zmp_x_rmse", "m") == 1e-3
    doubts = [studied.doubt("zmp_y_rmse", unit) for unit in ("m", "rad")]  # of a unit without a floor, too
    assert doubts == pytest.approx([1e-6 * side.number("zmp_y_rmse")] * 2)
    twice = changed(side, {"zmp_x_rmse": 2.0 * side.number("zmp_x_rmse")})
    row = next(row for row in WalkComparison([side, twice]).rows if row.name == "zmp_x_rmse")
    assert row.doubt == pytest.approx(SHARE * row.values[0])  # of the smaller value
    other = replace(twice, study=Uncertainty("b", 6, {"zmp_x_rmse": 2e-3}))
    row = next(row for row in WalkComparison([studied, other]).rows if row.name == "zmp_x_rmse")
    assert row.doubt == pytest.approx(2.0)  # the larger uncertainty [mm]


def test_causes_and_robustness_stand_side_by_side(sides, folders, tmp_path, ampm):
    cell = Cell("push forward", "pushes", (0.1, 0.2))
    study = Robustness("normal", "ampm", "human", "ampm", 5, (CellResult(cell, survived=0.1),))
    found = WalkComparison([replace(sides[0], robustness=study), sides[1]])
    tables = {table.title: table for table in found.tables()}
    assert tables["robustness"].rows == [("push forward", "m/s", "0.1")]
    causes = tables["causes of the ZMP error, RMS"]
    assert causes.headers == ["cause", "smooth, x", "jumps, x", "smooth, y", "jumps, y", "unit"]
    assert float(causes.rows[1][1]) < float(causes.rows[1][2])
    unplanned = changed(sides[0], zmp_error_split={"rmse": dict.fromkeys(comparison.PARTS, (None, None))})
    assert "causes" not in str([table.title for table in WalkComparison([unplanned] * 2).tables()])
    for name, planner in (("robustness.json", "ampm"), ("other.json", "ipm")):
        (tmp_path / name).write_text(json.dumps(replace(study, planner=planner).as_dict()), encoding="utf-8")
    both = [f"--robustness={tmp_path}", f"--robustness={tmp_path / 'other.json'}"]
    assert "push forward" in ampm("compare", *folders, *both).out
    assert "of normal, ipm, human, ampm, and" in ampm("compare", *folders, *both[::-1]).err
    with_settings = replace(study, gait="normal, controller.stabilizer stepping")
    assert replace(sides[0], robustness=with_settings).robustness


def test_a_study_must_be_of_both_gaits(folders, sides, tmp_path, ampm, monkeypatch):
    parameters = json_ready(parameter_values(load_run(folders[0] / "run.toml")))
    make_study(tmp_path, {"zmp_x_rmse": 1e-3}, parameters=parameters)
    same = ampm("compare", folders[0], folders[0], "--uncertainty", tmp_path, "--json")
    assert same.json["metrics"]["zmp_x_rmse"]["doubt"] == pytest.approx(1.0)
    assert [walk["label"][-4:] for walk in same.json["walks"]] == [" (1)", " (2)"]
    other = ampm("compare", *folders, "--uncertainty", tmp_path)
    assert other.status == 2
    assert "gait.planner" in other.err
    pushed = changed(sides[0], disturbances=["push of (30, 0, 0) N"]).run
    monkeypatch.setattr(comparison, "load_saved_run", lambda folder: pushed)
    with pytest.raises(InputError, match="holds for no walk with push of"):
        comparison.compare_runs(folders, uncertainty=[tmp_path])


def test_refused_and_fallen_walks_are_told_by_the_status(sides, ampm, monkeypatch):
    refused = ampm("compare", "normal", "ipm", "--set", "gait.step_length=3", "--as-is", "--workers", "0")
    assert refused.status == 2
    assert refused.err.count("\n") <= 3
    found = WalkComparison([sides[0], changed(sides[1], outcome="fell")])
    monkeypatch.setattr("validation.study.compare.comparison.compare_gaits", lambda *_, **__: found)
    assert ampm("compare").status == 3


def test_curves_share_a_clock_if_a_walk_has_no_stride(sides):
    run = sides[1].run
    short = replace(run, signals=run.signals.take(np.arange(300)))
    for second, title in ((run, "two steps"), (short, "whole run")):
        (_, _), pictures = draw_walks([sides[0], replace(sides[1], run=second)])
        (chart,) = pictures[0].charts
        assert title in chart.title
        assert max(np.nanmax(np.abs(mark.points[:, 1])) for mark in chart.marks if mark.label) < 300.0  # [mm]
        lengths = [mark.points[-1, 0] for mark in chart.marks if mark.label]
        whole = [side.signals.time[-1] for side in (sides[0].run, second)]
        assert (lengths == pytest.approx(whole, abs=0.01)) == (title == "whole run")


def test_an_interrupted_comparison_without_a_folder_promises_none(monkeypatch, tmp_path):
    def interrupt(**options):
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison, "keep_run", interrupt)
    for out, notes in ((None, 0), (tmp_path / "both", 1)):
        with pytest.raises(KeyboardInterrupt) as caught:
            comparison.compare_gaits(["flat", "ipm"], workers=0, out=out)
        assert len(getattr(caught.value, "__notes__", [])) == notes


def test_a_page_escapes_names(sides):
    page = render(WalkComparison([replace(sides[0], label="<script>"), sides[1]]), Path())
    assert "<script>" not in page

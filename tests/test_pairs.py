"""Two walks side by side: jumps read from stored plans of any planner, and which differences count."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ampm.exceptions import InputError
from ampm.run_file import load_run
from tests.saved_run import make_study
from validation.judge.metrics import added_metrics, unregister
from validation.judge.uncertainty import Uncertainty
from validation.store.identity import parameter_values
from validation.store.json import json_ready
from validation.store.signals import Signals
from validation.study.compare.comparison import SHARE, Row, Side, comparison_of, load_side
from validation.study.compare.metrics import JUDGED, PLAN, SWITCH, Quantity, plan_values
from validation.study.compare.report import NUMBERS, REPORT, render
from validation.study.compare.walks import compare_walks

FAST = ["--set", "simulation.time_step=0.002", "--steps", "3", "--workers", "0"]


@pytest.fixture(scope="module")
def folders(run_of):
    return run_of("normal", steps=4), run_of("normal", {"gait.planner": "ipm"}, steps=4)


@pytest.fixture(scope="module")
def sides(folders):
    return [load_side(name, folder) for name, folder in zip(("smooth", "jumps"), folders, strict=True)]


def signals_with(jump, rate, switch):
    """Plan with a kink in every column at a switch; the ZMP along x and the moment about y jump there too."""
    time = 5e-4 * np.arange(300)
    after = np.maximum(time - switch, 0.0)
    late = time >= switch
    zero = np.zeros(300)
    columns = {
        "time": time,
        "phase": np.where((time < 0.02) | (late), "single_support", "double_support"),
        "stance": np.where(time < 0.01, "left", "right"),
        "plan_zmp_x": 0.3 * time + 2.0 * after + jump * late,
        "plan_zmp_y": 0.1 - 4.0 * after,
        "plan_force_x": 100.0 * after,
        "plan_force_y": zero,
        "plan_force_z": zero + 600.0,
        "plan_angular_momentum_x": 2.0 * time + 30.0 * after**2,
        "plan_angular_momentum_y": rate * after,
    }
    return Signals(columns)


@pytest.mark.parametrize("switch", [0.1, 0.1002, 0.10049])
def test_jumps_of_a_plan_are_found_between_its_samples_and_kinks_are_none(switch):
    smooth = plan_values(signals_with(0.0, 0.0, switch), 60.0)
    assert max(smooth.values()) < 1e-6
    broken = plan_values(signals_with(0.235, 7.0, switch), 60.0)
    assert broken["plan_zmp"] == pytest.approx(0.235, abs=1.1e-3)  # less than a row's change by the kink
    assert broken["plan_moment"] == pytest.approx(7.0, abs=0.1)
    assert broken["plan_acceleration"] < 1e-6


def test_jumps_of_rounding_size_do_not_count(sides):
    a, b = (
        replace(sides[0], values={**sides[0].values, **{item.name: jump for item in PLAN}})
        for jump in (0.0, 1e-14)
    )
    assert all(row.better is None for row in comparison_of([a, b]).rows)


def test_finished_runs_of_another_planner_show_its_jumps(folders, tmp_path, ampm):
    out = tmp_path / "both"
    answer = ampm("compare", *folders, "--out", out, "--json")
    found = answer.json
    assert answer.status == 0
    assert json.loads((out / NUMBERS).read_text(encoding="utf-8")) == found
    zmp = found["quantities"]["plan_zmp"]
    assert zmp["a"] < 1e-5
    assert 0.23 < zmp["b"] < 0.24
    assert zmp["better"] == "a"
    assert found["quantities"]["plan_acceleration"]["b"] == pytest.approx(2.66, abs=0.02)
    assert found["parameters"] == {"gait.planner": ["ampm", "ipm"]}
    assert f"{100 * SHARE:g} %" in found["a"]["differences_count_from"]
    page = (out / REPORT).read_text(encoding="utf-8")
    assert found["sentence"] in page
    assert f"{folders[1].name}, planner ipm" in page
    assert [f'<li><i style="background:var(--part-{n})"></i>' in page for n in (1, 2, 3)] == [
        True,
        True,
        False,
    ]
    assert page.count("<svg role=") == 6
    assert "http" not in page.replace("http://www.w3.org/", "")  # of the pictures
    assert ampm("compare", *folders, "--out", out).status == 2
    told = ampm("compare", *folders, "--out", out, "--resume").out.splitlines()
    assert told[0] == found["sentence"]


def test_a_table_beside_our_planner_with_walks_at_half_the_time_step(tmp_path, ampm, monkeypatch):
    table, out = tmp_path / "ipm.csv", tmp_path / "both"
    samples = ["--samples", table, "--rate", "1000"]
    assert ampm("plan", "flat", "--planner", "ipm", "--steps", "3", *samples).status == 0
    command = ["compare", "flat", "--planner", "ampm", "--planner", table, *FAST, "--out", out, "--json"]
    first = ampm(*command)
    found = first.json
    assert first.status == 0
    assert (found["a"]["label"], found["b"]["label"]) == ("flat, planner ampm", "flat, planner ipm.csv")
    assert found["sentence"].startswith("flat, planner ampm is better in ")
    assert found["quantities"]["plan_zmp"]["a"] < 1e-5
    assert found["quantities"]["plan_zmp"]["b"] > 0.1
    assert "half the time step" in found["b"]["differences_count_from"]
    assert found["quantities"]["plan_zmp"]["better"] == "a"
    # With a control tick at every step the error after a jump depends on the step: nothing can be told.
    rmse = found["quantities"]["zmp_x_rmse"]
    assert 0.0 < rmse["b"] - rmse["a"] < rmse["counts_from"]
    assert rmse["better"] == ""
    monkeypatch.setattr("validation.study.compare.walks.walk_planned", lambda *_, **__: pytest.fail("walked"))
    assert ampm(*command, "--resume").json == found


def test_without_walks_at_half_the_step_two_equal_plans_agree(ampm):
    answer = ampm("compare", "normal", "--planner", "ampm", "--planner", "dcm", *FAST, "--quick")
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
    quantity = Quantity(JUDGED, "zmp_x_rmse", "ZMP", "m")
    assert Row(quantity, values, least).better == better


def with_metrics(side: Side, **values: float) -> Side:
    return replace(side, values={**side.values, **values})


def test_one_sentence_says_who_is_better_and_where_most(sides):
    a, b = sides[0], replace(sides[0], label="other")
    assert comparison_of([a, b]).sentence.startswith("smooth and other agree: ")
    worse = with_metrics(b, zmp_x_rmse=2e-3, force_x_rmse=5.0, zmp_y_rmse=1e-5)
    words = "smooth is better in 2, other is better in 1 of 11 judged metrics by more than 10 %"
    assert comparison_of([a, worse]).sentence.startswith(words)
    assert "they differ most in ground force, RMS error along x: 0.18" in comparison_of([a, worse]).sentence
    fell = replace(b, summary={**b.summary, "outcome": "fell", "end": {"time": 2.3, "cause": ""}})
    assert comparison_of([a, fell]).sentence == (
        "smooth walked to the end, other did not walk to the end (fell after 2.30 s)."
    )


def test_a_study_or_a_walk_at_half_the_step_takes_the_place_of_the_share(sides):
    near = next(item for item in SWITCH if item.name == "zmp_x_near")
    side = sides[0]
    value = side.values["zmp_x_near"]
    assert side.change(near) == pytest.approx(SHARE * value)
    halved = replace(side, halved={**side.values, "zmp_x_near": 0.9 * value})
    assert halved.change(near) == pytest.approx(0.1 * value)
    study = Uncertainty("a", 6, {"zmp_x_rmse": 1e-3})
    studied = replace(halved, study=study)
    assert studied.change(near) == pytest.approx(0.1 * value)  # it is in no study
    rmse = Quantity(JUDGED, "zmp_x_rmse", "ZMP", "m")
    assert studied.change(rmse) == 1e-3


def test_a_study_must_be_of_both_gaits(folders, tmp_path, ampm):
    parameters = json_ready(parameter_values(load_run(folders[0] / "run.toml")))
    make_study(tmp_path, {"zmp_x_rmse": 1e-3}, parameters=parameters)
    same = ampm("compare", folders[0], folders[0], "--uncertainty", tmp_path, "--json")
    assert same.json["quantities"]["zmp_x_rmse"]["counts_from"] == pytest.approx(2e-3)
    assert [same.json[side]["label"][-4:] for side in "ab"] == [" (A)", " (B)"]
    other = ampm("compare", *folders, "--uncertainty", tmp_path)
    assert other.status == 2
    assert "gait.planner" in other.err


@pytest.mark.parametrize(
    ("sources", "options", "why"),
    [
        (("normal", "normal"), {}, "1 and 2 are the same walk of normal"),
        (("normal",), {"choices": {"planner": ["dcm", "dcm"]}}, "1 and 2 are the same walk of normal"),
        (("normal", "ipm"), {"choices": {"planner": ["ampm", "dcm", "ipm"]}}, "--planner is given 3 times"),
        (("normal",), {"choices": {"planner": ["ampm", "dcm"], "body": ["a", "b"]}}, "give one option"),
        (("RUN", "RUN"), {"settings": ["gait.steps=3"]}, "all walks are finished runs"),
        (("RUN", "RUN"), {"choices": {"controller": ["ampm"]}}, "all walks are finished runs"),
        (("RUN", "EMPTY"), {}, "no folder of a finished run"),
        (("normal", "nowhere"), {}, "unknown preset or file"),
        (("normal",), {"choices": {"planner": ["ampm", "absent.csv"]}}, "absent.csv"),
        (("RUN", "RUN"), {"uncertainty": [Path("absent.json")]}, "absent.json"),
    ],
)
def test_what_cannot_be_compared_is_refused(folders, tmp_path, sources, options, why):
    places = {"RUN": str(folders[0]), "EMPTY": str(tmp_path)}
    with pytest.raises(InputError, match=why):
        compare_walks([places.get(str(text), text) for text in sources], **options)


def test_refused_and_fallen_walks_are_told_by_the_status(sides, ampm, monkeypatch):
    refused = ampm("compare", "normal", "ipm", "--set", "gait.step_length=3", "--as-is", "--workers", "0")
    assert refused.status == 2
    assert refused.err.count("\n") <= 3
    fell = replace(sides[1], summary={**sides[1].summary, "outcome": "fell"})
    monkeypatch.setattr(
        "validation.study.compare.walks.compare_walks", lambda *_, **__: comparison_of([sides[0], fell])
    )
    assert ampm("compare").status == 3


def test_a_page_escapes_names(sides):
    page = render(comparison_of([replace(sides[0], label="<script>"), sides[1]]))
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
    lines = {
        line.split("│")[1].strip(): line.split("│")[2:-1] for line in told.out.splitlines() if "│" in line
    }
    values = {name: [cell.strip() for cell in cells] for name, cells in lines.items()}
    assert values["disturbances"] == ["own_parts:Rope", "none", "none"]
    assert values["planner"] == ["ampm", "ampm", "ipm"]
    assert 0.0 < float(values["height of the COM, largest error"][0]) < 10.0
    assert values["height of the COM, largest error"][1:4] == ["–", "–", "mm"]
    assert values["verdict"][0] == "fail"
    assert told.out.splitlines()[0].startswith(f"mine, {folders[0].name} and {folders[1].name} differ in ")
    assert "nothing is kept; --out DIR keeps" in told.err


@pytest.mark.parametrize(
    ("option", "why"),
    [
        ("--metric=own_parts:Rope", "is a type; name a val.Metric"),
        ("--metric=own_parts:NONE", "cannot be imported"),
        ("--disturbance=own_parts:dict", "cannot be imported"),
        ("--disturbance=builtins:dict", "has no method apply"),
    ],
)
def test_parts_that_are_none_are_refused(own, option, why, ampm):
    answer = ampm("validate", "normal", option)
    assert answer.status == 2
    assert why in answer.err

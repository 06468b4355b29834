"""Two gaits side by side: what continuity buys, on real runs of both pendulums."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from ampm.exceptions import InputError
from ampm.run_file import load_run
from tests.saved_run import make_study
from validation.cli.app import call
from validation.judge.uncertainty import Uncertainty
from validation.progress import Progress
from validation.store.json import json_ready
from validation.study.compare.metrics import GRIDS, Quantity, quantities
from validation.study.compare.pair import (
    EVEN,
    NUMBERS,
    PICTURE,
    REPORT,
    Row,
    compare_pair,
    joint_jumps,
    load_side,
    pair_of,
)
from validation.study.compare.report import first_answer, largest_undecided, render


@pytest.fixture(scope="module")
def folders(run_of):
    return run_of("normal", steps=5), run_of("ipm", steps=5)


@pytest.fixture(scope="module")
def pair(folders):
    return pair_of(*(load_side(folder.name, folder, Progress()) for folder in folders))


def rows_of(pair):
    return {row.of.name: row for row in pair.rows}


def test_plan_joints_and_ground_of_one_side_jump_and_those_of_the_other_do_not(pair):
    l_s, h = pair.b.plan.constants.l_s, pair.b.plan.com_height
    rows = rows_of(pair)
    assert rows["plan_acceleration"].a < 1e-11
    assert rows["plan_acceleration"].b == pytest.approx(9.81 * l_s / h)
    assert rows["plan_acceleration"].ratio is None  # the smooth one is rounding
    assert rows["plan_zmp"].b == pytest.approx(1e3 * l_s)
    assert rows["plan_force"].b == pytest.approx(100 * l_s / h)
    assert rows["plan_moment"][1:3] == (pytest.approx(0.0, abs=1e-9), 0.0)
    smooth, jump = pair.a.joints, pair.b.joints
    assert smooth.grid == jump.grid == GRIDS
    np.testing.assert_allclose(smooth.jump[1:], 0.5 * np.array(smooth.jump[:-1]), rtol=0.1)
    assert smooth.limit < 0.1 * smooth.jump[-1]
    assert jump.jump[-1] > 0.8 * jump.jump[-2]
    assert jump.limit > 10.0
    assert jump.limit == pytest.approx(jump.jump[-1], rel=0.2)
    assert rows["measured_change"].ratio > 5.0
    assert rows["measured_change"].b == pytest.approx(rows["planned_change"].b, rel=0.2)
    for name in ("force_rate", "zmp_x_near", "zmp_y_near", "torque_rate_peak", "effort_zmp_near"):
        assert rows[name].ratio > 2.0, name


@pytest.mark.parametrize(
    ("a", "b", "u_a", "u_b", "better"),
    [
        (1.0, 2.0, 0.0, 0.0, "a"),
        (2.0, 1.0, 0.0, 0.0, "b"),
        (1.0, 1.2, 0.0, 0.0, "even"),
        (1.2, 1.0, 0.0, 0.0, "even"),
        (1e-12, 0.09, 0.0, 0.0, "even"),  # both are noise
        (1e-12, 1.0, 0.0, 0.0, "a"),
        (math.nan, 1.0, 0.0, 0.0, ""),
        (1.0, 2.0, 0.6, 0.5, ""),  # within the uncertainty of both
        (1.0, 2.0, 0.4, 0.5, "a"),
        (100.0, 102.0, 0.4, 0.5, "even"),  # a difference, and a small one
        (1.0, 9.0, math.inf, 0.0, ""),
        (1.0, 9.0, 0.0, math.nan, ""),
    ],
)
def test_which_side_is_better(a, b, u_a, u_b, better):
    row = Row(Quantity("group", "name", "label", "mm", 0.1), a, b, u_a, u_b)
    assert row.better == better
    assert row.ratio == (b / a if a >= 0.1 else None)  # none of rounding


def test_nothing_is_divided_by_zero():
    """Also where a limit is zero, and both values are."""
    for of in quantities(600.0):
        row = Row(of, 0.0, 0.0, 0.0, 0.0)
        assert (row.ratio, row.better) == (None, "even")


def test_without_a_study_only_what_is_not_walked_is_decided(pair):
    better = {row.of.name: row.better for row in pair.rows}
    assert {"plan_acceleration", "joint_limit"} <= {k for k, v in better.items() if v == "a"}
    assert better["plan_moment"] == "even"
    assert {row.better for row in pair.rows if row.of.walked} == {""}
    assert pair.as_dict()["uncertainty"] is None
    assert pair.parameters["gait.model"] == ("ampm", "ipm")
    assert "body.mass" not in pair.parameters
    assert "same body" in render(pair)
    saved = pair.b.saved
    heavy = replace(saved, parameters=saved.parameters.replace({"body.mass": 61.0}))
    assert "same body" not in render(replace(pair, b=replace(pair.b, saved=heavy)))
    walked = [row.ratio for row in pair.rows if row.of.walked and row.ratio]
    counts = [sum(r < 1 / EVEN for r in walked), sum(r > EVEN for r in walked)]
    (answer,) = first_answer(pair)
    assert [int(word) for word in answer.split() if word.isdigit()][:3] == [len(walked), *counts]
    largest = largest_undecided(pair)
    ratios = [abs(math.log(row.ratio or math.nan)) for row in largest]
    assert len(ratios) == 5
    assert ratios == sorted(ratios, reverse=True)
    assert all(row.better == "" for row in largest)


def test_values_of_the_walks_are_better_only_beyond_the_studies_of_both(pair):
    def rows(u, **more):
        values = {"switch_zmp_x_near": u, "margin_slip": 1e-3, "force_x_rmse": 1.0}
        known = Uncertainty("a", 6, "", values, {}, studies=("time_step",))
        return rows_of(pair_of(pair.a, pair.b, studies=(replace(known, **more), known)))

    found = rows(1e-3)
    near = found["zmp_x_near"]
    assert near.u_a + near.u_b == pytest.approx(2.0)  # mm
    assert found["force_x_rmse"].u_a == pytest.approx(100.0 / (60.0 * 9.81), rel=1e-3)
    assert near.better == ("a" if near.b - near.a > 2.0 else "")
    assert found["zmp_y_near"].better == ""  # not in the studies
    assert rows(0.1)["zmp_x_near"].better == ""
    assert rows(1e-3, incomplete={"switch_zmp_x_near": ("ik_grid",)})["zmp_x_near"].better == ""


def test_a_study_of_neither_gait_is_refused_before_anything_walks(folders, tmp_path, capfd):
    parameters = load_run("normal", ["gait.steps=6"]).model_dump(mode="json")
    lacking = ["ik_grid", "qp_tolerance"]
    make_study(tmp_path, {"zmp_x_rmse": 1e-3}, parameters=json_ready(parameters), not_studied=lacking)
    out = tmp_path / "both"
    arguments = ["compare", "normal", "ipm", "--uncertainty", str(tmp_path), "--out", str(out)]
    assert call(arguments) == 2
    assert "ipm" in capfd.readouterr().err
    assert not out.exists()
    assert call(["compare", *[str(folders[0])] * 2, "--uncertainty", str(tmp_path)]) == 0
    assert ", ".join(lacking) in capfd.readouterr().out


def test_the_limit_of_joint_jumps_is_exact_for_a_jump_on_a_slope():
    """q'' = 3 t before the switch and 3 t + 7 after it, in one joint of two."""

    def motion(h):
        time = np.concatenate([np.arange(0, 0.4 - h / 2, h), np.arange(0.4, 0.5 + h / 2, h)])
        a = np.zeros((len(time), 8))
        a[:, 6] = 3.0 * time + np.where(time >= 0.4 - 1e-9, 7.0, 0.0)
        a[-1] = 0.0  # of the interval that ends with the step, only its start is used
        a[0, 6] = a[-2, 6] + 3.0 * h
        return SimpleNamespace(acceleration=a, time=time, double_support_start=0.4)

    robot: Any = SimpleNamespace(mirror_joints=lambda x: x, joint_names=("knee", "hip"))
    joints = joint_jumps([motion(h) for h in GRIDS], robot)
    assert joints.limit == pytest.approx(7.0, abs=1e-9)
    assert joints.jump == pytest.approx([7.0 + 3.0 * h for h in GRIDS])
    assert joints.joint == "knee"


def test_a_comparison_of_folders_is_written_and_read_back(folders, tmp_path, capfd):
    out = tmp_path / "both"
    arguments = ["compare", *map(str, folders), "--out", str(out)]
    assert call([*arguments, "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert json.loads((out / NUMBERS).read_text(encoding="utf-8")) == answer
    assert answer["b"]["model"] == "ipm"
    assert answer["quantities"]["zmp_x_near"]["better"] == ""
    assert answer["quantities"]["plan_zmp"]["better"] == "a"
    assert {entry.name for entry in out.iterdir()} == {REPORT, NUMBERS, PICTURE}
    page = (out / REPORT).read_text(encoding="utf-8")
    assert "http" not in page.replace("http://www.w3.org", "")
    assert "#0101" not in page
    ElementTree.parse(out / PICTURE)
    assert call(arguments) == 2
    assert "not empty" in capfd.readouterr().err
    assert call([*arguments, "--force"]) == 0


def test_what_cannot_be_compared_is_refused(folders, tmp_path):
    normal, ipm = folders
    for sources, options, why in (
        (("normal", "normal"), {}, "both gaits are named 'normal'"),
        ((normal, ipm), {"settings": ["gait.steps=3"]}, "--set and --controller have nothing"),
        ((normal, ipm), {"controllers": ["ampm"]}, "--set and --controller have nothing"),
        (("normal", "ipm"), {"controllers": ["ampm"] * 3}, "3 controllers"),
        (("normal", "normal"), {"controllers": ["ampm", "ampm"]}, "both gaits are named 'normal'"),
        ((normal, tmp_path), {}, "no folder of a finished run"),
        ((normal, "nowhere"), {}, "neither a preset nor a file"),
        ((normal, normal), {"out": ipm, "force": True}, "holds no comparison"),
        ((normal, normal), {"out": normal / "run.toml"}, "is a file"),
        ((normal, normal), {"uncertainty": [normal / "summary.json"]}, "no convergence study"),
    ):
        with pytest.raises(InputError, match=why):
            compare_pair(*map(str, sources), **options)


def test_two_folders_of_one_gait_are_told_apart(folders):
    pair = compare_pair(str(folders[0]), str(folders[0]))
    assert pair.a.label != pair.b.label
    assert {row.better for row in pair.rows} == {"even", ""}


@pytest.mark.parametrize(("outcome", "status"), [("completed", 0), ("fell", 3), ("interrupted", 130)])
def test_a_walk_that_did_not_end_is_told_by_the_status(pair, outcome, status, monkeypatch):
    ended = replace(pair, b=replace(pair.b, outcome=outcome))
    monkeypatch.setattr("validation.study.compare.pair.compare_pair", lambda *args, **keywords: ended)
    assert call(["compare", "--json"]) == status

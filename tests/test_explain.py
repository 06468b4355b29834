"""Trials are explained by walks with one layer changed."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import ampm as planner
import validation as val
from ampm.exceptions import InputError
from ampm.parameters import SECTIONS, keys
from validation.show.explanation import read_explanation
from validation.store.saved import EXPLANATION
from validation.study.explain import CHANGES, Case, answer, possible, residuals_of
from validation.trial.plan import Request, load_request, plan_walk

QUICK = ("simulation.time_step=2e-3", "gait.steps=2")


def case(*settings: str, **more) -> Case:
    return Case(load_request("normal", settings), "default", {}, **more)


def tried(of: Case) -> set[str]:
    """Layers that are not ideal already."""
    return {change.layer for change in possible(of)}


def row(layers="", *, passed=False, excess=0.0, tightest=0.5, outcome="completed"):
    return {
        "layers": layers.split(),
        "text": f"with {layers}",
        "passed": passed,
        "excess": excess,
        "tightest": tightest,
        "outcome": outcome,
        "metrics": {},
    }


FAILED = row(excess=2.0, tightest=3.0)
AGREES = {"plan": 0.0, "motion": 0.0}


def test_the_rows_of_the_file_are_keys_and_what_is_ideal_is_not_walked():
    known = {*keys(), *SECTIONS}
    assert all(set(change.keys.split()) <= known for change in CHANGES)
    usual = tried(case())
    assert not usual & {"sensing", "motors", "body", "floor", "pushes", "planner"}
    assert usual >= {"friction", "contact law", "numerics", "controller"}
    for layer, setting in {
        "sensing": "sensors.rate_noise=0.01",
        "motors": "disturbance.torque_bias=0.1",
        "body": "disturbance.joint_friction=1",
        "floor": "disturbance.softness_factor=2",
        "pushes": "disturbance.push_x=10",
        "planner": "gait.planner=dcm",
    }.items():
        assert tried(case(setting)) - usual == {layer}
    assert "motors" in tried(case(strained="left_knee_pitch"))
    limits = next(change for change in CHANGES if change.layer == "motors")
    assert case(strained="left_knee_pitch").text(limits) == "without the limit of left_knee_pitch"


def test_the_change_that_leaves_most_of_the_limits_is_named():
    changes = [row("motors", passed=True, tightest=0.9), row("sensing", passed=True, tightest=0.2)]
    assert answer(FAILED, changes, AGREES) == (("sensing",), "The sensing: with sensing it passes.")


def test_a_layer_made_ideal_comes_before_one_that_is_replaced():
    changes = [row("planner", passed=True, tightest=0.2), row("motors", passed=True, tightest=0.6)]
    assert answer(FAILED, changes, AGREES)[0] == ("motors",)
    assert answer(FAILED, [], AGREES) == ((), "No change could be walked.")


def test_a_pair_is_named_if_no_single_change_restores_the_pass():
    changes = [row("motors", excess=1.9, tightest=2.9), row("body sensing", passed=True)]
    assert answer(FAILED, changes, AGREES)[0] == ("body", "sensing")


def test_a_contradiction_in_the_plan_is_told_and_named_only_without_a_pass():
    off = {"plan": 0.005, "motion": 0.0}
    named, said = answer(FAILED, [row("planner", passed=True)], off)
    assert named == ("planner",)
    assert said.endswith("The plan contradicts Newton's law by 5 mm of its ZMP.")
    assert answer(FAILED, [row("motors", excess=0.1)], off)[0] == ("planner",)
    assert answer(FAILED, [row("motors", excess=0.1)], {"plan": 0.0, "motion": 0.02})[0] == ("motion",)


def test_without_a_pass_most_of_the_excess_counts_and_a_little_names_nobody():
    assert answer(FAILED, [row("floor", excess=0.9, tightest=1.5)], AGREES)[0] == ("floor",)
    named, said = answer(FAILED, [row("floor", excess=1.8, tightest=2.5)], AGREES)
    assert named == ()
    assert said == "Nothing restores the pass; with floor 90% of the excess is left."


def test_a_trial_that_passes_blames_nobody():
    passing = row(passed=True, tightest=0.5)
    named, said = answer(passing, [row("body", passed=True, tightest=0.25)], AGREES)
    assert named == ()
    assert said.startswith(
        "It passes. The body costs most of the margin: with body 25% of the tightest limit"
    )
    assert answer(passing, [row("body", passed=True)], AGREES)[1] == "It passes, and no layer costs margin."


def test_residuals_of_a_plan_and_its_posture():
    planned = plan_walk(Request("normal", planner.load_run("normal", gait={"steps": 2})))
    assert max(residuals_of(planned).values()) < 1e-6
    moved = replace(planned.plan, com_height=planned.plan.com_height + 0.01)
    assert residuals_of(replace(planned, plan=moved))["motion"] == pytest.approx(0.01, rel=1e-3)


def test_late_sensing_is_named_and_written(tmp_path):
    found = val.explain("normal", [*QUICK, "sensors.delay=0.002"], workers=0, out=tmp_path / "out")
    assert found.named == ("sensing",)
    assert found.sentence == "The sensing: with exact sensing (sensors.delay 0.002 to 0) it passes."
    assert json.loads((tmp_path / "out" / EXPLANATION).read_text()) == found.as_dict()
    (table,) = found.tables()
    assert [cells[2] for cells in table.rows[:2]] == ["FAIL", "pass"]


@pytest.fixture(scope="module")
def pushed(tmp_path_factory) -> Path:
    """Folder of a walk that a push made fall."""
    run = planner.load_run("normal", ["simulation.time_step=2e-3", "gait.steps=4"])
    push = val.Push("chest", (0.0, 150.0, 0.0), 0.8, 0.1)
    trial = val.walk(run, disturbances=[push]).judged("default")
    return trial.save(tmp_path_factory.mktemp("explain") / "pushed", recording=False)


@pytest.mark.slow
def test_recorded_pushes_act_again(pushed):
    found = val.explain(pushed, workers=0)
    assert found.trial["outcome"] == "fell"
    assert found.named == ("pushes",)


@pytest.mark.slow
def test_the_folder_of_a_run_gets_the_explanation(tmp_path):
    run = planner.load_run("normal", [*QUICK, "sensors.delay=0.002"])
    folder = val.walk(run).save(tmp_path / "late", recording=False)
    found = val.explain(folder, workers=0)
    assert found.named == ("sensing",)
    assert val.load(folder).sentence  # its digests still hold
    assert found.sentence in val.report(folder).read_text(encoding="utf-8")
    (folder / EXPLANATION).write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="is damaged"):
        read_explanation(folder / EXPLANATION)


def test_a_run_is_repeated_as_it_was(pushed):
    with pytest.raises(InputError, match="repeated as it was walked"):
        val.explain(pushed, ["gait.steps=3"])
    with pytest.raises(InputError, match="exists and is not empty"):
        val.explain("normal", out=pushed)
    assert read_explanation(pushed / "nothing.json") is None

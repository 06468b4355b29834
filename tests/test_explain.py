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
    found = {"passed": passed, "excess": excess, "tightest": tightest, "outcome": outcome, "metrics": {}}
    return found | {"layers": layers.split(), "text": f"with {layers}"}


FAILED, PASSED = row(excess=2.0, tightest=3.0), row(passed=True)
AGREES, PLAN_OFF = {"plan": 0.0, "motion": 0.0}, {"plan": 0.005, "motion": 0.0}


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


def ideal(layers, tightest):
    """A change that restores the pass."""
    return row(layers, passed=True, tightest=tightest)


@pytest.mark.parametrize(
    ("trial", "changes", "residuals", "named", "words"),
    [
        (
            FAILED,
            [ideal("motors", 0.9), ideal("sensing", 0.2)],
            AGREES,
            ("sensing",),
            "with sensing it passes.",
        ),
        # A layer that is made ideal comes before one that is replaced.
        (
            FAILED,
            [ideal("planner", 0.2), ideal("motors", 0.6)],
            AGREES,
            ("motors",),
            "with motors it passes.",
        ),
        (FAILED, [], AGREES, (), "No change could be walked."),
        (FAILED, [row("motors", excess=1.9), ideal("body sensing", 0.5)], AGREES, ("body", "sensing"), ""),
        # A contradiction in the plan is told, and named only without a pass.
        (FAILED, [ideal("planner", 0.5)], PLAN_OFF, ("planner",), "Newton's law by 5 mm of its ZMP."),
        (FAILED, [row("motors", excess=0.1)], PLAN_OFF, ("planner",), ""),
        (FAILED, [row("motors", excess=0.1)], {"plan": 0.0, "motion": 0.02}, ("motion",), ""),
        # Without a pass most of the excess counts, and a little names nobody.
        (FAILED, [row("floor", excess=0.9, tightest=1.5)], AGREES, ("floor",), ""),
        (
            FAILED,
            [row("floor", excess=1.8, tightest=2.5)],
            AGREES,
            (),
            "with floor 90% of the excess is left.",
        ),
        (PASSED, [ideal("body", 0.25)], AGREES, (), "with body 25% of the tightest limit"),
        (PASSED, [ideal("body", 0.5)], AGREES, (), "It passes, and no layer costs margin."),
    ],
)
def test_the_layer_that_explains_most_is_named(trial, changes, residuals, named, words):
    found, said = answer(trial, changes, residuals)
    assert found == named
    assert words in said


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


@pytest.mark.slow
def test_a_run_is_repeated_as_it_was_with_its_pushes(pushed):
    found = val.explain(pushed, workers=0)
    assert (found.trial["outcome"], found.named) == ("fell", ("pushes",))
    with pytest.raises(InputError, match="repeated as it was walked"):
        val.explain(pushed, ["gait.steps=3"])
    with pytest.raises(InputError, match="exists and is not empty"):
        val.explain("normal", out=pushed)
    assert read_explanation(pushed / "nothing.json") is None

"""Trials are explained by walks with one layer changed."""

import json
from dataclasses import replace

import pytest

import ampm as planner
import validation as val
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import KEYS, OPTION_TABLES, SECTIONS
from ampm.planner import routes
from validation.study.explain import CHANGES, Case, answer, possible, walk_case
from validation.trial.files import RunFile
from validation.trial.plan import load_request

QUICK = ("simulation.time_step=2e-3", "gait.steps=2")


def case(*settings: str, **more) -> Case:
    return Case(load_request("normal", settings), "default", **more)


def tried(of: Case) -> set[str]:
    """Layers that are not ideal already."""
    return {change.layer for change, _ in possible(of)}


def row(layer="", *, passed=False, excess=0.0, tightest=0.5, outcome="completed"):
    found = {"passed": passed, "excess": excess, "tightest": tightest, "outcome": outcome, "metrics": {}}
    found["verdict"] = "pass" if passed else "fail"
    return found | {"layer": layer, "text": f"with {layer}"}


FAILED, PASSED = row(excess=2.0, tightest=3.0), row(passed=True)


def test_the_rows_of_the_file_are_keys_and_what_is_ideal_is_not_walked():
    known = {*KEYS, *SECTIONS, *OPTION_TABLES}
    assert all(set(change.keys.split()) <= known for change in CHANGES)
    usual = tried(case())
    assert not usual & {"sensing", "motors", "body", "floor", "pushes", "planner", "gait", "feet", "posture"}
    assert usual >= {"friction", "contact law", "numerics", "controller"}
    for layer, setting in {
        "sensing": "sensors.rate_noise=0.01",
        "motors": "disturbance.torque_bias=0.1",
        "body": "disturbance.joint_friction=1",
        "floor": "disturbance.softness_factor=2",
        "pushes": "disturbance.push_x=10",
        "feet": "foot.swing_height=0.08",
        "posture": "body.lean=0.1",
    }.items():
        assert tried(case(setting)) - usual == {layer}
    assert tried(case("gait.planner=dcm")) - usual == {"planner"}
    assert "gait" in tried(case("gait.com_height=0.85"))
    assert "motors" in tried(case(strained="left_knee_pitch"))
    limits = next(change for change in CHANGES if change.layer == "motors")
    strained = case(strained="hip_roll")
    assert strained.text(limits, strained) == "without torque limits (hip roll needs most)"


def test_what_is_found_anew_is_told_by_the_keys_that_differ_most():
    early = case("foot.full_contact=0.2", "foot.heel_strike_angle=0.19", "foot.swing_height=0.051")
    told = [early.text(change, changed) for change, changed in possible(early) if change.layer == "feet"]
    shown = (
        "foot.full_contact 0.2 to 0.9, foot.heel_strike_angle 0.19 to 0.2, foot.swing_height 0.051 to 0.05"
    )
    assert told == [f"with the motion of the feet found anew ({shown})"]
    (flat,) = [new for change, new in possible(case("gait.a_s=inf")) if change.layer == "gait"]
    change = next(change for change in CHANGES if change.layer == "gait")
    assert "(gait.a_s inf to 2.63" in case("gait.a_s=inf").text(change, flat)  # differs most
    assert "feet" not in tried(case("gait.planner=none", "foot.swing_height=0.08"))
    walk = early.request.run.replace({}, footsteps=routes.straight(4, 0.4, 0.18))
    assert "feet" not in tried(replace(early, request=replace(early.request, run=walk)))


def test_what_a_search_does_not_find_is_not_walked(monkeypatch):
    def nothing(request):
        raise BodilyRefusal("none", reason="none", value=1.0, limit=0.0, unit="1", way_out="none")

    monkeypatch.setattr("validation.study.explain.complete", nothing)
    assert not tried(case("foot.swing_height=0.08")) & {"gait", "feet", "posture"}


def ideal(layer, tightest):
    """A change that restores the pass."""
    return row(layer, passed=True, tightest=tightest)


@pytest.mark.parametrize(
    ("trial", "changes", "named", "words"),
    [
        (FAILED, [ideal("motors", 0.9), ideal("sensing", 0.2)], "sensing", "with sensing it passes."),
        # A layer that is made ideal comes before one that is replaced.
        (FAILED, [ideal("planner", 0.2), ideal("motors", 0.6)], "motors", "with motors it passes."),
        # Two replaced layers come after one.
        (FAILED, [ideal("planner and feet", 0.2), ideal("planner", 0.6)], "planner", ""),
        (FAILED, [], "", "No change could be walked."),
        # Without a pass most of the excess counts, and a little names nobody.
        (FAILED, [row("floor", excess=0.9, tightest=1.5)], "floor", ""),
        (FAILED, [row("floor", excess=1.8, tightest=2.5)], "", "with floor 90 % of the excess is left."),
        (
            row(excess=1e4, outcome="fell"),
            [row("floor", excess=0.4, tightest=1.3)],
            "floor",
            "with floor it is completed, with the verdict FAIL.",
        ),
        # Nothing to blame, and limits of another profile.
        (row(), [ideal("pushes", 0.2)], "", "too little was measured"),
        (PASSED, [ideal("pushes", 0.2)], "", "It passes, and no layer costs margin."),
        (PASSED, [ideal("body", 0.25)], "", "with body 25 % of the tightest limit"),
        (PASSED, [ideal("body", 0.5)], "", "It passes, and no layer costs margin."),
    ],
)
def test_the_layer_that_explains_most_is_named(trial, changes, named, words):
    found, said = answer(trial, changes)
    assert found == named
    assert words in said


def test_a_limit_of_0_is_named_in_place_of_a_share():
    standing = case(*QUICK, "gait.planner=none", "command.vx=0.5")
    metrics = walk_case(replace(standing, profile="free"))["metrics"]
    assert metrics["steps_missing"]["text"] == "1, limit 0"
    assert metrics["velocity_x_error"]["text"] == "0.5 m/s (500 %)"


def test_late_sensing_is_named_and_written(tmp_path):
    found = val.explain("normal", [*QUICK, "sensors.delay=0.002"], workers=0, out=tmp_path / "out")
    assert found.named == "sensing"
    assert found.sentence == "The sensing: with exact sensing (sensors.delay 0.002 to 0) it passes."
    assert json.loads((tmp_path / "out" / RunFile.EXPLANATION).read_text()) == found.as_dict()
    (table,) = found.tables()
    assert [cells[2] for cells in table.rows[:2]] == ["FAIL", "pass"]


class Learner(planner.TrackingController):
    """Gets stronger with every tick of a process; see bad_input.csv."""

    ticks = 0

    def update(self, state, touch, reference):
        Learner.ticks += 1
        output = super().update(state, touch, reference)
        return output._replace(torque=(1.0 + 1e-6 * self.ticks) * output.torque)


@pytest.mark.slow
def test_a_run_is_repeated_with_its_pushes_and_its_folder_gets_the_explanation(tmp_path):
    run = planner.load_run("normal", ["simulation.time_step=2e-3", "gait.steps=4"])
    push = val.Push("chest", (0.0, 150.0, 0.0), 0.8, 0.1)
    folder = val.walk(run, disturbances=[push]).save(tmp_path / "pushed", recording=False)
    found = val.explain(folder, workers=0)
    assert (found.trial["outcome"], found.named) == ("fell", "pushes")
    assert found.sentence == "The pushes: without pushes it passes."
    assert str(push) in val.load(folder).sentence  # its digests still hold
    assert found.sentence in val.report(folder).read_text(encoding="utf-8")
    (folder / RunFile.EXPLANATION).write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="is damaged"):
        val.report(folder)

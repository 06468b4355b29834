"""The tour: its protocol by seed, tours that are walked, resumption, bad input, the command."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import ampm
import validation as val
from ampm.exceptions import InputError
from validation.cli.app import call
from validation.study.tour import (
    HEADER,
    RestlessArms,
    Tours,
    Walked,
    plan_tour,
    punches,
    targets,
    tour,
    walk_tour,
)
from validation.trial.plan import Request

RUN = ampm.load_run("normal", simulation={"time_step": 0.002})


def planned(count=2, **sections):
    return plan_tour(0, Request("normal", RUN.replace(sections)), count)


def walked(seed=0, share=0.0, arms=False, **sections):
    return walk_tour(seed, Request("normal", RUN.replace(sections)), 2, share, arms=arms)


def test_targets_are_those_of_the_protocol():
    assert targets(3) == targets(3) != targets(4)
    assert targets(3, 2) == targets(3)[:2]
    every = np.array([[(0.0, 0.0, 0.0), *targets(seed)] for seed in range(200)])
    assert every.shape[1] == 1 + 18
    away = np.hypot(*np.diff(every[..., :2], axis=1).T)
    assert away.max() < 1.0
    assert np.mean(away < math.sqrt(0.5)) == pytest.approx(0.5, abs=0.03)  # uniform over the disc's area
    headings = every[:, 1:, 2]
    assert np.abs(headings).max() < math.pi
    assert [np.mean(headings > angle) for angle in (-2.0, 0.0, 2.0)] == pytest.approx(
        [(math.pi - angle) / math.tau for angle in (-2.0, 0.0, 2.0)], abs=0.03
    )


def test_punches_are_those_of_the_protocol():
    segments = ["pelvis", "left_hand", "right_foot"]
    assert punches(3, 1.0, segments, 90.0) == punches(3, 1.0, segments, 90.0)
    assert punches(3, 0.0, segments, 90.0) == []
    every = [punches(seed, 1.0, segments, 90.0) for seed in range(100)]
    at = np.array([[push.at for push in own] for own in every])
    assert (np.floor(at / 5.0) == np.arange(18)).all()  # one in each window
    force = np.array([[np.linalg.norm(push.force) for push in own] for own in every])
    share = force / (500.0 * np.minimum((1.0 + 2.0 * at / 60.0) / 3.0, 1.0))
    assert share.min() > 0.5
    assert share.max() < 1.0
    assert np.median(share) == pytest.approx(0.75, abs=0.02)
    assert force[:, 0].max() < 195.0
    assert force[:, -1].max() > 490.0
    assert {push.duration for own in every for push in own} == {0.08}
    assert {push.segment for own in every for push in own} == set(segments)
    mean = np.mean(
        [np.array(push.force) / np.linalg.norm(push.force) for own in every for push in own], axis=0
    )
    assert np.abs(mean).max() < 0.05
    weaker = punches(3, 0.5, segments, 90.0)
    assert np.array([push.force for push in weaker]) == pytest.approx(
        0.5 * np.array([push.force for push in every[3]])
    )


def test_a_short_tour_is_walked_to_its_targets():
    found = walked()
    assert (found.completed, found.reached, found.cause) == (True, 2, "")
    assert found.time == pytest.approx(found.planned, abs=0.01)
    assert found.error < 2e-3
    assert found.turned < math.radians(0.5)
    assert 10.0 < found.power < 100.0


def test_arms_that_move_at_random_are_walked_with():
    walk = planned()
    plan, robot = walk.plan, walk.body.robot
    arms = RestlessArms(plan.posture, robot, 0, plan.duration)
    times = np.arange(0.0, plan.duration, 1e-3)
    state, still = arms.sample(times), plan.posture.sample(times)
    moved = np.flatnonzero(np.abs(state.q - still.q).max(axis=0) > 0.1)
    joints = [robot.joint_names[k - 7] for k in moved]
    assert set(joints) <= {*robot.description.left_arm, *robot.description.right_arm}
    assert len(joints) > 4
    assert (state.q[0] == still.q[0]).all()
    angle, rate, acceleration = state.q[1:, moved], state.v[1:, moved - 1], state.acceleration[1:, moved - 1]
    assert np.abs(np.gradient(angle, 1e-3, axis=0) - rate)[1:-1].max() < 1e-4
    assert np.abs(np.gradient(rate, 1e-3, axis=0) - acceleration)[1:-1].max() < 0.02
    assert ((angle >= robot.lower[moved - 7]) & (angle <= robot.upper[moved - 7])).all()
    found = walked(arms=True)
    assert found.completed
    assert found.error < 2e-3
    assert found.error != walked().error


def test_a_punch_that_is_too_hard_ends_it():
    found = walked(share=20.0)
    assert not found.completed
    assert found.time < found.planned
    assert found.cause


def test_steps_are_shortened_where_long_ones_are_refused(monkeypatch):
    monkeypatch.setattr("validation.study.tour.TRIES", 1)
    with pytest.raises(ampm.RefusedGait, match="thigh"):
        planned(4, **{"gait.step_width": 0.15})
    more = planned(4).plan.contacts.steps
    monkeypatch.undo()
    assert planned(4, **{"gait.step_width": 0.15}).plan.contacts.steps > more


def test_a_refusal_is_a_result():
    refused = walked(1, **{"gait.com_height": 0.97})
    assert refused.cause.startswith("refused: ")
    assert (refused.completed, refused.time, refused.reached) == (False, 0.0, 0)


def fake(seed, **_):
    if seed % 4 == 3:
        cause = f"fell: the trunk leaned over at 9 s; the first sign was a ZMP {seed} mm off at 8 s"
        return Walked(seed, False, 9.0, 60.0, 1, 0.02, 0.1, 40.0, cause)
    return Walked(seed, True, 60.0, 60.0, 18, 0.01, 0.1, 40.0)


def study(runner=fake, **options):
    return tour("normal", runner=runner, **{"seeds": 8, "workers": 1, **options})


def test_the_table_has_shares_and_means():
    found = study()
    assert dict(zip(HEADER, found.row(), strict=True)) == {
        "force": "1",
        "completed": "6 of 8",
        "mean survival, of planned [s]": "47.2 of 60.0",
        "targets": "13.8",
        "error at them [mm], [degrees]": "12.5, 5.73",
        "median power [W]": "40.0",
        "first sign of most falls": "a ZMP … mm off (2)",
    }
    nothing = Tours(
        "normal", "human", "tracking", "fixed", 0.0, False, (Walked(0, False, 0.0, cause="refused: no"),)
    )
    assert nothing.row()[2:6] == ("0.0 of nan", "0.0", "–, –", "–")


def test_tours_that_were_stopped_go_on_with_what_is_missing(tmp_path):
    out = tmp_path / "tours"
    done: list[int] = []

    def stops(seed, **_):
        if len(done) == 3:
            raise KeyboardInterrupt
        return goes_on(seed)

    def goes_on(seed, **_):
        done.append(seed)
        return fake(seed)

    with pytest.raises(KeyboardInterrupt):
        study(stops, out=out)

    found = study(goes_on, out=out, resume=True)
    assert done == list(range(8))
    assert found == study()
    assert json.loads((out / "tour.json").read_text()) == found.as_dict()
    assert {path.name for path in out.iterdir()} == {"tour.json", "tours.jsonl"}
    assert study(goes_on, out=out, resume=True, seeds=10).completed == 8
    assert done == list(range(10))
    with pytest.raises(InputError, match="it differs in"):
        study(out=out, resume=True, share=0.5)
    with pytest.raises(InputError, match="--force"):
        study(out=out)


@pytest.mark.parametrize(
    ("options", "words"),
    [({"seeds": 0}, "--seeds 0"), ({"count": 0}, "--targets 0"), ({"share": -1.0}, "--punches -1"),
     ({"share": math.nan}, "--punches nan"), ({"workers": 0}, "--workers 0"), ({"resume": True}, "--out")],
)  # fmt: skip
def test_bad_requests_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        study(**options)


def test_the_command_and_the_api_walk_the_same(capsys):
    step = ["simulation.time_step=0.002"]
    found = val.tour("normal", step, seeds=1, count=1, share=0.1, arms=True, workers=1)
    arguments = ["--seeds", "1", "--targets", "1", "--punches", "0.1", "--arms"]
    arguments += ["--workers", "1", "--set", *step]
    assert call(["tour", "normal", *arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == found.as_dict()
    assert call(["tour", "normal", *arguments]) == 0
    title = "Tour of normal, simulation.time_step 0.002, body human, controller ampm (fixed), arms at random"
    assert title in capsys.readouterr().out

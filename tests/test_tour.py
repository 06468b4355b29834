"""The tour: its protocol by seed, a tour that is walked, resumption, bad input, the command."""

import json
import math

import numpy as np
import pytest

from ampm.exceptions import InputError
from ampm.run_file import load_run
from validation.cli.app import Status
from validation.study import tour as tours
from validation.study.row_file import ROWS
from validation.study.tour import Tours, plan_tour, punches, targets, tour, walk_tour
from validation.trial.plan import Request

RUN = load_run("normal", simulation={"time_step": 0.002})


def planned(count, **sections):
    return plan_tour(0, Request("normal", RUN.replace(sections)), count)


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
    unit = [np.array(push.force) / np.linalg.norm(push.force) for own in every for push in own]
    assert np.abs(np.mean(unit, axis=0)).max() < 0.05
    weaker = np.array([push.force for push in punches(3, 0.5, segments, 90.0)])
    assert weaker == pytest.approx(0.5 * np.array([push.force for push in every[3]]))


def test_a_short_tour_is_walked_to_its_targets():
    found = walk_tour(0, Request("normal", RUN), 1, 0.0)
    assert (found["outcome"], found["reached"], found["cause"]) == ("completed", 1, "")
    assert found["time"] == pytest.approx(found["planned"], abs=0.01)
    assert found["error"] < 2e-3


@pytest.mark.slow
def test_steps_are_shortened_where_long_ones_are_refused():
    more = planned(4, **{"gait.step_width": 0.15}).plan.contacts.steps
    long = planned(4).plan.contacts.steps
    assert more > long


def walked(seed, **_):
    """A tour of canned numbers; every fourth falls."""
    row = {
        "seed": seed,
        "time": 60.0,
        "planned": 60.0,
        "reached": 18,
        "error": 0.01,
    }
    if seed % 4 == 3:
        cause = f"fell: the trunk leaned over at 9 s; the first sign was a ZMP {seed} mm off at 8 s"
        return {**row, "outcome": "fell", "cause": cause, "time": 9.0, "reached": 1, "error": 0.02}
    return {**row, "outcome": "completed", "cause": ""}


def test_the_table_has_shares_and_means():
    rows = tuple({"key": f"seed {seed}", **walked(seed)} for seed in range(8))
    table = Tours("normal, body human", 1.0, rows).table()
    assert table.title == "Tour of normal, body human"
    assert dict(zip(table.headers, table.rows[0], strict=True)) == {
        "force [%]": "100",
        "completed": "6 of 8",
        "survived [%]": "78.8",
        "targets": "13.8",
        "off target [mm]": "12.5",
    }


def test_a_refusal_is_a_tour_that_lasted_no_time():
    """No walk: the body cannot stand so high."""
    high = ["simulation.time_step=0.002", "gait.com_height=0.97"]
    found = tour(load_run("normal", high).as_is(), seeds=1, count=1, workers=0)
    assert found.walks[0]["outcome"] == "refused"
    assert list(found.table().rows[0][1:]) == ["0 of 1", "0.0", "0.0", "–"]
    assert found.crashes == []


DONE: list[int] = []
STOP_AT: list[int] = []
"""Tours that were walked, and numbers of them at which Ctrl-C comes."""


def counted(seed, **_):
    if len(DONE) in STOP_AT:
        raise KeyboardInterrupt
    DONE.append(seed)
    return walked(seed)


def test_tours_that_were_stopped_go_on_with_what_is_missing(tmp_path, monkeypatch, ampm):
    monkeypatch.setattr(tours, "walk_tour", counted)
    DONE[:], STOP_AT[:] = [], [3]
    options = {"workers": 0, "out": tmp_path}
    with pytest.raises(KeyboardInterrupt):
        tour("normal", seeds=8, **options)
    STOP_AT.clear()
    found = tour("normal", seeds=8, **options, resume=True)
    assert list(range(8)) == DONE
    assert found.completed == 6
    assert json.loads((tmp_path / tours.RESULT).read_text()) == found.as_dict()
    assert {path.name for path in tmp_path.iterdir()} == {tours.RESULT, ROWS}
    told = ["tour", "normal", "--seeds", 10, "--workers", 0, "--out", tmp_path]
    assert ampm(*told).status == Status.REFUSED
    answer = ampm(*told, "--resume", "--json")
    assert (answer.status, answer.json["completed"]) == (Status.PASS, 8)
    assert list(range(10)) == DONE


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"seeds": 0}, "--seeds 0"),
        ({"count": 0}, "--targets 0"),
        ({"share": -1.0}, "--punches -1"),
        ({"share": math.nan}, "--punches nan"),
        ({"resume": True}, "--out"),
    ],
)
def test_bad_requests_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        tour("normal", **options)

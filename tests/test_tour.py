"""The tour of examples/tour.py: its protocol by seed, a tour that is walked and kept."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest

SPEC = importlib.util.spec_from_file_location("tour", Path(__file__).parents[1] / "examples" / "tour.py")
assert SPEC is not None
assert SPEC.loader is not None
tour = sys.modules["tour"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(tour)


def test_targets_are_those_of_the_protocol():
    assert tour.targets(3, 18) == tour.targets(3, 18) != tour.targets(4, 18)
    assert tour.targets(3, 18)[:2] == tour.targets(3, 2)
    every = np.array([[(0.0, 0.0, 0.0), *tour.targets(seed, 18)] for seed in range(200)])
    away = np.hypot(*np.diff(every[..., :2], axis=1).T)
    assert away.max() < 1.0
    assert np.mean(away < math.sqrt(0.5)) == pytest.approx(0.5, abs=0.03)  # uniform over the disc's area
    assert np.abs(every[..., 2]).max() < math.pi


def test_punches_are_those_of_the_protocol():
    segments = ["pelvis", "left_hand", "right_foot"]
    assert tour.punches(3, 0.0, segments, 90.0) == []
    every = [tour.punches(seed, 1.0, segments, 90.0) for seed in range(100)]
    at = np.array([[push.at for push in own] for own in every])
    assert (np.floor(at / 5.0) == np.arange(18)).all()  # one in each window
    force = np.array([[np.linalg.norm(push.force) for push in own] for own in every])
    share = force / (500.0 * np.minimum((1.0 + 2.0 * at / 60.0) / 3.0, 1.0))
    assert 0.5 < share.min() < share.max() < 1.0
    assert {(push.segment, push.duration) for own in every for push in own} == {(s, 0.08) for s in segments}
    weaker = np.array([push.force for push in tour.punches(3, 0.5, segments, 90.0)])
    assert weaker == pytest.approx(0.5 * np.array([push.force for push in every[3]]))


def test_a_short_tour_is_walked_to_its_target_and_kept(tmp_path, monkeypatch):
    options = "normal", ["simulation.time_step=0.002"], 1, 1, 0.0, 0, tmp_path
    [found] = tour.walk_tours(*options)
    assert (found["outcome"], found["reached"], found["cause"]) == ("completed", 1, "")
    assert found["time"] == pytest.approx(found["planned"], abs=0.01)
    assert found["error"] < 2e-3
    monkeypatch.delattr(tour, "simulate")  # nothing is walked again
    assert tour.walk_tours(*options, resume=True) == [found]

"""The tour of examples/tour.py: its protocol by seed, a tour that is walked and kept."""

import importlib.util
import sys
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location("tour", Path(__file__).parents[1] / "examples" / "tour.py")
assert SPEC is not None
assert SPEC.loader is not None
tour = sys.modules["tour"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(tour)


def test_a_short_tour_is_walked_to_its_target_and_kept(tmp_path, monkeypatch):
    options = "normal", ["simulation.time_step=0.002"], 1, 1, 0.0, 0, tmp_path
    [found] = tour.walk_tours(*options)
    assert (found["outcome"], found["reached"], found["cause"]) == ("completed", 1, "")
    assert found["time"] == pytest.approx(found["planned"], abs=0.01)
    assert found["error"] < 2e-3
    monkeypatch.delattr(tour, "simulate")  # nothing is walked again
    assert tour.walk_tours(*options, resume=True) == [found]

"""Influence: known influences are found, chance is not, and too few runs give none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import qmc

from validation.study.sweep.influence import (
    LEAST_RUNS,
    MOST_RUNS,
    SIGNIFICANCE,
    Target,
    analyse,
    classes,
    correlated,
)


def target(parameters, values) -> Target:
    (found,) = analyse(parameters, {"y": values})
    return found


def ishigami(count, dimensions=4, seed=2):
    """Ishigami's function: x1 acts, x2 as a parabola does, x3 only through x1; further inputs do nothing."""
    x = (2 * qmc.LatinHypercube(dimensions, rng=seed).random(count) - 1) * np.pi
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return {f"x{i + 1}": x[:, i] for i in range(dimensions)}, y


@pytest.mark.parametrize("count", [200, 1000, 6000])
def test_ishigami(count):
    parameters, y = ishigami(count)
    found = target(parameters, y)
    by_name = {item.parameter: item for item in found.influences}
    assert found.runs == min(count, MOST_RUNS)
    assert [item.parameter for item in found.drivers][:2] == ["x2", "x1"]
    assert not by_name["x4"].clear
    assert by_name["x2"].share == pytest.approx(0.49, abs=1.0 / math.sqrt(count))
    assert by_name["x2"].p_rho >= SIGNIFICANCE  # rank correlation does not see a parabola
    assert by_name["x1"].p_rho < SIGNIFICANCE
    assert target(parameters, y) == found  # the draw is the same again


def test_chance_drives_nothing():
    claimed = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        x = rng.random((80, 6))
        claimed += bool(target({str(i): x[:, i] for i in range(6)}, rng.lognormal(size=80)).drivers)
    assert claimed <= 3  # one in a hundred is expected


def test_all_pairs_are_corrected_together():
    rng = np.random.default_rng(3)
    x = rng.random(100)
    weak = x + 1.1 * rng.normal(size=100)
    alone = target({"x": x}, weak).influences[0].p_rho
    noise = {f"n{i}": rng.normal(size=100) for i in range(40)}
    assert analyse({"x": x}, {"y": weak, **noise})[0].influences[0].p_rho > 5 * alone


def test_levels_words_and_absent_values():
    rng = np.random.default_rng(1)
    words = rng.choice(["flat", "roll", "both"], 300)
    grid = rng.choice([1.0, 2.0, np.inf, np.nan], 300)
    y = np.where(words == "roll", 2.0, 0.0) + rng.normal(0, 0.5, 300)
    found = target({"words": words, "grid": grid, "fixed": np.ones(300)}, y)
    by_words, by_grid, by_fixed = found.influences
    assert 0.5 < by_words.share < 1.0
    assert by_words.p_share < SIGNIFICANCE
    assert math.isnan(by_words.rho)
    assert not by_grid.clear
    assert not math.isnan(by_grid.rho)
    assert math.isnan(by_fixed.share)
    assert [item.parameter for item in found.drivers] == ["words"]


def test_silence():
    rng = np.random.default_rng(1)
    x = rng.random(LEAST_RUNS)
    few = target({"x": x}, np.where(np.arange(LEAST_RUNS) < LEAST_RUNS - 1, x, np.nan))
    assert "too few" in few.reason
    assert few.influences == ()
    assert "vary" in target({"x": x}, np.full(LEAST_RUNS, 3.0)).reason
    rare = np.zeros(200)
    rare[:4] = 1.0
    assert "4 of 200" in target({"x": rng.random(200)}, rare).reason
    rare[:5] = 1.0
    assert target({"x": rng.random(200)}, rare).reason == ""


def test_entangled_parameters():
    rng = np.random.default_rng(1)
    x = rng.random(200)
    pairs = correlated({"a": x, "b": x**2, "c": rng.random(200), "d": rng.choice(["u", "v"], 200)})
    assert [(a, b, round(rho, 9)) for a, b, rho in pairs] == [("a", "b", 1.0)]


def test_classes_keep_equal_values_together():
    column = np.repeat(np.arange(30.0), [1, 100, *[3] * 28])
    label = classes(column)
    assert all(len(set(label[column == value])) == 1 for value in np.unique(column))
    assert set(label) == set(range(label.max() + 1))

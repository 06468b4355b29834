"""What drives what: known indices are found, chance is not, and silence where nothing can be said."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import qmc, spearmanr

from validation.study.sweep.report_sensitivity import _cell
from validation.study.sweep.sensitivity import (
    LEAST_RUNS,
    MOST_RUNS,
    Influence,
    Sensitivity,
    analyse,
    classes,
    entangled,
)


def ishigami(count, dimensions=4, seed=2):
    """Ishigami's function: S1 = 0.314, 0.442, 0 (Ishigami and Homma, 1990); further inputs drive nothing."""
    x = (2 * qmc.LatinHypercube(dimensions, rng=seed).random(count) - 1) * np.pi
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return {f"x{i + 1}": x[:, i] for i in range(dimensions)}, y


@pytest.mark.parametrize("count", [200, 1000, 6000])
def test_ishigami(count):
    parameters, y = ishigami(count)
    found = analyse(parameters, "y", y)
    share = {item.parameter: item for item in found.influences}
    error = 2.0 / math.sqrt(found.runs)
    assert share["x1"].share == pytest.approx(0.314, abs=error)
    assert share["x2"].share == pytest.approx(0.442, abs=error)
    assert share["x3"].share < found.noise
    assert [item.parameter for item in found.drivers] == ["x2", "x1"]
    assert share["x1"].share_interval[0] <= 0.314 + error / 2
    assert found.runs == min(count, MOST_RUNS)
    assert found.drawn_from == count
    # The second acts as a parabola does: rank correlation does not see it.
    assert abs(share["x2"].rho) < 0.15
    if found.runs == count:
        assert share["x1"].rho == pytest.approx(spearmanr(parameters["x1"], y).statistic, abs=1e-12)
        low, high = share["x1"].rho_interval
        assert low < share["x1"].rho < high


def test_chance_drives_nothing():
    claimed = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        x = rng.random((80, 6))
        found = analyse({str(i): x[:, i] for i in range(6)}, "y", rng.lognormal(size=80), seed=seed)
        claimed += bool(found.drivers)
    assert claimed <= 6  # about one in thirty is expected


def test_levels_and_words():
    rng = np.random.default_rng(1)
    words = rng.choice(["flat", "roll", "both"], 300)
    grid = rng.choice([1.0, 2.0, np.inf], 300)
    y = np.where(words == "roll", 2.0, 0.0) + rng.normal(0, 0.5, 300)
    found = analyse({"words": words, "grid": grid}, "y", y)
    by_name = {item.parameter: item for item in found.influences}
    explained = 4 * np.var(words == "roll")
    assert by_name["words"].share == pytest.approx(explained / (explained + 0.25), abs=0.05)
    assert math.isnan(by_name["words"].rho)
    assert by_name["words"].clear
    assert not by_name["grid"].clear
    assert not math.isnan(by_name["grid"].rho)


@pytest.mark.parametrize(
    ("clear_rho", "clear_share", "first", "width"),
    [
        (True, False, "ρ −0.38", 0),
        (False, True, "4\u00a0% [0, 9]", "4"),
        (True, True, "4\u00a0% [0, 9]", "4"),
    ],
)
def test_bold_is_what_made_it_a_driver(clear_rho, clear_share, first, width):
    item = Influence("gait.c_s", -0.38, (-0.5, -0.2), 0.04, (0.0, 0.09), clear_rho, clear_share)
    cell = _cell(item, Sensitivity("y", 60, 60, (item,), 0.05))
    assert item.clear
    assert cell["beyond"]
    assert cell["lines"][0] == (first, True)
    assert dict(cell["lines"])["ρ −0.38"] is clear_rho
    assert cell["width"] == width


def test_a_trend_and_a_share_are_told_apart():
    rng = np.random.default_rng(4)
    x = rng.random((60, 2))
    trend = analyse({"a": x[:, 0], "b": x[:, 1]}, "y", x[:, 0] + 0.55 * rng.normal(size=60))
    wave = analyse({"a": x[:, 0], "b": x[:, 1]}, "y", np.cos(2 * np.pi * x[:, 0]))
    assert trend.influences[0].clear_rho
    assert wave.influences[0].clear_share
    assert not wave.influences[0].clear_rho
    assert not trend.influences[1].clear


def test_silence():
    rng = np.random.default_rng(1)
    x = rng.random(LEAST_RUNS)
    values = np.where(np.arange(LEAST_RUNS) < LEAST_RUNS - 1, x, np.nan)
    few = analyse({"x": x}, "y", values)
    assert "too few" in few.silent
    assert few.influences == ()
    assert "vary" in analyse({"x": x}, "y", np.full(LEAST_RUNS, 3.0)).silent
    rare = np.zeros(200)
    rare[:4] = 1.0
    assert "all but 4 of 200" in analyse({"x": rng.random(200)}, "falls", rare).silent
    rare[:5] = 1.0
    assert analyse({"x": rng.random(200)}, "falls", rare).silent == ""
    still = analyse({"x": x, "fixed": np.ones(LEAST_RUNS)}, "y", x)
    assert math.isnan(still.influences[1].share)
    assert not still.influences[1].clear
    assert still.influences[0].rho == pytest.approx(1.0)


def test_same_answer_again():
    parameters, y = ishigami(5000)
    assert analyse(parameters, "y", y) == analyse(parameters, "y", y)


def test_entangled_parameters():
    rng = np.random.default_rng(1)
    x = rng.random(200)
    pairs = entangled({"a": x, "b": x**2, "c": rng.random(200), "d": rng.choice(["u", "v"], 200)})
    assert [(a, b) for a, b, _ in pairs] == [("a", "b")]
    assert pairs[0][2] == pytest.approx(1.0)


def test_classes_keep_equal_values_together():
    column = np.repeat(np.arange(30.0), [1, 100, *[3] * 28])
    label = classes(column)
    assert all(len(set(label[column == value])) == 1 for value in np.unique(column))
    assert set(label) == set(range(label.max() + 1))

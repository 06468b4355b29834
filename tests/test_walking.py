"""Tolerances on simulated walks, held on real runs that are simulated once per session.

All figures are taken from ``signals.parquet`` here, not from the verdict, which is itself under test: row k
against the plan at t_k, the first step left out, nothing shifted, fitted or masked.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ampm.run_file import load_run
from validation.store.signals import load_signals

STEPS = 10


@dataclass(frozen=True)
class Limits:
    """Largest errors that a walk may have.

    Attributes:
        zmp: RMSE x, y [mm].
        zmp_maximum: x, y [mm].
        force: RMSE x, y, z [% of body weight].
        momentum: RMSE of L_x, L_y about the plan, constant included [N m s].
        agreement: RMSE of the two measured ZMPs [mm].
    """

    zmp: tuple[float, ...]
    zmp_maximum: tuple[float, ...]
    force: tuple[float, ...]
    momentum: float
    agreement: float = 0.5

    def times(self, factor: float) -> Limits:
        """Wider limits on the walk; the instrument's stays."""
        return Limits(
            zmp=tuple(factor * value for value in self.zmp),
            zmp_maximum=tuple(factor * value for value in self.zmp_maximum),
            force=tuple(factor * value for value in self.force),
            momentum=factor * self.momentum,
        )


NORMAL = Limits(zmp=(2.0, 1.0), zmp_maximum=(15.0, 8.0), force=(0.6, 0.4, 0.7), momentum=0.1)
MOMENTUM = Limits(zmp=(2.5, 1.5), zmp_maximum=(40.0, 20.0), force=(0.8, 0.6, 1.0), momentum=0.15)
FAR = MOMENTUM.times(2.0)

WALKS = [
    pytest.param("normal", {}, NORMAL, id="normal"),
    pytest.param("momentum", {}, MOMENTUM, id="momentum"),
    pytest.param("flat", {}, MOMENTUM, id="flat"),
    pytest.param("normal", {"gait.c_y": 0.7}, FAR, id="c_y=0.7"),
    pytest.param("normal", {"gait.c_s": 1.2}, FAR, id="c_s=1.2"),
]
SWEEP = [
    *(
        pytest.param("normal", {"gait.c_y": value}, FAR, id=f"c_y={value}")
        for value in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2)
    ),
    *(
        pytest.param("normal", {"gait.c_s": value}, FAR, id=f"c_s={value}")
        for value in (0.8, 0.9, 1.1, 1.2, 1.3, 1.4)
    ),
]


class Walk:
    """A run folder's figures."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.summary = json.loads((folder / "summary.json").read_text())
        self.signals = load_signals(folder / "signals.parquet")
        run = load_run(folder / "run.toml")
        self.weight = run.body.mass * 9.81
        end_of_first_step = self.signals["time"][-1] / run.gait.steps
        self.rows = self.signals["time"] >= end_of_first_step + run.simulation.time_step

    def error(self, name: str) -> np.ndarray:
        return (self.signals[f"measured_{name}"] - self.signals[f"plan_{name}"])[self.rows]

    def rmse(self, name: str, scale: float) -> float:
        return float(scale * np.sqrt(np.mean(self.error(name) ** 2)))

    def maximum(self, name: str, scale: float) -> float:
        return float(scale * np.abs(self.error(name)).max())

    def breaches(self, limits: Limits) -> list[str]:
        """Every limit that is not kept, in words."""
        percent = 100.0 / self.weight
        figures = [
            *(
                (f"zmp_{a} RMSE [mm]", self.rmse(f"zmp_{a}", 1e3), v)
                for a, v in zip("xy", limits.zmp, strict=True)
            ),
            *(
                (f"zmp_{a} maximum [mm]", self.maximum(f"zmp_{a}", 1e3), v)
                for a, v in zip("xy", limits.zmp_maximum, strict=True)
            ),
            *(
                (f"force_{a} RMSE [% BW]", self.rmse(f"force_{a}", percent), v)
                for a, v in zip("xyz", limits.force, strict=True)
            ),
            *(
                (f"L_{a} RMSE [N m s]", self.rmse(f"angular_momentum_{a}", 1.0), limits.momentum)
                for a in "xy"
            ),
        ]
        return [f"{name} = {value:.3g} > {limit:.3g}" for name, value, limit in figures if not value <= limit]

    def agreement(self) -> float:
        """RMSE of the ZMP from contact forces about the ZMP from momentum rates [mm]."""
        gap = [
            (self.signals[f"measured_zmp_{axis}"] - self.signals[f"measured_zmp_momentum_{axis}"])[self.rows]
            for axis in "xy"
        ]
        return float(1e3 * max(np.sqrt(np.mean(part**2)) for part in gap))


def hold(walk: Walk, limits: Limits, steps: int) -> None:
    summary = walk.summary
    assert summary["outcome"] == "completed", summary["reason"]
    assert summary["steps_completed"] == steps
    assert summary["solver"]["unsolved"] == 0
    assert not walk.breaches(limits)
    assert walk.agreement() <= limits.agreement


@pytest.mark.parametrize(("gait", "settings", "limits"), WALKS)
def test_simulated_walk_keeps_to_the_plan(run_of, gait, settings, limits):
    hold(Walk(run_of(gait, settings, steps=STEPS)), limits, STEPS)


@pytest.mark.slow
@pytest.mark.parametrize(("gait", "settings", "limits"), [WALKS[0], WALKS[1], WALKS[2], *SWEEP])
def test_thirty_steps(run_of, gait, settings, limits):
    hold(Walk(run_of(gait, settings, steps=30)), limits, 30)


@pytest.mark.slow
@pytest.mark.parametrize(("gait", "settings", "limits"), WALKS[:2])
def test_two_hundred_steps_do_not_drift(run_of, gait, settings, limits):
    hold(Walk(run_of(gait, settings, steps=200)), limits.times(1.1), 200)


@pytest.mark.parametrize("gait", ["normal", "momentum"])
def test_verdict_says_what_the_signals_say(run_of, gait):
    walk = Walk(run_of(gait, steps=STEPS))
    metrics = walk.summary["metrics"]
    for axis in "xy":
        assert metrics[f"zmp_{axis}_rmse"]["value"] == pytest.approx(walk.rmse(f"zmp_{axis}", 1.0), rel=0.02)
    assert walk.summary["verdict"] == "pass"


def test_causes_add_up_to_the_zmp_error(run_of):
    walk = Walk(run_of("momentum", steps=STEPS))
    for axis in "xy":
        parts = [
            name
            for name in walk.signals.columns
            if name.startswith("zmp_error_") and name.endswith(f"_{axis}")
        ]
        total = sum(walk.signals[name][walk.rows] for name in parts)
        np.testing.assert_allclose(total, walk.error(f"zmp_{axis}"), atol=1e-9)


def test_the_plan_is_not_in_the_measurement(run_of):
    """Normal walks almost without L_x, momentum with several N m s: both are measured, not assumed."""
    peak = {
        gait: np.ptp(Walk(run_of(gait, steps=STEPS)).signals["measured_angular_momentum_x"])
        for gait in ("normal", "momentum")
    }
    assert peak["normal"] < 1.0
    assert peak["momentum"] > 10.0

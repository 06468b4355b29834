"""The presets have the recorded plans and metrics, to four digits.

``python -m tests.test_golden`` records the present values.
"""

import json
from dataclasses import asdict
from pathlib import Path

import pytest

import ampm
import validation as val
from ampm.presets import PRESETS

FILE = Path(__file__).with_name("golden.json")
STEPS = 6
RELATIVE = 1e-4
NOISE = 1e-8
"""Difference that counts nowhere: what is zero but for rounding is smaller."""


def plan_values(name: str) -> dict[str, float]:
    """Constants of the closed form."""
    return rounded(asdict(ampm.plan(ampm.load_run(name)).constants))


def walk_values(name: str) -> dict[str, float]:
    """Errors, margins and energy of a short walk, and the constant of L_y of its motion."""
    trial = val.walk(ampm.load_run(name, gait={"steps": STEPS}))
    assert trial.record.outcome.completed
    offset = trial.plan.constants.angular_momentum_y_offset
    kept = {
        key: metric.value
        for key, metric in trial.metrics.items()
        if key.endswith("_rmse") or key[:6] in ("margin", "energy")
    }
    return rounded(kept | {"offset": offset})


def rounded(values: dict[str, float]) -> dict[str, float]:
    return {key: float(f"{value:.6g}") for key, value in values.items()}


def recorded(kind: str, name: str) -> object:
    values = json.loads(FILE.read_text(encoding="utf-8"))[kind][name]
    return pytest.approx(values, rel=RELATIVE, abs=NOISE)


@pytest.mark.parametrize("name", PRESETS)
def test_plans(name: str) -> None:
    assert plan_values(name) == recorded("plans", name)


@pytest.mark.parametrize(
    "name", [name if name == "normal" else pytest.param(name, marks=pytest.mark.slow) for name in PRESETS]
)
def test_walks(name: str) -> None:
    assert walk_values(name) == recorded("walks", name)


if __name__ == "__main__":
    found = {"plans": {n: plan_values(n) for n in PRESETS}, "walks": {n: walk_values(n) for n in PRESETS}}
    FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")

"""The walks of golden.csv have the recorded metrics; the plans of the presets the recorded constants.

A column a walk: gait, settings and footsteps, how it ended, constants of the plan, metrics, margins, energy.
``python -m tests.test_golden`` records the present values; look at the difference.
"""

import csv
import tempfile
from dataclasses import asdict
from pathlib import Path

import pytest

import ampm
import validation as val
from ampm.planner import routes
from ampm.presets import PRESETS
from tests.conftest import run_in

FILE = Path(__file__).with_name("golden.csv")
RELATIVE, DISTURBED = 1e-4, 1e-2
"""Differences that pass: of a preset, and of a walk that a push or noise makes sensitive to rounding."""
NOISE = 1e-8
"""Difference that counts nowhere: what is zero but for rounding is smaller."""
LEFT_OUT = ("maximum", "agreement", "defect", "residual")
"""Values of single instants, or of rounding, which are not compared."""
DEFINITION = ("gait", "settings", "footsteps")

with FILE.open(encoding="utf-8", newline="") as file:
    TABLE = {row.pop("name"): row for row in csv.DictReader(file)}
WALKS = list(TABLE["gait"])
OTHERS = PRESETS.keys() - {"normal", "momentum", "flat"}


def definition(name):
    """Arguments of ``run_of`` for a column."""
    gait, settings, steps = (TABLE[row][name] for row in DEFINITION)
    route, *numbers = steps.split() or [""]
    changed = dict(text.split("=") for text in settings.split())
    steps = int(changed.pop("gait.steps", 8))
    footsteps = getattr(routes, route)(int(numbers[0]), *map(float, numbers[1:])) if route else None
    return {"gait": gait, "settings": changed, "steps": steps, "footsteps": footsteps}


def found(name, run_of):
    """Cells of a column, but for its definition."""
    asked = definition(name)
    saved = val.load(run_of(**asked))
    summary = saved.summary
    cells = {"outcome": summary["outcome"], "verdict": summary["verdict"]}
    if summary["outcome"] == "fell":  # its figures hang on the processor's rounding
        return cells
    constants = asdict(ampm.plan(ampm.load_run(asked["gait"])).constants)
    numbers = {f"plan: {key}": value for key, value in constants.items()}
    numbers |= {key: metric["value"] for key, metric in summary["metrics"].items()}
    for section in ("margins", "energy"):
        for key, item in summary[section].items():
            numbers[f"{section}: {key}"] = item.get("value", item) if isinstance(item, dict) else item
    kept = {
        key: f"{value:.6g}"
        for key, value in numbers.items()
        if isinstance(value, int | float) and not any(word in key for word in LEFT_OUT)
    }
    return cells | kept


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in OTHERS)) for n in WALKS])
def test_a_walk_is_as_recorded(name, run_of):
    recorded = {row: cells[name] for row, cells in TABLE.items() if cells[name] and row not in DEFINITION}
    now = found(name, run_of)
    assert recorded.keys() <= now.keys()  # a new metric is recorded by the next change
    relative = RELATIVE if name in PRESETS else DISTURBED
    for row, cell in recorded.items():
        if row in ("outcome", "verdict"):
            assert now[row] == cell
        else:
            assert float(now[row]) == pytest.approx(float(cell), rel=relative, abs=NOISE), row


def test_every_preset_is_recorded():
    assert set(PRESETS) <= set(WALKS)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        columns = {name: found(name, run_in(Path(folder))) for name in WALKS}
    rows = list(dict.fromkeys([*DEFINITION, *(row for cells in columns.values() for row in cells)]))
    with FILE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["name", *WALKS])
        for row in rows:
            of = (TABLE[row][name] if row in DEFINITION else columns[name].get(row, "") for name in WALKS)
            writer.writerow([row, *of])

"""The walks of golden.csv have the recorded metrics; the plans of the presets the recorded constants.

A column a walk: gait, settings and footsteps, how it ended, constants of the plan, metrics, margins, energy.
``python -m tests.test_golden`` records the present values; look at the difference.

The walks of walks.csv end as they should: floors, engines, stabilisers, estimators and planners. A row a
walk: gait, settings, footsteps and planner; its outcome or verdict; upper bounds of metrics.
"""

import csv
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

import pytest

import ampm
import validation as val
from ampm.planner import routes
from ampm.presets import PRESETS, preset_names
from tests.conftest import run_in
from validation.judge.profiles import own_profile

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


def route(text):
    """Footsteps by the name of a route and its numbers; None without them."""
    name, *numbers = text.split() or [""]
    return getattr(routes, name)(int(numbers[0]), *map(float, numbers[1:])) if name else None


def definition(name):
    """Arguments of ``run_of`` for a column."""
    gait, settings, steps = (TABLE[row][name] for row in DEFINITION)
    changed = dict(text.split("=") for text in settings.split())
    count = int(changed.pop("gait.steps", 8))
    return {"gait": gait, "settings": changed, "steps": count, "footsteps": route(steps)}


def found(name, run_of):
    """Cells of a column, but for its definition."""
    asked = definition(name)
    summary = val.load(run_of(**asked)).summary
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


with Path(__file__).with_name("walks.csv").open(encoding="utf-8", newline="") as file:
    CASES = [
        pytest.param(row, marks=[pytest.mark.slow] * ("pushed by" in row["name"]), id=row["name"])
        for row in csv.DictReader(file)
    ]


@pytest.mark.parametrize("row", CASES)
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP, in planners that go on planning
def test_a_walk_ends_as_it_should(row):
    if "engine=drake" in row["settings"]:
        pytest.importorskip("pydrake", reason="pip install 'ampm-testbed[drake]'")
    run = ampm.load_run(row["gait"], row["settings"].split())
    trial = val.walk(run.as_is(), footsteps=route(row["footsteps"]), planner=row["planner"] or None)
    assert row["ends"] in (trial.record.outcome.name, trial.verdict.name), trial.sentence
    for bound in row["most"].split():
        name, most = bound.split("=")
        assert trial.metrics[name].value < float(most), name


SLOPES = {"c_y": (0.2, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2), "c_s": (0.8, 0.9, 1.1, 1.3, 1.4)}
"""Parameters of the force line; one of them is changed in ``normal``."""
LONG = [
    *((name, {}, 30) for name in preset_names()),
    *(("normal", {f"gait.{key}": value}, 30) for key, values in SLOPES.items() for value in values),
    *((name, {}, 200) for name in ("normal", "momentum")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "settings", "steps"), LONG, ids=str)
def test_long_walks_keep_within_their_profile(run_of, name, settings, steps):
    summary = json.loads((run_of(name, settings, steps=steps) / "summary.json").read_text(encoding="utf-8"))
    assert (summary["outcome"], summary["steps_completed"]) == ("completed", steps)
    assert summary["solver"]["unsolved"] == 0
    for metric, tolerance in own_profile(ampm.load_run(name)).tolerances.items():
        # No joint has a limit of speed, nothing is commanded, and a log's strides alone have a mean.
        if metric.startswith(("speed_", "velocity_", "yaw_", "stride_")):
            continue
        limit = tolerance.limit_for(summary["scales"])
        assert summary["metrics"][metric]["value"] <= limit, metric


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

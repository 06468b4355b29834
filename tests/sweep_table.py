"""Tables of sweeps from rows that no walk gave: thousands in a second, in the schema of a real one."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from ampm.parameters import GRAVITY, RunParameters
from ampm.section import parse_toml
from models.human import sole_geometry
from validation.judge.profiles import find_profile
from validation.study.sweep.design import SweepDefinition, read_definition
from validation.study.sweep.table import TABLE_METADATA, SweepTable, build_table, key_of

RANGES: Mapping[str, tuple[float, float]] = {
    "gait.step_length": (0.4, 0.75),
    "gait.switching_velocity": (0.7, 1.4),
    "gait.c_s": (0.6, 1.5),
    "gait.c_y": (0.2, 1.3),
    "body.height": (1.5, 1.9),
}
"""Parameters that a synthetic sweep varies."""
NO_WALK: Sequence[Mapping[str, Any]] = (
    {"outcome": "refused", "reason": "leg_too_short", "cause": "the legs are too short; shorten the step."},
    {"outcome": "fell", "cause": "the pelvis sank under half of its height"},
    {"outcome": "diverged", "cause": "the run diverged"},
    {"outcome": "timed_out", "reason": "wall_clock", "cause": "the run had not ended after 600 s"},
    {"outcome": "crashed", "reason": "RuntimeError", "cause": "a </script> broke", "traceback": "a\nb\nc\n"},
)
"""Ends of every tenth run if runs may fail."""


def parse_sweep(text: str) -> SweepDefinition:
    """A sweep's definition from TOML text; files that it names are searched in the working directory."""
    return read_definition(parse_toml(text, "the definition"), "sweep", Path())


def make_table(
    count: int = 200, *, grid: Mapping[str, Sequence[Any]] | None = None, failures: bool = True
) -> pa.Table:
    """Build a table of rows of a Latin hypercube in :data:`RANGES`, or of a ``grid``."""
    block: dict[str, Any] = {"method": "grid", **(grid or {})}
    if grid is None:
        ranges = {key: {"from": low, "to": high} for key, (low, high) in RANGES.items()}
        block = {"method": "latin_hypercube", "count": count, **ranges}
    head = {"name": "synthetic", "gait": "normal", "steps": 6, "seed": 1}
    definition = parse_sweep(tomli_w.dumps({"sweep": head, "vary": [block]}))
    rng, rows, kept = np.random.default_rng(1), [], 0
    for run in range(len(definition)):
        row = _row(definition.parameters(run), rng)
        if failures and run % 10 == 9:
            end = NO_WALK[run // 10 % len(NO_WALK)]
            walked = end["outcome"] in ("fell", "diverged")
            row = {**(row if walked else {}), **end, "failed": "", "steps_completed": 3 if walked else None}
            row["verdict"] = "not_measured" if walked else None
        if kept < 20 and row["verdict"] in ("fail", "not_measured"):
            row["recording"] = f"recordings/{definition.name_of(run)}"
            kept += 1
        rows.append({"worker": str(run % 2), "timing_total": 1.4, **row, "key": key_of(definition, run)})
    return build_table(definition, rows)


def _row(run: RunParameters, rng: np.random.Generator) -> dict[str, Any]:
    """Columns of a walk whose errors grow with the distance of both slopes from 1."""
    c_s, c_y, mass = run.gait.c_s, run.gait.c_y, run.body.mass
    foot = sole_geometry(1.0).length * run.body.height
    driven = {"zmp_x": 0.25 + 1.1 * (c_s - 1.0) ** 2, "zmp_y": 0.25 + 0.8 * abs(c_y - 1.0) ** 1.5}
    metrics, failed = dict[str, float](), []
    for name, item in find_profile("default").tolerances.items():
        limit = item.limit_for({"body_weight": mass * GRAVITY, "foot_length": foot})
        share = driven.get(name[:5], 0.1) * rng.lognormal(0.0, 0.12)
        metrics[f"metric_{name}"] = float(limit * share)
        if share > 1.0:
            failed.append(name)
    return {
        "outcome": "completed",
        "verdict": "fail" if failed else "pass",
        "failed": ",".join(failed),
        "steps_completed": 6,
        "outcome_time": 3.7,
        "foot_length": foot,
        **metrics,
    }


def sweep_of(table: pa.Table) -> SweepTable:
    """The sweep of a table that is in no folder."""
    return SweepTable(table, None, "sweep")


def write_sweep(folder: Path, table: pa.Table) -> Path:
    """Write a sweep folder that holds this table, and empty run folders where it names recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, folder / "results.parquet")
    metadata = json.loads(table.schema.metadata[TABLE_METADATA])
    (folder / "sweep.toml").write_text(metadata["definition"], encoding="utf-8")
    for name in filter(None, table.column("recording").to_pylist()):
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / "report.html").write_text("<!doctype html><title>run</title>", encoding="utf-8")
        (folder / name / "recording.rrd").write_bytes(b"RRF2")
    return folder


def replaced(table: pa.Table, name: str, values: Any) -> pa.Table:
    """Copy of a table with one column changed."""
    index = table.column_names.index(name)
    column = pa.array(values, table.field(name).type, from_pandas=True)
    return table.set_column(index, table.field(name), column)

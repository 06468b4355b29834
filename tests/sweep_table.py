"""A sweep's table without a simulation: thousands of rows in the schema of a real one, in a second.

The errors are simple functions of the parameters, so a test knows which parameter drives which of them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from ampm.parameters import GRAVITY
from models.human import sole_geometry
from validation.judge.profiles import profile
from validation.store.identity import parameter_values, run_key
from validation.study.sweep.design import parse_sweep
from validation.study.sweep.schema import schema
from validation.study.sweep.store import TABLE_METADATA, table_metadata
from validation.study.sweep.table import SweepTable

RANGES: Mapping[str, tuple[float, float]] = {
    "gait.step_length": (0.4, 0.75),
    "gait.switching_velocity": (0.7, 1.4),
    "gait.c_s": (0.6, 1.5),
    "gait.c_y": (0.2, 1.3),
    "body.height": (1.5, 1.9),
    "foot.swing_height": (0.02, 0.09),
}
"""Parameters that the synthetic sweep varies; ``foot.swing_height`` drives nothing."""
ENDS = (
    ("completed", None, None),
    ("refused", "switching_velocity_too_low", "too slow to pass over the foot; raise it."),
    ("refused", "leg_too_short", "the legs are too short for step and height; shorten gait.step_length."),
    ("fell", None, "the pelvis sank under half of its height"),
    ("diverged", None, "the run diverged"),
    ("infeasible", None, "the run is infeasible"),
    ("timed_out", None, "no answer for 600 s"),
    ("crashed", "RuntimeError", "a worker's </script> broke"),
)
"""Outcome, reason and cause of the ways in which runs end."""
ENVIRONMENT = {"revision": "0123456789" * 4, "modified": False, "code": "c0de", "python": "3.11.7"}
ENVIRONMENT |= {"version_mujoco": "3.17.0", "version_numpy": "2.4.6", "processor": "A processor"}


def make_table(
    count: int = 200,
    *,
    seed: int = 1,
    grid: Mapping[str, Sequence[Any]] | None = None,
    vary: Mapping[str, tuple[float, float]] = RANGES,
    failures: bool = True,
    profile_name: str = "default",
    environment: Mapping[str, Any] | None = None,
    recordings: bool = True,
) -> pa.Table:
    """Build a table.

    Args:
        count: rows; with ``grid`` the product of its levels counts instead.
        seed: of samples and noise.
        grid: levels by key, instead of ``vary``.
        vary: ranges by key, sampled by a Latin hypercube.
        failures: whether runs may be refused, fall and so on.
        profile_name: whose tolerances judge.
        environment: columns ``environment_*`` to overwrite, a scalar or one value per row.
        recordings: whether the first failures have a recording's name.
    """
    block: dict[str, Any] = {"method": "grid", **(grid or {})}
    if grid is None:
        ranges = {key: {"from": low, "to": high} for key, (low, high) in vary.items()}
        block = {"method": "latin_hypercube", "count": count, **ranges}
    head = {"name": "synthetic", "gait": "normal", "steps": 6, "seed": seed, "profile": profile_name}
    definition = parse_sweep(tomli_w.dumps({"sweep": head, "vary": [block]}))
    rng = np.random.default_rng(seed)
    count, numbers = len(definition), np.arange(len(definition))
    keys = parameter_values(definition.shared)
    parameters = {key: definition.column(key, numbers).tolist() for key in keys}
    rows = [dict(zip(parameters, row, strict=True)) for row in zip(*parameters.values(), strict=True)]
    at = {key: np.array(parameters[key], dtype=float) for key in (*RANGES, "body.mass")}
    v0, length = at["gait.switching_velocity"], at["gait.step_length"]
    c_s, c_y = at["gait.c_s"], at["gait.c_y"]

    end, wild = np.zeros(count, dtype=int), rng.random(count)
    if failures:
        refused = [v0 < 0.35 + length, length > 0.5 * at["body.height"] - 0.1]
        rare = [(wild > low) & (wild <= low + 0.004) for low in (0.98, 0.985, 0.99, 0.996)]
        end = np.select([*refused, (c_s > 1.38) & (wild < 0.7), *rare], range(1, len(ENDS)))
    outcome, reason, cause = (np.array(words, dtype=object)[end] for words in zip(*ENDS, strict=True))
    completed, walked = end == 0, np.isin(end, (0, 3, 4, 5))
    steps = np.where(completed, 6, np.where(walked, 3, 0))

    driven = {
        "zmp_x": 0.25 + 1.1 * (c_s - 1.0) ** 2 + 0.25 * (v0 - 1.0),
        "zmp_y": 0.25 + 0.8 * np.abs(c_y - 1.0) ** 1.5,
        "force": 0.2 + 0.3 * length + 0.15 * np.abs(c_s - 1.0) + 0.2 * (1.3 - c_y) / 1.1,
    }
    metrics, over = {}, {}
    foot = sole_geometry(1.0).length * at["body.height"]
    for item in profile(profile_name).tolerances:
        limit = item.limit_for({"body_weight": at["body.mass"] * GRAVITY, "foot_length": foot})
        share = driven.get(item.metric[:5], 0.1) * rng.lognormal(0.0, 0.12, count)
        metrics[item.metric] = np.where(walked, limit * share, np.nan)
        over[item.metric] = completed & (metrics[item.metric] > limit)
    metrics["com_x_rmse"] = np.where(walked, 6e-5, np.nan)
    failed = [",".join(name for name, rows in over.items() if rows[i]) for i in numbers]
    verdict = np.where(completed, np.where(failed, "fail", "pass"), "not_measured").astype(object)
    verdict[~walked] = None
    names = [f"{i:0{max(4, len(str(count)))}d}" for i in numbers]
    kept = np.flatnonzero((verdict == "fail") | (verdict == "not_measured"))[: 20 * recordings]
    columns: dict[str, Any] = {
        "run": numbers,
        "name": names,
        "key": [run_key(row) for row in rows],
        **parameters,
        "outcome": outcome,
        "reason": reason,
        "cause": cause,
        "verdict": verdict,
        "failed": failed,
        "steps_completed": steps,
        "foot_length": np.where(walked, foot, np.nan),
        "outcome_time": np.where(walked, steps * 0.62, np.nan),
        **{f"metric_{name}": values for name, values in metrics.items()},
        "timing_simulation": np.where(walked, 0.8, np.nan),
        "timing_total": np.where(walked, rng.normal(1.4, 0.05, count), 0.01),
        **{f"environment_{name}": [value] * count for name, value in ENVIRONMENT.items()},
        "environment_worker": [f"worker-{i % 2}" for i in numbers],
        "environment_memory_peak": rng.normal(300.0, 10.0, count),
        "recording": [f"recordings/{names[i]}" if i in kept else None for i in numbers],
    }
    for name, given in (environment or {}).items():
        columns[name] = [given] * count if np.isscalar(given) else list(given)
    fields = {field.name: field.type for field in schema()}
    if unknown := columns.keys() - fields.keys():
        raise KeyError(f"no column of a sweep: {sorted(unknown)}")
    arrays = {
        name: pa.array(columns.get(name, [None] * count), type=kind, from_pandas=True)
        for name, kind in fields.items()
    }
    metadata = json.dumps(table_metadata(definition)).encode()
    return pa.table(arrays).replace_schema_metadata({TABLE_METADATA: metadata})


def sweep_of(table: pa.Table, source: str = "sweep") -> SweepTable:
    """The sweep of a table that is in no folder."""
    return SweepTable(table, json.loads(table.schema.metadata[TABLE_METADATA]), None, source)


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
    return table.set_column(index, name, pa.array(values, from_pandas=True))

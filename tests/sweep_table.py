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
from scipy.stats import qmc

from ampm.parameters import GRAVITY, RunParameters
from validation.judge.metrics import BODY_WEIGHT
from validation.judge.profiles import profile
from validation.store.identity import parameter_values, run_key
from validation.study.sweep.design import parse_sweep
from validation.study.sweep.schema import schema
from validation.study.sweep.store import TABLE_METADATA, table_metadata

RANGES: Mapping[str, tuple[float, float]] = {
    "gait.step_length": (0.4, 0.75),
    "gait.switching_velocity": (0.7, 1.4),
    "gait.c_s": (0.6, 1.5),
    "gait.c_y": (0.2, 1.3),
    "body.height": (1.5, 1.9),
    "foot.swing_height": (0.02, 0.09),
}
"""Parameters that the synthetic sweep varies; ``foot.swing_height`` drives nothing."""


def definition_text(
    count: int, vary: Mapping[str, Any], grid: Mapping[str, Any] | None, profile_name: str
) -> str:
    """The definition that such a table would come from."""
    block: dict[str, Any] = {"method": "grid", **{key: list(levels) for key, levels in (grid or {}).items()}}
    if grid is None:
        ranges = {key: {"from": low, "to": high} for key, (low, high) in vary.items()}
        block = {"method": "latin_hypercube", "count": count, **ranges}
    head = {"name": "synthetic", "gait": "normal", "steps": 6, "seed": 1, "profile": profile_name}
    return tomli_w.dumps({"sweep": head, "vary": [block]})


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
    rng = np.random.default_rng(seed)
    varied: dict[str, np.ndarray]
    if grid is not None:
        mesh = np.meshgrid(*[np.arange(len(levels)) for levels in grid.values()], indexing="ij")
        varied = {
            key: np.asarray(levels, dtype=object)[m.ravel()]
            for (key, levels), m in zip(grid.items(), mesh, strict=True)
        }
        count = mesh[0].size
    else:
        sample = qmc.LatinHypercube(len(vary), rng=rng).random(count)
        varied = {key: low + (high - low) * sample[:, i] for i, (key, (low, high)) in enumerate(vary.items())}
    parameters = {key: [value] * count for key, value in parameter_values(RunParameters()).items()}
    parameters |= {"gait.steps": [6] * count} | {key: values.tolist() for key, values in varied.items()}
    columns: dict[str, Any] = {
        "run": np.arange(count, dtype=np.int64),
        "name": [f"{i:0{max(4, len(str(count)))}d}" for i in range(count)],
        "key": [
            run_key(dict(zip(parameters, row, strict=True))) for row in zip(*parameters.values(), strict=True)
        ],
        **parameters,
    }
    at = {key: np.asarray(columns[key], dtype=float) for key in RANGES}
    v0, length = at["gait.switching_velocity"], at["gait.step_length"]
    c_s, c_y = at["gait.c_s"], at["gait.c_y"]
    columns["plan_mean_velocity"] = 0.98 * v0
    columns["plan_step_duration"] = length / columns["plan_mean_velocity"]

    wild = rng.random(count)
    outcome = np.full(count, "completed", dtype=object)
    reason = np.full(count, None, dtype=object)
    cause = np.full(count, None, dtype=object)
    if failures:
        slow = v0 < 0.35 + length
        outcome[slow], reason[slow] = "refused", "switching_velocity_too_low"
        cause[slow] = (
            "the switching velocity is too low to pass over the foot; raise gait.switching_velocity."
        )
        short = ~slow & (length > 0.5 * at["body.height"] - 0.1)
        outcome[short], reason[short] = "refused", "leg_too_short"
        cause[short] = "the legs are too short for step and height; shorten gait.step_length."
        alive = ~slow & ~short
        fell = alive & (c_s > 1.38) & (wild < 0.7)
        outcome[fell], cause[fell] = "fell", "the pelvis sank under half of its height"
        for name, low, high in (("diverged", 0.985, 0.99), ("infeasible", 0.99, 0.994)):
            hit = alive & ~fell & (wild > low) & (wild <= high)
            outcome[hit], cause[hit] = name, f"the run {name}"
        crashed = alive & ~fell & (wild > 0.997)
        outcome[crashed], reason[crashed] = "crashed", "RuntimeError"
        cause[crashed] = "a worker's </script> broke"
        late = alive & ~fell & (wild > 0.994) & (wild <= 0.997)
        outcome[late], reason[late], cause[late] = "timed_out", None, "no answer for 600 s"
    walked = np.isin(outcome, ["completed", "fell", "diverged", "infeasible"])
    completed = outcome == "completed"
    columns["outcome"], columns["reason"], columns["cause"] = outcome, reason, cause
    columns["steps_completed"] = np.where(completed, 6, np.where(walked, 3, 0))
    columns["outcome_time"] = np.where(walked, columns["steps_completed"] * 0.62, np.nan)

    limits = profile(profile_name).tolerances
    mass = np.asarray(columns["body.mass"], dtype=float)
    failed: list[list[str]] = [[] for _ in range(count)]
    for index, item in enumerate(limits):
        scale = item.limit * (mass * GRAVITY if item.unit == BODY_WEIGHT else 1.0)
        noise = rng.lognormal(0.0, 0.12, count)
        if item.metric == "failed_qp":
            value = np.zeros(count)
        elif item.metric.startswith("zmp_x"):
            value = scale * noise * (0.25 + 1.1 * (c_s - 1.0) ** 2 + 0.25 * (v0 - 1.0))
        elif item.metric.startswith("zmp_y"):
            value = scale * noise * (0.25 + 0.8 * np.abs(c_y - 1.0) ** 1.5)
        elif item.metric.startswith(("force", "angular")) and not item.metric.endswith("agreement_rmse"):
            value = scale * noise * (0.2 + 0.3 * length + 0.15 * np.abs(c_s - 1.0) + 0.2 * (1.3 - c_y) / 1.1)
        else:
            value = scale * noise * 0.1 * (1 + index % 3)
        if item.limit == 0.0:
            value = np.zeros(count)
        value = np.where(walked, value, np.nan)
        columns[f"metric_{item.metric}"] = value
        for row in np.flatnonzero(completed & (value > scale)):
            failed[row].append(item.metric)
    columns["metric_com_x_rmse"] = np.where(walked, 6e-5 * rng.lognormal(0, 0.1, count), np.nan)
    verdict = np.full(count, None, dtype=object)
    verdict[walked], verdict[completed] = "not_measured", "pass"
    verdict[[bool(names) for names in failed]] = "fail"
    columns["verdict"] = verdict
    columns["failed"] = [
        ",".join(names) if done else None for names, done in zip(failed, completed, strict=True)
    ]
    columns["margin_torque"] = np.where(walked, 0.5 + 0.3 * c_s, np.nan)
    columns["margin_knee"] = np.where(walked, 0.9 - 0.4 * c_s, np.nan)
    columns["qp_limited"] = [0 if w else None for w in walked]
    columns["qp_unsolved"] = [0 if w else None for w in walked]
    columns["energy_cost_of_transport"] = np.where(walked, 0.3 + 0.2 * (v0 - 0.9) ** 2, np.nan)
    columns["timing_simulation"] = np.where(walked, rng.normal(0.8, 0.05, count), np.nan)
    columns["timing_total"] = np.where(walked, rng.normal(1.4, 0.05, count), 0.01)
    constant = {"revision": "0123456789" * 4, "modified": False, "code": "c0de", "python": "3.11.7"}
    constant |= {"version_mujoco": "3.17.0", "version_numpy": "2.4.6", "processor": "A processor"}
    columns |= {f"environment_{name}": [value] * count for name, value in constant.items()}
    columns["environment_worker"] = [f"worker-{i % 2}" for i in range(count)]
    columns["environment_memory_peak"] = rng.normal(300.0, 10.0, count)
    for name, given in (environment or {}).items():
        columns[name] = [given] * count if np.isscalar(given) else list(given)
    bad = (outcome != "completed") & walked | (verdict == "fail")
    kept = set(np.flatnonzero(bad)[:20].tolist()) if recordings else set()
    columns["recording"] = [f"recordings/{columns['name'][i]}" if i in kept else None for i in range(count)]
    fields = {field.name: field.type for field in schema()}
    if unknown := columns.keys() - fields.keys():
        raise KeyError(f"no column of a sweep: {sorted(unknown)}")
    arrays = {
        name: pa.array(columns.get(name, [None] * count), type=kind, from_pandas=True)
        for name, kind in fields.items()
    }
    text = definition_text(count, vary, grid, profile_name)
    metadata = json.dumps(table_metadata(parse_sweep(text))).encode()
    return pa.table(arrays).replace_schema_metadata({TABLE_METADATA: metadata})


def write_sweep(folder: Path, table: pa.Table) -> Path:
    """Write a sweep folder that holds this table, and empty run folders where it names recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, folder / "results.parquet")
    metadata = json.loads(table.schema.metadata[TABLE_METADATA])
    (folder / "sweep.toml").write_text(metadata["definition"], encoding="utf-8")
    for name in table.column("recording").to_pylist():
        if name is not None:
            (folder / name).mkdir(parents=True, exist_ok=True)
            (folder / name / "report.html").write_text("<!doctype html><title>run</title>", encoding="utf-8")
            (folder / name / "recording.rrd").write_bytes(b"RRF2")
    return folder


def replaced(table: pa.Table, name: str, values: Any) -> pa.Table:
    """Copy of a table with one column changed."""
    index = table.column_names.index(name)
    return table.set_column(index, name, pa.array(values, from_pandas=True))

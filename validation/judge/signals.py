"""Table of plan, command and measurement on one clock, one row per simulation step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from validation.judge.compare import PARTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from validation.judge.compare import Comparison

    Array = NDArray[np.float64]


def signals_table(walk: Comparison) -> pa.Table:
    """Build the table: row k holds plan and state at t_k, force and command over [t_k, t_(k+1)].

    Units and frames: :data:`validation.store.signals.COLUMNS`. The plan has no L_z: its column is null, and
    so are the ZMPs of an unsupported instant. ``motion_angular_momentum_z`` is that of the planned posture,
    ``zmp_error_{part}_{x,y}`` are the parts of the ZMP error.
    """
    record, measured, sample = walk.record, walk.measured, walk.sample
    columns: dict[str, pa.Array] = {
        "time": pa.array(walk.time),
        "phase": pa.array(sample.phase_name.tolist(), pa.string()),
        "stance": pa.array(sample.stance_name.tolist(), pa.string()),
    }

    def put(name: str, values: Array) -> None:
        for column, axis in enumerate("xyz"[: values.shape[1]]):
            columns[f"{name}_{axis}"] = _nullable(values[:, column])

    quantities = ("zmp", "force", "com", "angular_momentum")
    for name in quantities:
        put(f"plan_{name}", getattr(sample, name))
    columns["plan_angular_momentum_z"] = pa.nulls(walk.time.size, pa.float64())
    for name in quantities:
        put(f"command_{name}", getattr(record, f"command_{name}"))
    for name in quantities:
        put(f"measured_{name}", getattr(measured, name))
    columns["motion_angular_momentum_z"] = _nullable(walk.momentum_z)
    put("measured_zmp_momentum", measured.zmp_momentum)
    for index, foot in enumerate(("left", "right")):
        put(f"{foot}_force", measured.foot_force[:, index])
    for index, foot in enumerate(("left", "right")):
        columns[f"{foot}_contact"] = pa.array(measured.foot_contact[:, index])
    if walk.time.size:
        columns["plan_zmp_margin"] = _nullable(walk.plan.zmp_margin(sample.time))
    columns["measured_zmp_margin"] = _nullable(measured.polygon_margin)
    for part in PARTS:
        put(f"zmp_error_{part}", walk.zmp_split.parts[part])
    for index, foot in enumerate(("left", "right")):
        columns[f"{foot}_slip"] = _nullable(measured.slip[:, index])
        columns[f"{foot}_penetration"] = _nullable(measured.penetration[:, index])
    return pa.table(columns)


def _nullable(values: Array) -> pa.Array:
    """NaN becomes null: a number that was not measured is absent."""
    return pa.array(np.ascontiguousarray(values), from_pandas=True)

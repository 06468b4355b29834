"""Table of plan, command and measurement on one clock."""

import numpy as np
import pyarrow as pa

from ampm.geometry import Array
from validation.judge.compare import PARTS, Comparison
from validation.trial.record import state_steps

ALL = slice(None)
MOST_ROWS = 70_000
"""Rows on disk: 35 s at 0.5 ms, 10 MB. Of a longer walk every n-th step is kept."""


def kept_rows(steps: int, time_step: float) -> slice:
    """Steps of a walk whose signals are kept on disk: all, or as few as are needed.

    Every state on disk keeps its signals, if not every one has to go.
    """
    between = state_steps(time_step)
    apart = [n for n in range(1, between) if between % n == 0]
    least = next((n for n in apart if steps <= n * MOST_ROWS), -(-steps // (between * MOST_ROWS)) * between)
    return slice(None, None, least)


def signals_table(walk: Comparison, rows: slice = ALL) -> pa.Table:
    """Build the table of all steps or of some.

    A row holds plan and state at t_k, force and command over [t_k, t_(k+1)].
    Units and frames: :data:`validation.store.signals.COLUMNS`. ``plan`` is the plan that is judged, and where
    it moved ``first_plan`` the first one. The plan has no L_z: its column is null, and
    so are the ZMPs of an unsupported instant. ``motion_angular_momentum_z`` is that of the planned posture,
    ``zmp_error_{part}_{x,y}`` are the parts of the ZMP error.
    """
    record, measured, sample = walk.record, walk.measured, walk.sample
    time = walk.time[rows]
    columns: dict[str, pa.Array] = {
        "time": pa.array(time),
        "phase": pa.array(sample.phase_name[rows].tolist(), pa.string()),
        "stance": pa.array(sample.stance_name[rows].tolist(), pa.string()),
    }

    def put(name: str, values: Array) -> None:
        for column, axis in enumerate("xyz"[: values.shape[1]]):
            columns[f"{name}_{axis}"] = _nullable(values[rows, column])

    quantities = ("zmp", "force", "com", "angular_momentum")
    for name in quantities:
        put(f"plan_{name}", getattr(sample, name))
    columns["plan_angular_momentum_z"] = pa.nulls(time.size, pa.float64())
    if walk.first is not None:
        for name in quantities:
            put(f"first_plan_{name}", getattr(walk.first, name))
    for name in quantities:
        put(f"command_{name}", getattr(record, f"command_{name}"))
    for name in quantities:
        put(f"measured_{name}", getattr(measured, name))
    columns["motion_angular_momentum_z"] = _nullable(walk.planned.momentum_z[rows])
    put("measured_zmp_momentum", measured.zmp_momentum)
    for index, foot in enumerate(("left", "right")):
        put(f"{foot}_force", measured.foot_force[:, index])
    for index, foot in enumerate(("left", "right")):
        columns[f"{foot}_contact"] = pa.array(measured.foot_contact[rows, index])
    columns["plan_zmp_margin"] = _nullable(walk.planned.zmp_margin[rows])
    columns["measured_zmp_margin"] = _nullable(measured.polygon_margin[rows])
    for part in PARTS:
        put(f"zmp_error_{part}", walk.zmp_split.parts[part])
    for index, foot in enumerate(("left", "right")):
        columns[f"{foot}_slip"] = _nullable(measured.slip[rows, index])
        columns[f"{foot}_penetration"] = _nullable(measured.penetration[rows, index])
    return pa.table(columns)


def _nullable(values: Array) -> pa.Array:
    """NaN becomes null: a number that was not measured is absent."""
    return pa.array(np.ascontiguousarray(values), from_pandas=True)

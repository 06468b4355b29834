"""Table of plan, command and measurement on one clock."""

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.judge.compare import PARTS, Comparison
from validation.measure.measure import MeasuredGait
from validation.trial.record import FEET, state_steps
from validation.trial.unplanned import heading_velocity

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


def measured_columns(measured: MeasuredGait, rows: slice = ALL) -> dict[str, NDArray[Any]]:
    """The columns that do not depend on the plan, shape (n,) each; NaN where nothing was measured."""
    columns: dict[str, NDArray[Any]] = {}
    for name in ("zmp", "force", "com", "angular_momentum", "zmp_momentum"):
        columns |= _by_axis(f"measured_{name}", getattr(measured, name)[rows])
    columns["measured_zmp_margin"] = measured.polygon_margin[rows]
    for index, foot in enumerate(FEET):
        columns |= _by_axis(f"{foot}_force", measured.foot_force[rows, index])
        columns[f"{foot}_contact"] = measured.foot_contact[rows, index]
        columns[f"{foot}_slip"] = measured.slip[rows, index]
        columns[f"{foot}_penetration"] = measured.penetration[rows, index]
    return columns


def _by_axis(name: str, values: Array) -> dict[str, NDArray[Any]]:
    """Components of vectors (n, 2) or (n, 3) by the names of their columns."""
    return {f"{name}_{axis}": column for axis, column in zip("xyz", values.T, strict=False)}


def signals_table(walk: Comparison, rows: slice = ALL) -> pa.Table:
    """Build the table of all steps or of some.

    A row holds plan and state at t_k, force and command over [t_k, t_(k+1)].
    Units and frames: :data:`validation.store.signals.COLUMNS`. ``plan`` is the plan that is judged, and where
    it moved ``first_plan`` the first one. The plan has no L_z: its column is null, and
    so are the ZMPs of an unsupported instant. ``motion_angular_momentum_z`` is that of the planned posture,
    ``zmp_error_{part}_{x,y}`` are the parts of the ZMP error. A walk without a plan has its velocity, too.
    """
    record, measured, sample = walk.record, walk.measured, walk.sample
    time = walk.time[rows]
    columns: dict[str, pa.Array] = {
        "time": pa.array(time),
        "phase": pa.array(sample.phase_name[rows].tolist(), pa.string()),
        "stance": pa.array(sample.stance_name[rows].tolist(), pa.string()),
    }

    def put(name: str, values: Array) -> None:
        columns.update((key, _nullable(column)) for key, column in _by_axis(name, values[rows]).items())

    quantities = ("zmp", "force", "com", "angular_momentum")
    for name in quantities:
        put(f"plan_{name}", getattr(sample, name))
    columns["plan_angular_momentum_z"] = pa.nulls(time.size, pa.float64())
    if walk.first is not None:
        for name in quantities:
            put(f"first_plan_{name}", getattr(walk.first, name))
    for name in quantities:
        put(f"command_{name}", getattr(record, f"command_{name}"))
    if (command := walk.plan.command) is not None:
        asked = np.array([command.at(at) for at in walk.time.tolist()]).reshape(-1, 3)
        for kind, values in (("command", asked), ("measured", heading_velocity(record))):
            put(f"{kind}_velocity", values[:, :2])
            columns[f"{kind}_yaw_rate"] = _nullable(values[rows, 2])
    columns |= {name: _nullable(values) for name, values in measured_columns(measured, rows).items()}
    columns["motion_angular_momentum_z"] = _nullable(walk.planned.momentum_z[rows])
    columns["plan_zmp_margin"] = _nullable(walk.planned.zmp_margin[rows])
    for part in PARTS:
        put(f"zmp_error_{part}", walk.zmp_split.parts[part])
    return pa.table(columns)


def _nullable(values: NDArray[Any]) -> pa.Array:
    """NaN becomes null: a number that was not measured is absent."""
    return pa.array(np.ascontiguousarray(values), from_pandas=True)

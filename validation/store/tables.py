"""Plans and motions as tables, and tables as CSV or Parquet."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.description import SOLE_POINT_GROUPS
from ampm.exceptions import InputError
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.support import StepPlan

if TYPE_CHECKING:
    from numpy.typing import NDArray


MOST_SAMPLES = 5_000_000
"""Samples of one table at most: about 2 GB of memory."""

SUFFIXES = (".csv", ".parquet")
FEET = ("left", "right")


def sample_times(duration: float, rate: float) -> NDArray[np.float64]:
    """Times k / rate that lie within a plan.

    Args:
        duration: of the plan [s].
        rate: samples per second [Hz].

    Raises:
        InputError: the rate is no positive finite number, or asks for too many samples.
    """
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(f"--rate {rate:g} Hz must be a positive number; give for example 200.")
    count = math.floor(duration * rate * (1 + 1e-12)) + 1
    if count > MOST_SAMPLES:
        raise InputError(
            f"--rate {rate:g} Hz asks for {count} samples of {duration:.3g} s, more than {MOST_SAMPLES}; "
            "give a lower rate or fewer steps."
        )
    return np.minimum(np.arange(count) / rate, duration)


def plan_table(plan: CentroidalPlan, times: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """A plan at given times, one column per scalar.

    Args:
        plan: any plan. Every plan has the feet's placements (of a swinging foot the next one); one with a
            body's soles also has the motion of their reference points, pitch, toe angle and contacts.
        times: shape (N,) [s].

    Returns:
        Column name to array (N,). SI units, world frame; undefined entries are NaN.
    """
    sample = plan.sample(times)
    columns: dict[str, NDArray[Any]] = {
        "time": sample.time,
        "phase": sample.phase_name.astype(object),
        "stance": sample.stance_name.astype(object),
    }
    for name, axes in (
        ("com", "xyz"),
        ("com_velocity", "xyz"),
        ("com_acceleration", "xyz"),
        ("dcm", "xy"),
        ("zmp", "xy"),
        ("force", "xyz"),
        ("moment", "xy"),
        ("angular_momentum", "xy"),
    ):
        values = getattr(sample, name)
        for index, axis in enumerate(axes):
            columns[f"{name}_{axis}"] = values[:, index]
    for foot in FEET:
        placement = getattr(sample, f"{foot}_placement")
        for index, axis in enumerate("xy"):
            columns[f"{foot}_placement_{axis}"] = placement[:, index]
    if not isinstance(plan, StepPlan):
        return columns
    for foot, motion in zip(FEET, plan.feet.sample(times), strict=True):
        for index, axis in enumerate("xyz"):
            columns[f"{foot}_foot_{axis}"] = motion.position[:, index]
        columns[f"{foot}_foot_pitch"] = motion.pitch
        columns[f"{foot}_toe"] = motion.toe
        for index, group in enumerate(SOLE_POINT_GROUPS):
            columns[f"{foot}_{group}_contact"] = motion.contact[:, index]
    return columns


def write_columns(
    columns: Mapping[str, NDArray[Any]], path: Path, metadata: Mapping[str, str] | None = None
) -> None:
    """Write columns as CSV or Parquet, by the path's suffix; floats keep every bit.

    Args:
        columns: name to array (N,); NaN is written as an empty cell or null.
        path: ends in ``.csv`` or ``.parquet``.
        metadata: schema metadata of a Parquet file; CSV has no place for it.

    Raises:
        InputError: another suffix.
    """
    check_suffix(path)
    if path.suffix == ".csv":
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            texts = [_texts(column) for column in columns.values()]
            writer.writerows(zip(*texts, strict=True))
        return
    arrays = [
        pa.array(column, from_pandas=True) if column.dtype != object else pa.array(column.tolist())
        for column in columns.values()
    ]
    schema = pa.schema(
        [pa.field(name, array.type) for name, array in zip(columns, arrays, strict=True)],
        metadata={key.encode(): value.encode() for key, value in (metadata or {}).items()} or None,
    )
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path, compression="zstd")


def check_suffix(path: Path) -> None:
    """Raise :class:`InputError` unless the path ends in a suffix that :func:`write_columns` knows."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} must end in {' or '.join(SUFFIXES)}; the suffix chooses the format.")


def _texts(column: NDArray[Any]) -> list[str]:
    if column.dtype == bool:
        return ["true" if value else "false" for value in column.tolist()]
    if column.dtype == object:
        return [str(value) for value in column.tolist()]
    return ["" if value != value else repr(value) for value in column.tolist()]  # NaN is empty

"""Plans and motions as tables, and tables as CSV or Parquet."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.description import SOLE_POINT_GROUPS
from ampm.exceptions import InputError
from ampm.planner.centroidal import CentroidalPlan, phase_of
from ampm.planner.support import StepPlan
from validation.trial.record import FEET

MOST_SAMPLES = 5_000_000
"""Samples of one table at most: about 2 GB of memory."""


def sample_times(duration: float, rate: float) -> NDArray[np.float64]:
    """Times k / rate [Hz] within the duration of a plan [s].

    Raises :class:`InputError` if the rate is no positive finite number, or gives too many samples.
    """
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(f"--rate {rate:g} Hz must be a positive number; give for example 200.")
    last = duration * rate * (1 + 1e-12)
    if last >= MOST_SAMPLES:
        raise InputError(
            f"--rate {rate:g} Hz gives {last:.4g} samples, over {MOST_SAMPLES}; lower the rate or the steps."
        )
    return np.minimum(np.arange(math.floor(last) + 1) / rate, duration)


def plan_table(plan: CentroidalPlan, times: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """A plan at given times, shape (N,) [s]: column name to array (N,), in SI units and world frame.

    Every plan has the feet's placements (of a swinging foot the next one); one with a body's soles also has
    the motion of their reference points, pitch, toe angle and contacts. Undefined entries are NaN.
    """
    sample = plan.sample(times)
    phase = phase_of(plan.contacts.starts, sample.time)
    columns: dict[str, NDArray[Any]] = {
        "time": sample.time,
        "phase": sample.phase_name.astype(object),
        "stance": sample.stance_name.astype(object),
        "phase_start": plan.contacts.starts[phase],
    }

    def add(name: str, values: NDArray[Any], endings: Sequence[str] = "xyz") -> None:
        columns.update((f"{name}_{ending}", part) for ending, part in zip(endings, values.T, strict=False))

    com = ("com", "com_velocity", "com_acceleration")
    for name in (*com, "dcm", "zmp", "force", "moment", "angular_momentum"):
        add(name, getattr(sample, name))
    for side, foot in enumerate(FEET):
        add(f"{foot}_placement", plan.contacts.placements[phase, side])
        columns[f"{foot}_placement_heading"] = plan.contacts.foot_headings[phase, side]
    if not isinstance(plan, StepPlan):
        return columns
    for foot, motion in zip(FEET, plan.feet.sample(times), strict=True):
        add(f"{foot}_foot", motion.position)
        columns |= {f"{foot}_foot_pitch": motion.pitch, f"{foot}_toe": motion.toe}
        add(foot, motion.contact, [f"{group}_contact" for group in SOLE_POINT_GROUPS])
    return columns


def write_columns(columns: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns (N,) as Parquet or CSV, by the suffix; floats keep every bit, NaN is an empty cell."""
    # Imported here: 'ampm plan' writes nothing by default, and starts faster without.
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    if path.suffix == ".parquet":
        pq.write_table(table, path, compression="zstd")
    else:
        pyarrow.csv.write_csv(table, path)

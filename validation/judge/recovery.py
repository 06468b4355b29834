"""How long after a push a walk needs to come back to its plan."""

import math
from collections.abc import Mapping

import numpy as np
from scipy.ndimage import maximum_filter1d

from ampm.geometry import Array
from validation.judge.compare import Comparison, signal_pairs


def recovery_time(walk: Comparison, limits: Mapping[str, float]) -> float | None:
    """Time from the end of the last push until every error stays within its limits for one step [s].

    Args:
        walk: beside its plan.
        limits: of the RMS and largest error over a step, by the names of the metrics in SI units.

    Returns:
        Infinite if the errors do not; None if nothing pushed the body.
    """
    record = walk.record
    pushed = np.flatnonzero(record.external_force.any(axis=(1, 2)) | record.external_moment.any(axis=(1, 2)))
    if not pushed.size:
        return None
    step = max(round(walk.plan.constants.step_duration / record.time_step), 1)
    within = np.ones(max(record.steps - step + 1, 0), dtype=bool)  # of the steps that begin at each instant
    if not within.size:
        return math.inf
    for name, (value, reference) in signal_pairs(walk.planned, walk.measured, record).items():
        error = np.nan_to_num(np.abs(value - reference), nan=np.inf)
        for statistic in ("rmse", "maximum"):
            limit = limits.get(f"{name}_{statistic}", math.inf)
            if limit < math.inf:
                within &= (_rms(error, step) if statistic == "rmse" else _largest(error, step)) <= limit
    begins = np.flatnonzero(within[pushed[-1] + 1 :])
    return float(begins[0] * record.time_step) if begins.size else math.inf


def _rms(error: Array, step: int) -> Array:
    """RMS over the ``step`` instants from each one on."""
    sums = np.cumsum(np.append(0.0, np.minimum(error, 1e6) ** 2))
    return np.sqrt(np.maximum(sums[step:] - sums[:-step], 0.0) / step)


def _largest(error: Array, step: int) -> Array:
    """Largest value over the ``step`` instants from each one on."""
    return np.asarray(maximum_filter1d(error, step, origin=-(step // 2)))[: error.size - step + 1]

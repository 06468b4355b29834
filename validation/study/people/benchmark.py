"""The mean strides of the benchmark of predictive simulations (Afschrift et al. 2025) as a table.

Its files are JSON, one walking condition each: ``grf_r`` and, in some, ``grf_l``, the mean force on a foot
over the right foot's stride, shape (n, 3): forward, up, to the right, over m g; ``subject_mass`` [kg],
``leglength`` [m], ``speed`` [m/s], and ``stride_frequency`` over (g / leglength)^1/2. Other entries are not
read. Without ``grf_l`` the left foot is the right one's mirror image, half a stride later.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY

STRIDES = 3
"""Times that the mean stride is repeated: two whole strides lie between the instants that bound them."""
_AXES = (("x", 0, 1.0), ("y", 2, -1.0), ("z", 1, 1.0))  # ours, theirs, sign
_NUMBERS = ("subject_mass", "leglength", "speed", "stride_frequency")


def read_benchmark(path: Path) -> dict[str, Array]:
    """Columns of a recording, see :mod:`validation.study.people.walking`, of a file of the benchmark.

    Raises:
        InputError: the file cannot be read, or lacks what is needed.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as JSON ({error}).") from None
    numbers = {name: _number(data, name, path) for name in _NUMBERS}
    right = _forces(data, "grf_r", path)
    count = len(right) - 1  # the last row is the first of the next stride
    left = _forces(data, "grf_l", path) if data.get("grf_l") else None
    if left is None:
        left = np.roll(right[:-1], round(0.5 * count), axis=0) * [1.0, 1.0, -1.0]
    elif len(left) != len(right):
        raise InputError(f"{path}: grf_l has {len(left)} rows and grf_r {len(right)}; give equally many.")
    duration = 1.0 / (numbers["stride_frequency"] * np.sqrt(GRAVITY / numbers["leglength"]))
    rows = STRIDES * count
    columns = {"time": np.arange(rows) * duration / count}
    for foot, values in (("left", left[:count]), ("right", right[:count])):
        force = numbers["subject_mass"] * GRAVITY * np.tile(values, (STRIDES, 1))
        columns |= {f"{foot}_force_{axis}": sign * force[:, k] for axis, k, sign in _AXES}
    return columns | {"belt_speed": np.full(rows, numbers["speed"])}


def _number(data: Any, name: str, path: Path) -> float:
    value = data.get(name) if isinstance(data, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < np.inf:
        raise InputError(
            f"{path}: {name} = {value!r} must be a positive number; give a file of the benchmark."
        )
    return float(value)


def _forces(data: dict[str, Any], name: str, path: Path) -> Array:
    try:
        values = np.array(data.get(name), dtype=np.float64)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.ndim != 2 or values.shape[1] != 3 or len(values) < 11 or not np.isfinite(values).all():
        raise InputError(f"{path}: {name} must be 11 rows or more of three finite numbers.")
    return values

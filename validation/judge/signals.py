"""Table of plan, command and measurement on one clock."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from validation.judge.compare import PARTS, Comparison
from validation.store.signals import KINDS
from validation.trial.record import heading_velocity, state_steps

ALL = slice(None)
MOST_ROWS = 70_000
"""Rows on disk: 35 s at 0.5 ms, 10 MB. Of a longer walk every n-th step is kept."""


def kept_rows(steps: int, time_step: float) -> slice:
    """Steps of a walk whose signals are kept on disk: every n-th, with the least n that keeps few enough.

    To have the signals of every state on disk, n divides the steps from state to state. If that leaves too
    many rows, n is a multiple of these steps.
    """
    between = state_steps(time_step)
    divisors = [n for n in range(1, between) if between % n == 0]
    multiple = max(-(-steps // (between * MOST_ROWS)), 1) * between
    return slice(None, None, next((n for n in divisors if steps <= n * MOST_ROWS), multiple))


def columns_of(things: Mapping[str, Any], rows: slice) -> dict[str, NDArray[Any]]:
    """Columns (n,) that :data:`KINDS` takes from attributes of some objects, by names such as `measured`."""
    found: dict[str, NDArray[Any]] = {}
    for kind in KINDS:
        thing, _, attribute = kind.source.partition(".")
        if thing in things:
            values, names = getattr(things[thing], attribute)[rows], kind.names
            found.update(zip(names, values.reshape(len(values), len(names)).T, strict=True))
    return found


def signals_table(walk: Comparison, rows: slice = ALL) -> pa.Table:
    """Build the table of all steps or of some, with the columns of :data:`validation.store.signals.KINDS`.

    A row holds plan and state at t_k, force and command over [t_k, t_(k+1)]. A number that was not measured
    is null. A walk without a plan has its velocity, too.
    """
    parts = np.stack([walk.zmp_split.parts[part] for part in PARTS], axis=1)
    things: dict[str, Any] = {
        "measured": walk.measured,
        "record": walk.record,
        "plan": walk.sample,
        "error": SimpleNamespace(parts=parts),
    }
    if walk.first is not None:
        things["first"] = walk.first
    if (command := walk.plan.command) is not None:
        asked = np.array([command.at(at) for at in walk.time.tolist()]).reshape(-1, 3)
        both = np.stack([asked, heading_velocity(walk.record)], axis=1)
        things["heading"] = SimpleNamespace(velocity=both[:, :, :2], yaw_rate=both[:, :, 2])
    columns = columns_of(things, rows)
    return pa.table(
        {name: pa.array(np.ascontiguousarray(values), from_pandas=True) for name, values in columns.items()}
    )

"""What the pass map of a sweep's report carries in the page: few bytes per run, none too many.

Numbers are packed as 16-bit shares of their range (finer than any screen), words as indices. Up to
:data:`MOST_POINTS` runs are all in the page. Of more, a random draw is, for the points and their details, and
beside it the counts of *all* runs in every cell of every pair of parameters, so that the map of cells is
exact and the page no larger for a hundred thousand runs than for a few thousand.
"""

from __future__ import annotations

import base64
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.study.sweep.table import STATES, SweepTable

Array = NDArray[np.float64]

MOST_POINTS = 4000
"""Runs that are in the page one by one; a map of more points than that is a blot anyway."""
MOST_OF_RARE = 200
"""Runs of one state that are drawn before the others."""
MOST_EXACT = 50_000
"""Parameter values that are in the page with all their digits, so that any run can be repeated from it."""
MOST_CAUSES = 1500
"""Runs of which the sentence on why they ended is in the page, too; it is the only text that is long."""
CELLS = 24
"""Cells along an axis with a range."""
MOST_LEVELS = 24
"""Distinct values up to which an axis shows them as levels."""
MOST_PAIRED = 12
"""Parameters whose pairs are counted over all runs, where not all runs are in the page."""
_TOP = 65533
"""Largest packed number; then come infinity and no value."""
INFINITE, ABSENT = 65534, 65535


@dataclass(frozen=True)
class Axis:
    """One quantity that the map can show.

    Attributes:
        key: of a parameter, or ``metric:<name>``, ``used``.
        label: for people.
        unit: of ``values``, empty if none.
        values: shape (N,), as shown; index of the level where ``levels`` is not None. NaN where absent.
        levels: names of the levels, None for a range.
        parameter: whether it is a parameter (any may be an axis), else a figure (colour or vertical axis).
        limit: tolerance in ``unit``, None if it has none.
    """

    key: str
    label: str
    unit: str
    values: Array
    levels: tuple[str, ...] | None
    parameter: bool
    limit: float | None = None

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest finite value; a little apart if they are equal."""
        finite = self.values[np.isfinite(self.values)]
        if self.levels is not None:
            return 0.0, float(max(len(self.levels) - 1, 1))
        if not finite.size:
            return 0.0, 1.0
        low, high = float(finite.min()), float(finite.max())
        if low == high:
            pad = abs(low) * 0.01 or 0.5
            return low - pad, high + pad
        return low, high


def parameter_axis(sweep: SweepTable, key: str) -> Axis:
    """A parameter as an axis: levels if it has words or few values, else a range."""
    unit = sweep.unit(key)
    unit = "" if unit == "1" else unit
    if not sweep.is_number(key):
        words = sweep.words(key)
        levels = tuple(sorted(set(words)))
        index = {word: float(number) for number, word in enumerate(levels)}
        return Axis(key, key, "", np.array([index[word] for word in words]), levels, True)
    values = sweep.numbers(key)
    distinct = np.unique(values[~np.isnan(values)])
    if len(distinct) <= MOST_LEVELS and (len(distinct) <= len(sweep) / 2 or not np.isfinite(distinct).all()):
        position = np.searchsorted(distinct, values).astype(float)
        position[np.isnan(values)] = np.nan
        return Axis(key, key, unit, position, tuple(level_text(value) for value in distinct), True)
    return Axis(key, key, unit, values, None, True)


def level_text(value: float) -> str:
    """A level as a user would type it."""
    if np.isinf(value):
        return "inf" if value > 0 else "-inf"
    return f"{value:.6g}"


def metric_axis(sweep: SweepTable, metric: str, label: str) -> Axis:
    """A metric as an axis or colour, in the unit in which people read it."""
    values, limit, unit = sweep.shown(metric)
    return Axis(f"metric:{metric}", label, unit, values, None, False, limit)


def used_axis(sweep: SweepTable) -> Axis:
    """The largest share of a tolerance that a run used."""
    values = 100.0 * sweep.worst_used
    return Axis("used", "largest share of a tolerance", "%", values, None, False, 100.0)


def pack(axis: Axis, rows: NDArray[np.int64]) -> str:
    """Values of some runs as base64 of little-endian 16-bit shares of the axis' range."""
    low, high = axis.range
    value = axis.values[rows]
    share = np.clip(np.nan_to_num((value - low) / (high - low), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    packed = np.round(share * _TOP).astype("<u2")
    packed[np.isinf(value)] = INFINITE
    packed[np.isnan(value)] = ABSENT
    return base64.b64encode(packed.tobytes()).decode()


def pack_exact(sweep: SweepTable, axis: Axis, rows: NDArray[np.int64]) -> str | None:
    """A parameter's numbers as base64 of little-endian 64-bit floats; None for words and figures."""
    if not axis.parameter or not sweep.is_number(axis.key):
        return None
    return base64.b64encode(sweep.numbers(axis.key)[rows].astype("<f8").tobytes()).decode()


def cell_index(axis: Axis) -> tuple[NDArray[np.int64], int]:
    """Cell of every run along an axis, -1 where it has no value, and the number of cells."""
    if axis.levels is not None:
        return np.where(np.isnan(axis.values), -1, np.nan_to_num(axis.values)).astype(np.int64), len(
            axis.levels
        )
    low, high = axis.range
    share = np.nan_to_num((axis.values - low) / (high - low), nan=-1.0, posinf=1.0, neginf=0.0)
    index = np.minimum((share * CELLS).astype(np.int64), CELLS - 1)
    return np.where(share < 0.0, -1, index), CELLS


def pack_cells(a: Axis, b: Axis, states: NDArray[np.int64]) -> str:
    """Counts of all runs by cell and state, as base64 of variable-length integers.

    Order: cell along ``b``, cell along ``a``, state, the last changing fastest. Seven bits to a byte, the
    lowest first, the eighth set where more follow.
    """
    i, width = cell_index(a)
    j, height = cell_index(b)
    kinds = len(STATES)
    inside = (i >= 0) & (j >= 0)
    flat = ((j * width + i) * kinds + states)[inside]
    return base64.b64encode(varint(np.bincount(flat, minlength=width * height * kinds))).decode()


def varint(counts: NDArray[np.int64]) -> bytes:
    """Counts as variable-length integers (LEB128)."""
    packed = bytearray()
    for count in counts.tolist():
        while count > 127:
            packed.append(count & 127 | 128)
            count >>= 7
        packed.append(count)
    return bytes(packed)


def drawn_rows(sweep: SweepTable, keep: Sequence[int] = (), seed: int = 1) -> NDArray[np.int64]:
    """Runs that are in the page one by one: all, or :data:`MOST_POINTS` of them.

    Of every state up to :data:`MOST_OF_RARE` runs are drawn first, so that what is rare is not lost; the
    others at random from the rest.

    Args:
        sweep: the sweep.
        keep: rows to take in any case.
        seed: of the draw.
    """
    if len(sweep) <= MOST_POINTS:
        return np.arange(len(sweep))
    rng = np.random.default_rng(seed)
    kept = [np.asarray(keep, dtype=np.int64)]
    for state in range(len(STATES)):
        rows = np.flatnonzero(sweep.states == state)
        kept.append(rows if len(rows) <= MOST_OF_RARE else rng.choice(rows, MOST_OF_RARE, replace=False))
    first = np.unique(np.concatenate(kept))
    others = np.setdiff1d(np.arange(len(sweep)), first)
    room = max(MOST_POINTS - len(first), 0)
    return np.sort(np.concatenate([first, rng.choice(others, min(room, len(others)), replace=False)]))


def map_data(
    sweep: SweepTable,
    parameters: Sequence[str],
    metrics: Mapping[str, str],
    links: Mapping[int, Sequence[tuple[str, str]]],
    repeat: Mapping[str, Any],
    keep: Sequence[int] = (),
) -> dict[str, Any] | None:
    """All that the page's script needs.

    Args:
        sweep: the sweep.
        parameters: keys of the varied parameters, the two of the first map first.
        metrics: label by name of the judged metrics.
        links: text and address, relative to the page, of what is kept of a row.
        repeat: how a run is repeated: ``start`` and ``end`` of the command line, the varied keys between.
        keep: rows that must be among the points.

    Returns:
        JSON-ready values, None if no parameter varies.
    """
    if not parameters or not len(sweep):
        return None
    axes = [parameter_axis(sweep, key) for key in parameters]
    figures = [metric_axis(sweep, name, label) for name, label in metrics.items()]
    figures = [axis for axis in figures if np.isfinite(axis.values).any()]
    if figures:
        figures.insert(0, used_axis(sweep))
    rows = drawn_rows(sweep, keep)
    names, reasons, failed = (sweep.words(column) for column in ("name", "reason", "failed"))
    exact = len(rows) * len(axes) <= MOST_EXACT
    data: dict[str, Any] = {
        "total": len(sweep),
        "points": len(rows),
        "states": [state.label for state in STATES],
        "classes": [state.value for state in STATES],
        "state": base64.b64encode(sweep.states[rows].astype("u1").tobytes()).decode(),
        "name": [names[row] for row in rows],
        "axes": [
            {
                "key": axis.key,
                "label": axis.label,
                "unit": axis.unit,
                "levels": axis.levels,
                "low": axis.range[0],
                "high": axis.range[1],
                "parameter": axis.parameter,
                "limit": axis.limit,
                "values": pack(axis, rows),
                "exact": pack_exact(sweep, axis, rows) if exact else None,
            }
            for axis in (*axes, *figures)
        ],
        "links": {str(place): links[row] for place, row in enumerate(rows.tolist()) if row in links},
        "repeat": dict(repeat),
        "metrics": dict(metrics),
        "cells": CELLS,
        **_coded("reason", [reasons[row] for row in rows]),
        **_coded("failed", [failed[row] for row in rows]),
    }
    if len(rows) <= MOST_CAUSES:
        causes = sweep.words("cause")
        data["cause"] = {
            str(place): causes[row][:240] for place, row in enumerate(rows.tolist()) if causes[row]
        }
    if len(rows) < len(sweep):
        data["pairs"] = {
            f"{i},{j}": pack_cells(axes[i], axes[j], sweep.states)
            for i, j in itertools.combinations(range(min(len(axes), MOST_PAIRED)), 2)
        }
    return data


def _coded(name: str, words: Sequence[str]) -> dict[str, Any]:
    """Words as a list of the distinct ones and an index into it for every run."""
    distinct = sorted(set(words))
    index = {word: number for number, word in enumerate(distinct)}
    return {f"{name}s": distinct, name: [index[word] for word in words]}

"""A sweep's table as report and comparison read it: states, parameters that vary, figures and their limits.

Only ``results.parquet`` is read: what is said of a sweep can be said again from its saved table.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.parameters import GRAVITY, RunParameters, keys
from validation.judge.metrics import BODY_WEIGHT, METRICS, display_unit
from validation.judge.profiles import DEFAULT, PROFILES
from validation.study.sweep import store
from validation.study.sweep.columns import TABLE_METADATA
from validation.study.sweep.store import RESULTS

Array = NDArray[np.float64]

METRIC = "metric_"


class State(StrEnum):
    """How a run of a sweep ended, its verdict included; in the order in which they are shown."""

    PASS = "pass"
    OUT_OF_TOLERANCE = "out_of_tolerance"
    NOT_MEASURED = "not_measured"
    FELL = "fell"
    DIVERGED = "diverged"
    INFEASIBLE = "infeasible"
    REFUSED = "refused"
    CRASHED = "crashed"
    TIMED_OUT = "timed_out"
    INTERRUPTED = "interrupted"

    @property
    def label(self) -> str:
        """For people."""
        return self.value.replace("_", " ")

    @property
    def walked(self) -> bool:
        """Whether the body moved, so that a failure is the gait's or the controller's."""
        return self in _WALKED

    @property
    def known(self) -> bool:
        """Whether the sweep has an answer for this gait: a crash, a hang and Ctrl-C give none."""
        return self not in BROKEN


_WALKED = frozenset(
    {
        State.PASS,
        State.OUT_OF_TOLERANCE,
        State.NOT_MEASURED,
        State.FELL,
        State.DIVERGED,
        State.INFEASIBLE,
    }
)
STATES: tuple[State, ...] = tuple(State)
LOST = (State.FELL, State.DIVERGED, State.INFEASIBLE, State.NOT_MEASURED)
"""Walks without a verdict on their figures."""
BROKEN = (State.CRASHED, State.TIMED_OUT, State.INTERRUPTED)
"""No answer about the gait."""
_VERDICTS = {"pass": State.PASS, "fail": State.OUT_OF_TOLERANCE}


@dataclass(frozen=True)
class Limit:
    """A tolerance of the sweep's profile.

    Attributes:
        metric: name without prefix.
        limit: largest value that passes, in ``unit``.
        unit: SI unit, or ``body weight``.
        reason: why this number.
    """

    metric: str
    limit: float
    unit: str
    reason: str


@dataclass(frozen=True)
class SweepTable:
    """One sweep.

    Attributes:
        table: one row per run, sorted by ``run``.
        metadata: what the table says of itself.
        directory: the sweep's folder, None if only a file was given.
        source: as the user named it, for messages.
    """

    table: pa.Table
    metadata: Mapping[str, Any]
    directory: Path | None
    source: str

    def __len__(self) -> int:
        return self.table.num_rows

    def __contains__(self, name: str) -> bool:
        return name in self.table.column_names

    @property
    def name(self) -> str:
        """Name of the sweep: its definition's, else its folder's."""
        definition = self.metadata.get("definition")
        named = definition.get("name") if isinstance(definition, Mapping) else None
        fallback = self.directory.resolve().name if self.directory else Path(self.source).stem
        return str(self.metadata.get("name") or named or fallback)

    @property
    def profile(self) -> str:
        """Name of the tolerance profile, empty if unknown."""
        return str(self.metadata.get("profile") or "")

    @cached_property
    def states(self) -> NDArray[np.int64]:
        """State of every run, shape (N,), as index into :data:`STATES`."""
        outcomes = self.words("outcome")
        verdicts = self.words("verdict")
        index = {state.value: number for number, state in enumerate(STATES)}
        found = np.empty(len(self), dtype=np.int64)
        for row, (outcome, verdict) in enumerate(zip(outcomes, verdicts, strict=True)):
            state = _VERDICTS.get(verdict, State.NOT_MEASURED) if outcome == "completed" else outcome
            if state not in index:
                raise InputError(
                    f"{self.source}: run {row} has the outcome {outcome!r}, which this version does not "
                    "know; use the version that wrote it."
                )
            found[row] = index[state]
        return found

    def is_state(self, *states: State) -> NDArray[np.bool_]:
        """Rows in one of these states, shape (N,)."""
        return np.isin(self.states, [STATES.index(state) for state in states])

    @cached_property
    def counts(self) -> Mapping[State, int]:
        """Runs in every state, zeros included."""
        counted = np.bincount(self.states, minlength=len(STATES))
        return {state: int(counted[number]) for number, state in enumerate(STATES)}

    @cached_property
    def _kept(self) -> dict[str, Array]:
        """Columns that were asked for; a report asks for some of them dozens of times."""
        return {}

    def numbers(self, name: str) -> Array:
        """A column of numbers, shape (N,), read-only; NaN where there is none, or no such column."""
        if name not in self._kept:
            values = self._numbers(name)
            values.flags.writeable = False
            self._kept[name] = values
        return self._kept[name]

    def _numbers(self, name: str) -> Array:
        if name not in self:
            return np.full(len(self), np.nan)
        column = self.table.column(name)
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.int8())
        try:
            return np.array(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            raise InputError(f"{self.source}: column {name} holds {column.type}, not numbers.") from error

    def words(self, name: str) -> list[str]:
        """A column as text; empty where there is none."""
        if name not in self:
            return [""] * len(self)
        return ["" if value is None else str(value) for value in self.table.column(name).to_pylist()]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys of all parameters in the table, known ones in their usual order."""
        sections = tuple(f"{name}." for name in RunParameters.model_fields)
        present = [name for name in self.table.column_names if name.startswith(sections)]
        known = {key: number for number, key in enumerate(keys())}
        return tuple(sorted(present, key=lambda name: known.get(name, len(known))))

    @cached_property
    def varied(self) -> tuple[str, ...]:
        """Parameters with more than one value in this sweep, those that the definition varies first."""
        found = [name for name in self.parameters if len(self.table.column(name).unique()) > 1]
        first = [name for name in self.metadata.get("varied") or () if name in found]
        return (*first, *(name for name in found if name not in first))

    @property
    def planned(self) -> int:
        """Runs that the sweep is to have; more than there are rows while it is not finished."""
        runs = self.metadata.get("runs")
        return max(len(self), runs) if isinstance(runs, int) else len(self)

    def is_number(self, name: str) -> bool:
        """Whether a column holds numbers."""
        kind = self.table.schema.field(name).type
        return pa.types.is_floating(kind) or pa.types.is_integer(kind)

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Metrics with a column, judged ones first, in the profile's order."""
        present = [name[len(METRIC) :] for name in self.table.column_names if name.startswith(METRIC)]
        judged = [name for name in self.limits if name in present]
        return (*judged, *(name for name in present if name not in self.limits))

    @cached_property
    def limits(self) -> Mapping[str, Limit]:
        """Tolerances by metric: those in the table, else those of the named profile."""
        entries = self.metadata.get("tolerances")
        if isinstance(entries, Mapping):
            entries = [{"metric": name, **_mapping(entry)} for name, entry in entries.items()]
        if not entries:
            profile = PROFILES.get(self.profile)
            entries = [vars(item) for item in profile.tolerances] if profile else []
        found: dict[str, Limit] = {}
        order = PROFILES[self.profile].tolerances if self.profile in PROFILES else ()
        rank = {item.metric: number for number, item in enumerate(order)}
        for entry in sorted(entries, key=lambda item: rank.get(str(item["metric"]), len(rank))):
            found[str(entry["metric"])] = Limit(
                str(entry["metric"]),
                float(entry["limit"]),
                str(entry.get("unit") or "1"),
                str(entry.get("reason") or ""),
            )
        return found

    def unit(self, name: str) -> str:
        """Unit of a column, ``1`` if it has none."""
        columns = _mapping(self.metadata.get("columns"))
        entry = columns.get(name)
        if isinstance(entry, Mapping) and entry.get("unit"):
            return str(entry["unit"])
        metric = METRICS.get(name.removeprefix(METRIC))
        return metric.unit if metric else _UNITS.get(name, "1")

    def describe(self, name: str) -> str:
        """What a column holds, in words; empty if the table does not say."""
        entry = _mapping(self.metadata.get("columns")).get(name)
        return str(entry.get("words") or "") if isinstance(entry, Mapping) else ""

    @cached_property
    def weight(self) -> Array:
        """Weight of the body of every run, shape (N,) [N]."""
        return self.numbers("body.mass") * GRAVITY

    def limit_values(self, metric: str) -> Array:
        """A metric's limit in the unit of its column, shape (N,); NaN if it is not judged."""
        limit = self.limits.get(metric)
        if limit is None:
            return np.full(len(self), np.nan)
        scale = self.weight if limit.unit == BODY_WEIGHT else np.ones(len(self))
        return limit.limit * scale

    def used(self, metric: str) -> Array:
        """Share of its tolerance that a metric used in every *completed* run, shape (N,); NaN elsewhere.

        A tolerance of zero is used by 0 if it is met, and by infinity if not.
        """
        if f"used:{metric}" in self._kept:
            return self._kept[f"used:{metric}"]
        value, limit = self.numbers(METRIC + metric), self.limit_values(metric)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(limit > 0.0, value / limit, np.where(value > 0.0, np.inf, 0.0))
        share = np.where(self.measured & np.isfinite(value) & np.isfinite(limit), share, np.nan)
        share.flags.writeable = False
        self._kept[f"used:{metric}"] = share
        return share

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Runs whose figures are those of a whole walk, shape (N,)."""
        return self.is_state(State.PASS, State.OUT_OF_TOLERANCE)

    @cached_property
    def worst_used(self) -> Array:
        """Largest share of a tolerance that any judged metric of a run used, shape (N,); NaN unmeasured."""
        judged = [name for name in self.metrics if name in self.limits]
        if not judged:
            return np.full(len(self), np.nan)
        shares = np.stack([self.used(name) for name in judged])
        known = ~np.isnan(shares).all(axis=0)
        return np.where(known, np.max(np.where(np.isnan(shares), -np.inf, shares), axis=0), np.nan)

    def shown(self, metric: str) -> tuple[Array, float | None, str]:
        """A metric as people read it.

        Returns:
            Values of the completed runs, shape (N,), NaN elsewhere; the limit, None if not judged; the unit:
            mm, % of body weight, N m s.
        """
        value = np.where(self.measured, self.numbers(METRIC + metric), np.nan)
        limit = self.limits.get(metric)
        unit = self.unit(METRIC + metric)
        if unit == "N":
            share = limit.limit * 100.0 if limit is not None and limit.unit == BODY_WEIGHT else None
            return 100.0 * value / self.weight, share, "% of body weight"
        scale, unit = display_unit(unit, math.nan)
        return scale * value, None if limit is None else scale * limit.limit, unit


def read_sweep(path: Path | str) -> SweepTable:
    """Read a sweep.

    Args:
        path: a sweep's folder, or its table.

    Raises:
        InputError: there is none, it is not readable, or it lacks a column that every sweep has.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"there is no {path}; give the folder of a sweep, or its {RESULTS}.")
    if store.is_sweep(path):
        results = store.load_results(path)
        return SweepTable(results.table, results.metadata, path, str(path))
    file = path / RESULTS if path.is_dir() else path
    if not file.exists():
        raise InputError(f"{path} holds no sweep; give the --out folder of one, or its {RESULTS}.")
    try:
        table = pq.read_table(file)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{file} is no Parquet file that can be read ({reason}).") from error
    missing = [name for name in ("run", "key", "outcome", "verdict") if name not in table.column_names]
    if missing:
        raise InputError(f"{file} has no column {missing[0]!r}, so it is no table of a sweep.")
    metadata: Any = {}
    try:
        metadata = json.loads((table.schema.metadata or {}).get(TABLE_METADATA, b"{}"))
    except json.JSONDecodeError as error:
        raise InputError(f"{file} has metadata that are no JSON ({error}).") from error
    if not metadata:  # other programs lose them when they write a table again
        beside = store.is_sweep(file.parent)
        metadata = dict(store.load_results(file.parent).metadata) if beside else {"profile": DEFAULT.name}
    return SweepTable(table.sort_by("run"), _mapping(metadata), path if path.is_dir() else None, str(path))


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _units_of_parameters() -> dict[str, str]:
    units = {}
    for section, field in RunParameters.model_fields.items():
        for key, item in field.annotation.model_fields.items():  # type: ignore[union-attr]
            extra = item.json_schema_extra
            units[f"{section}.{key}"] = str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"
    return units


_UNITS: Mapping[str, str] = _units_of_parameters()

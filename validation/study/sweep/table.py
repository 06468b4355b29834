"""A sweep's table: state of every run, varied parameters, metrics with their limits, worst runs, verdict.

Everything is read from the saved table, so that a report or a comparison can be made again later. While a
sweep is not finished, its table is made from the rows that are there.
"""

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY, RunParameters
from validation.judge.metrics import METRICS, display_unit, metric_label
from validation.judge.profiles import Tolerance
from validation.judge.profiles import profile as find_profile
from validation.store.environment import code_hash, describe_environment, parameter_values, run_key
from validation.study.row_file import ROWS, Row, read_rows
from validation.study.sweep.design import SweepDefinition, dump_sweep, load_sweep, toml_text
from validation.study.sweep.schema import columns, schema
from validation.table import Table, Tabled

DEFINITION = "sweep.toml"
RESULTS = "results.parquet"
SUMMARY = "sweep.json"
REPORT = "report.html"
RECORDINGS = "recordings"
TABLE_METADATA = b"ampm_sweep"
"""Schema metadata of a table: JSON, see :func:`table_metadata`."""
METRIC = "metric_"
_BATCH = 1000  # rows that are turned into columns at a time


class State(StrEnum):
    """How a run of a sweep ended, its verdict included; in the order in which states are shown."""

    PASS = "pass"
    OUT_OF_TOLERANCE = "out_of_tolerance"
    NOT_MEASURED = "not_measured"
    FELL = "fell"
    DIVERGED = "diverged"
    INFEASIBLE = "infeasible"
    REFUSED = "refused"
    CRASHED = "crashed"
    TIMED_OUT = "timed_out"

    @classmethod
    def of(cls, outcome: str, verdict: str | None) -> Self:
        """The state of a row.

        Raises:
            ValueError: there is no such outcome.
        """
        if outcome == "completed":
            return {"pass": cls.PASS, "fail": cls.OUT_OF_TOLERANCE}.get(verdict or "", cls.NOT_MEASURED)
        return cls(outcome)

    @property
    def label(self) -> str:
        """For people."""
        return self.value.replace("_", " ")

    @property
    def walked(self) -> bool:
        """Whether the body moved, so that a failure is the gait's or the controller's."""
        return self not in (State.REFUSED, *BROKEN)


STATES: tuple[State, ...] = tuple(State)
LOST = (State.FELL, State.DIVERGED, State.INFEASIBLE, State.NOT_MEASURED)
"""Walks without a verdict on their metrics."""
BROKEN = (State.CRASHED, State.TIMED_OUT)
"""No result about the gait."""


@dataclass(frozen=True)
class SweepTable(Tabled):
    """One sweep, finished or not."""

    table: pa.Table  # one row per run, sorted by `run`; `schema` has the columns
    metadata: Mapping[str, Any]  # of the table, see `table_metadata`
    directory: Path | None  # the sweep's folder, None if only a file was given
    source: str  # the user's name for it, for messages

    def __len__(self) -> int:
        return self.table.num_rows

    def __contains__(self, name: str) -> bool:
        return name in self.table.column_names

    @property
    def name(self) -> str:
        """Name of the sweep."""
        return str(self.metadata["name"])

    @property
    def profile(self) -> str:
        """Name of the tolerance profile."""
        return str(self.metadata["profile"])

    @property
    def planned(self) -> int:
        """Number of runs of the sweep; more than rows while it is not finished."""
        return max(len(self), int(self.metadata["runs"]))

    # -------------------------------------------------------------------------- states

    @cached_property
    def states(self) -> NDArray[np.int64]:
        """State of every run, shape (N,), as index into :data:`STATES`."""
        pairs = zip(self.table["outcome"].to_pylist(), self.table["verdict"].to_pylist(), strict=True)
        try:
            return np.array([STATES.index(State.of(*pair)) for pair in pairs], dtype=np.int64)
        except ValueError as error:
            raise InputError(
                f"{self.source}: an outcome is unknown ({error}); use the version that wrote it."
            ) from None

    def state(self, row: int) -> State:
        """State of one run."""
        return STATES[self.states[row]]

    def is_state(self, *states: State) -> NDArray[np.bool_]:
        """Rows in one of these states, shape (N,)."""
        return np.isin(self.states, [STATES.index(state) for state in states])

    @property
    def counts(self) -> Mapping[State, int]:
        """Runs in every state, zeros included."""
        counted = np.bincount(self.states, minlength=len(STATES))
        return dict(zip(STATES, counted.tolist(), strict=True))

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Runs whose metrics are those of a whole walk, shape (N,)."""
        return self.is_state(State.PASS, State.OUT_OF_TOLERANCE)

    @cached_property
    def worst(self) -> list[int]:
        """Rows that walked, the worst first.

        Walks without a verdict on their metrics come first, the earliest end before the later; then those
        that used most of a tolerance. Ties go to the lower row.
        """
        lost = np.flatnonzero(self.is_state(*LOST))
        time = np.nan_to_num(self.numbers("outcome_time")[lost], nan=np.inf)
        measured = np.flatnonzero(self.measured)
        used = np.nan_to_num(self.worst_used[measured], nan=-np.inf)
        return [
            *lost[np.argsort(time, kind="stable")].tolist(),
            *measured[np.argsort(-used, kind="stable")].tolist(),
        ]

    # -------------------------------------------------------------------------- columns

    def numbers(self, name: str) -> Array:
        """A column of numbers, shape (N,); NaN where there is none, or no such column."""
        if name not in self:
            return np.full(len(self), np.nan)
        return self.table.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False)

    def words(self, name: str) -> list[str]:
        """A column as text; empty where there is none."""
        if name not in self:
            return [""] * len(self)
        return ["" if value is None else str(value) for value in self.table.column(name).to_pylist()]

    def values(self, name: str) -> NDArray[Any]:
        """A column as texts or as numbers, shape (N,)."""
        is_text = pa.types.is_string(self.table.schema.field(name).type)
        return np.array(self.words(name)) if is_text else self.numbers(name)

    def unit(self, name: str) -> str:
        """Unit of a column, ``1`` if it has none."""
        return self.metadata["columns"].get(name, {}).get("unit") or "1"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys of all parameters, in the order of the table."""
        sections = tuple(f"{name}." for name in RunParameters.model_fields)
        return tuple(name for name in self.table.column_names if name.startswith(sections))

    @cached_property
    def varied(self) -> tuple[str, ...]:
        """Parameters with more than one value in this sweep; first those that the definition varies."""
        found = [name for name in self.parameters if len(self.table.column(name).unique()) > 1]
        first = [name for name in self.metadata["varied"] if name in found]
        return tuple(dict.fromkeys((*first, *found)))

    # -------------------------------------------------------------------------- metrics and limits

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Metrics with a column, judged ones first, in the profile's order."""
        present = [name.removeprefix(METRIC) for name in self.table.column_names if name.startswith(METRIC)]
        return tuple(dict.fromkeys((*self.judged, *present)))

    @property
    def judged(self) -> tuple[str, ...]:
        """Metrics with a column and a tolerance, in the profile's order."""
        return tuple(name for name in self.limits if METRIC + name in self)

    @cached_property
    def limits(self) -> Mapping[str, Tolerance]:
        """Tolerances by metric, in the profile's order."""
        return {name: Tolerance(name, **entry) for name, entry in self.metadata["tolerances"].items()}

    @cached_property
    def weight(self) -> Array:
        """Body weight of every run, shape (N,) [N]."""
        return self.numbers("body.mass") * GRAVITY

    def label(self, metric: str) -> str:
        """Readable name of a metric, as it was when the sweep walked."""
        return str(self.metadata.get("labels", {}).get(metric) or metric_label(metric))

    def limit_values(self, metric: str) -> Array:
        """A metric's limit in the unit of its column, shape (N,); NaN if it is not judged."""
        if metric not in self.limits:
            return np.full(len(self), np.nan)
        scales = {"body_weight": self.weight, "foot_length": self.numbers("foot_length")}
        return self.limits[metric].limit_for(scales) + np.zeros(len(self))

    def used(self, metric: str) -> Array:
        """Share of its tolerance that a metric used in every *completed* run, shape (N,); NaN elsewhere.

        A tolerance of zero is used by 0 if it is met, and by infinity if not.
        """
        value, limit = self.numbers(METRIC + metric), self.limit_values(metric)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(limit > 0.0, value / limit, np.where(value > 0.0, np.inf, 0.0))
        return np.where(self.measured & np.isfinite(value) & np.isfinite(limit), share, np.nan)

    @cached_property
    def worst_used(self) -> Array:
        """Largest share of a tolerance that any judged metric of a run used, shape (N,); NaN unmeasured."""
        return np.fmax.reduce([np.full(len(self), np.nan), *map(self.used, self.judged)])

    def shown(self, metric: str) -> tuple[Array, str]:
        """A metric of the completed runs in display units, shape (N,), NaN elsewhere; the unit."""
        scale, unit = display_unit(self.unit(METRIC + metric), self.weight)
        return scale * np.where(self.measured, self.numbers(METRIC + metric), np.nan), unit

    def shown_limits(self, metric: str) -> tuple[Array, str]:
        """Limits of a metric in display units, by run, shape (N,), NaN where it is not judged; the unit."""
        scale, unit = display_unit(self.unit(METRIC + metric), self.weight)
        return scale * self.limit_values(metric), unit

    # -------------------------------------------------------------------------- the whole sweep

    def tables(self) -> list[Table]:
        """How many runs ended how."""
        return [self.result()]

    def result(self) -> Table:
        """How many runs ended how, with an example of every reason why one did not walk."""
        names, causes, rows = self.words("name"), self.words("cause"), []
        for state, count in self.counts.items():
            if count and state.walked:
                rows.append((state.label, f"{count:,}", ""))
            for reason, (number, row) in self._reasons(state).items():
                example = f"run {names[row]}: {causes[row]}"
                rows.append((f"{state.label}: {reason.replace('_', ' ')}", f"{number:,}", example))
        notes = []
        summary = self.summary()
        if summary["failed"]:
            words = "; ".join(f"{self.label(name)} ({n:,})" for name, n in summary["failed"].items())
            notes.append(f"out of tolerance: {words}")
        if summary["unfinished"]:
            notes.append(f"runs without a result: {summary['unfinished']:,}; --resume walks them again")
        return Table(f"sweep {self.name}", ("state", ">runs", "for example"), rows, notes)

    def _reasons(self, state: State) -> dict[str, tuple[int, int]]:
        """Why runs in this state did not walk: how many, and the first of them; the most frequent first."""
        if state.walked:
            return {}
        reasons = np.array(self.words("reason"))
        rows = np.flatnonzero(self.is_state(state))
        counted = Counter(reasons[rows].tolist()).most_common()
        return {reason: (count, int(rows[reasons[rows] == reason][0])) for reason, count in counted}

    def summary(self) -> dict[str, Any]:
        """Contents of ``sweep.json``."""
        failed = Counter(name for words in self.words("failed") for name in words.split(",") if name)
        broken = sum(self.counts[state] for state in BROKEN)
        return {
            "name": self.name,
            "profile": self.profile,
            "runs": self.planned,
            "states": {state.value: count for state, count in self.counts.items() if count},
            "refusals": {reason: count for reason, (count, _) in self._reasons(State.REFUSED).items()},
            "failed": dict(failed.most_common()),
            "unfinished": broken + self.planned - len(self),
            "environment": self.metadata["environment"],
            "computing_time": {"value": float(np.nansum(self.numbers("timing_total"))), "unit": "s"},
        }


# ------------------------------------------------------------------------------------------ from rows


def key_of(definition: SweepDefinition, run: int) -> str:
    """Key of a run among the rows of a folder: its number, and a hash of what the definition says of it."""
    shared = {"profile": definition.profile, "tune": definition.tune}
    return f"{definition.name_of(run)}-{run_key({**_values(definition, run), **shared})}"


def _values(definition: SweepDefinition, run: int) -> dict[str, Any]:
    """Every parameter of a run, also of one with a value beyond its bounds."""
    return parameter_values(definition.shared[definition.gait_of(run)]) | definition.varied(run)


def build_table(definition: SweepDefinition, rows: Iterable[Row]) -> pa.Table:
    """Table of a sweep, sorted by run, from the rows of the engine; a batch of them at a time in memory."""
    names, source, batches = schema(definition.options), iter(rows), []
    while batch := list(islice(source, _BATCH)):
        found = [_table_row(definition, row) for row in batch]
        for key in definition.options:
            if pa.types.is_string(names.field(key).type):
                for row in found:
                    row[key] = toml_text(row[key])
        batches.append(pa.RecordBatch.from_pylist(found, schema=names))
    table = pa.Table.from_batches(batches, names).sort_by("run").combine_chunks()
    return table.replace_schema_metadata({TABLE_METADATA: json.dumps(table_metadata(definition)).encode()})


def _table_row(definition: SweepDefinition, row: Row) -> dict[str, Any]:
    """A row of the engine with the parameters of its run."""
    name = row["key"].partition("-")[0]
    run = int(name)
    values, gait = _values(definition, run), definition.gaits[definition.gait_of(run)]
    return {**values, **row, "run": run, "name": name, "gait": gait, "key": run_key(values)}


def table_metadata(definition: SweepDefinition) -> dict[str, Any]:
    """Description of a table, JSON-ready.

    ``definition`` (TOML), ``name``, ``runs``, ``varied`` (keys), ``profile``, ``command`` (that walks a run,
    if it is told the varied keys, and of several gaits the run's in the place of ``GAIT``),
    ``tolerances`` (metric to ``limit``, ``unit`` and ``reason``; forces in body weights), ``labels`` (metric
    to readable name), ``columns`` (name to ``unit`` and ``words``) and ``environment`` (versions, platform,
    and the hash of the code).
    """
    profile = find_profile(definition.profile)
    return {
        "definition": dump_sweep(definition),
        "name": definition.name,
        "runs": len(definition),
        "varied": list(definition.keys),
        "profile": profile.name,
        "command": _command(definition),
        "tolerances": {
            item.metric: {"limit": item.limit, "unit": item.unit, "reason": item.reason}
            for item in profile.tolerances
        },
        "labels": {item.name: item.label for item in METRICS.values()},
        "columns": {
            item.name: {"unit": item.unit, "words": item.words} for item in columns(definition.options)
        },
        "environment": {**describe_environment(), "code": code_hash()},
    }


def _command(definition: SweepDefinition) -> str:
    """Command that walks a run, but for the varied keys; ``GAIT`` is its gait if there are several."""
    words = ["ampm", "validate", "--profile", definition.profile]
    if definition.steps is not None:
        words[2:2] = ["--steps", str(definition.steps)]
    if len(definition.gaits) > 1:
        words.insert(2, "GAIT")
    elif definition.gaits[0] != Path(definition.base[0].body.source).stem:  # else it is the body's own gait
        words.insert(2, definition.gaits[0])
    for key, value in definition.set.items():
        words += ["--set", f"{key}={toml_text(value)}"]
    return shlex.join(words if definition.tune else [*words, "--as-is"])


# -------------------------------------------------------------------------------------------- reading


def is_sweep(folder: Path) -> bool:
    """Whether a folder is one of a sweep."""
    return (folder / DEFINITION).is_file()


def read_sweep(path: Path | str) -> SweepTable:
    """Read a sweep, finished or not.

    Args:
        path: a sweep's folder, or its table.

    Raises:
        InputError: there is none, it has no row yet, or it is not the table of a sweep.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"there is no {path}; give the folder of a sweep, or its {RESULTS}.")
    if not path.is_dir():
        return wrap_table(_read_table(path), None, str(path))
    if not is_sweep(path):
        raise InputError(f"{path} holds no sweep; give the --out folder of one, or its {RESULTS}.")
    if (path / RESULTS).is_file():
        return wrap_table(_read_table(path / RESULTS), path)
    definition = load_sweep(path / DEFINITION, finished=True)
    rows = {row["key"]: row for row in (read_rows(path) if (path / ROWS).is_file() else ())}
    keys = (key_of(definition, run) for run in range(len(definition)))
    table = build_table(definition, (rows[key] for key in keys if key in rows))
    if not table.num_rows:
        raise InputError(f"the sweep in {path} has no result yet; wait for its first rows.")
    return wrap_table(table, path)


def _read_table(path: Path) -> pa.Table:
    """A sweep's Parquet table.

    Raises:
        InputError: it cannot be read, or is not a table of a sweep.
    """
    try:
        table = pq.read_table(path, use_threads=False)
    except (pa.ArrowException, OSError) as error:
        line = str(error).partition("\n")[0]
        raise InputError(f"{path} is not a Parquet file that can be read ({line}).") from error
    if TABLE_METADATA not in (table.schema.metadata or {}):
        raise InputError(f"{path} is not a table of a sweep: it has no metadata {TABLE_METADATA.decode()!r}.")
    return table


def wrap_table(table: pa.Table, directory: Path | None, source: str = "") -> SweepTable:
    """A sweep from its table and the table's metadata."""
    metadata = json.loads(table.schema.metadata[TABLE_METADATA])
    return SweepTable(table, metadata, directory, source or str(directory))

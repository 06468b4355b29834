"""A sweep's table: state of every run, varied parameters, metrics with their limits, worst runs, verdict.

Everything is read from the saved table, so that a report or a comparison can be made again later. While a
sweep is not finished, its table is made from the rows that are there.
"""

import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
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
from validation.judge.metrics import METRICS, display_unit
from validation.judge.profiles import Tolerance
from validation.store.environment import code_hash, describe_environment, run_key
from validation.study.row_file import ROWS, Row, read_rows
from validation.study.sweep.design import SweepDefinition, dump_sweep, load_sweep
from validation.study.sweep.schema import schema
from validation.table import Table, Tabled
from validation.trial.users import SUFFIXES

TABLE_METADATA = b"ampm_sweep_2"
"""Schema metadata of a table, with the number of its format: JSON, see :func:`table_metadata`."""
METRIC = "metric_"
_BATCH = 1000  # rows that are turned into columns at a time


class SweepFile(StrEnum):
    """Files in a sweep's folder, beside its rows."""

    DEFINITION = "sweep.toml"
    RESULTS = "results.parquet"
    SUMMARY = "sweep.json"
    REPORT = "report.html"
    RECORDINGS = "recordings"  # folder of the runs that are kept


class RunState(StrEnum):
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
        """The state of a row; raises ValueError if there is no such outcome."""
        if outcome == "completed":
            return {"pass": cls.PASS, "fail": cls.OUT_OF_TOLERANCE}.get(verdict or "", cls.NOT_MEASURED)
        return cls(outcome)

    @property
    def label(self) -> str:
        """For people."""
        return self.value.replace("_", " ")


LOST = (RunState.FELL, RunState.DIVERGED, RunState.INFEASIBLE, RunState.NOT_MEASURED)
"""Walks without a verdict on their metrics."""
BROKEN = (RunState.CRASHED, RunState.TIMED_OUT)
"""No result about the gait."""


@dataclass(frozen=True)
class SweepTable(Tabled):
    """One sweep, finished or not."""

    table: pa.Table  # one row per run, sorted by `run`; `schema` has the columns
    directory: Path | None  # the sweep's folder, None if only a file was given
    source: str  # the user's name for it, for messages

    def __len__(self) -> int:
        return self.table.num_rows

    def __contains__(self, name: str) -> bool:
        return name in self.table.column_names

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """Metadata of the table, see :func:`table_metadata`."""
        return json.loads(self.table.schema.metadata[TABLE_METADATA])

    @property
    def name(self) -> str:
        """Name of the sweep."""
        return str(self.metadata["name"])

    @property
    def planned(self) -> int:
        """Number of runs of the sweep; more than rows while it is not finished."""
        return max(len(self), int(self.metadata["runs"]))

    @cached_property
    def states(self) -> tuple[RunState, ...]:
        """RunState of every run."""
        pairs = zip(self.table["outcome"].to_pylist(), self.table["verdict"].to_pylist(), strict=True)
        try:
            return tuple(RunState.of(*pair) for pair in pairs)
        except ValueError as error:
            raise InputError(
                f"{self.source}: an outcome is unknown ({error}); use the version that wrote it."
            ) from None

    def is_state(self, *states: RunState) -> NDArray[np.bool_]:
        """Rows in one of these states, shape (N,)."""
        return np.array([state in states for state in self.states], dtype=bool)

    @cached_property
    def counts(self) -> Counter[RunState]:
        """Runs in every state."""
        return Counter(self.states)

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Runs whose metrics are those of a whole walk, shape (N,)."""
        return self.is_state(RunState.PASS, RunState.OUT_OF_TOLERANCE)

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

    def numbers(self, name: str) -> Array:
        """A column of numbers, shape (N,); NaN where there is none."""
        return self.table.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False)

    def words(self, name: str) -> list[str]:
        """A column as text; empty where there is none."""
        return ["" if value is None else str(value) for value in self.table.column(name).to_pylist()]

    def values(self, name: str) -> NDArray[Any]:
        """A column as texts or as numbers, shape (N,)."""
        is_text = pa.types.is_string(self.table.schema.field(name).type)
        return np.array(self.words(name)) if is_text else self.numbers(name)

    def unit(self, name: str) -> str:
        """Unit of a column, ``1`` if it has none."""
        return (self.table.field(name).metadata or {}).get(b"unit", b"").decode() or "1"

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

    @property
    def judged(self) -> tuple[str, ...]:
        """Metrics with a column and a tolerance, in the profile's order."""
        return tuple(name for name in self.limits if METRIC + name in self)

    @cached_property
    def limits(self) -> Mapping[str, Tolerance]:
        """Tolerances by metric, in the profile's order."""
        return {name: Tolerance(**entry) for name, entry in self.metadata["tolerances"].items()}

    def label(self, metric: str) -> str:
        """Readable name of a metric, as it was when the sweep walked."""
        return str(self.metadata["labels"][metric])

    def limit_values(self, metric: str) -> Array:
        """A metric's limit in the unit of its column, shape (N,); NaN if it is not judged."""
        if metric not in self.limits:
            return np.full(len(self), np.nan)
        weight = self.numbers("body.mass") * GRAVITY
        scales = {"body_weight": weight, "foot_length": self.numbers("foot_length")}
        return self.limits[metric].limit_for(scales) + np.zeros(len(self))

    def used(self, metric: str) -> Array:
        """Share of its tolerance that a metric used in every *completed* run, shape (N,); NaN elsewhere.

        A tolerance of zero is used by 0 if it is met, and by infinity if not; so is any by an infinite value.
        """
        value, limit = self.numbers(METRIC + metric), self.limit_values(metric)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(limit > 0.0, value / limit, np.where(value > 0.0, np.inf, 0.0))
        return np.where(self.measured & ~np.isnan(value) & np.isfinite(limit), share, np.nan)

    @cached_property
    def worst_used(self) -> Array:
        """Largest share of a tolerance that any judged metric of a run used, shape (N,); NaN unmeasured."""
        return np.fmax.reduce([np.full(len(self), np.nan), *map(self.used, self.judged)])

    def shown(self, metric: str) -> tuple[Array, Array, str]:
        """A metric of the completed runs in display units, and its limits, shape (N,) each; the unit.

        NaN where a run did not complete, or is not judged.
        """
        scale, unit = display_unit(self.unit(METRIC + metric), self.numbers("body.mass") * GRAVITY)
        values = np.where(self.measured, self.numbers(METRIC + metric), np.nan)
        return scale * values, scale * self.limit_values(metric), unit

    def tables(self) -> list[Table]:
        """How many runs ended how, with an example of each."""
        names, causes, rows = self.words("name"), self.words("cause"), []
        for (state, reason), found in self.endings.items():
            label = ": ".join([state.label, reason.replace("_", " ")]).removesuffix(": ")
            example = f"run {names[found[0]]}: {causes[found[0]]}".removesuffix(": ")
            rows.append((label, f"{len(found):,}", example))
        notes, summary = [], self.as_dict()
        if summary["refusals"] and not tomllib.loads(self.metadata["definition"])["sweep"]["tune"]:
            notes.append("open values of a gait are kept; tune = true under [sweep] finds others")
        if summary["failed"]:
            words = "; ".join(f"{self.label(name)} ({n:,})" for name, n in summary["failed"].items())
            notes.append(f"out of tolerance: {words}")
        if summary["unfinished"] and self.directory:
            notes.append(f"runs without a result: {summary['unfinished']:,}; --resume walks them again")
        return [Table(f"sweep {self.name}", ("state", ">runs", "for example"), rows, notes)]

    @cached_property
    def endings(self) -> dict[tuple[RunState, str], list[int]]:
        """RunState, and reason of runs that did not walk, to rows; in each state the most frequent first."""
        found: dict[tuple[RunState, str], list[int]] = {}
        for row, (state, reason) in enumerate(zip(self.states, self.words("reason"), strict=True)):
            found.setdefault((state, reason), []).append(row)
        order = list(RunState)
        return dict(sorted(found.items(), key=lambda item: (order.index(item[0][0]), -len(item[1]))))

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``sweep.json``."""
        failed = Counter(name for words in self.words("failed") for name in words.split(",") if name)
        broken = sum(self.counts[state] for state in BROKEN)
        refused = {why: len(rows) for (end, why), rows in self.endings.items() if end is RunState.REFUSED}
        return {
            "name": self.name,
            "profile": self.metadata["profile"],
            "runs": self.planned,
            "states": {state.value: self.counts[state] for state in RunState if state in self.counts},
            "refusals": refused,
            "failed": dict(failed.most_common()),
            "unfinished": broken + self.planned - len(self),
            "environment": self.metadata["environment"],
            "computing_time": {"value": float(np.nansum(self.numbers("timing_total"))), "unit": "s"},
        }


def short_names(names: Sequence[str]) -> list[str]:
    """Classes of ``module:Class``, files without suffix; the names as they are if two would be equal."""
    short = {name: name.rpartition(":")[2] for name in names}
    short |= {name: Path(name).stem for name in names if Path(name).suffix in (".toml", *SUFFIXES)}
    unique = len(set(short.values())) == len(short)
    return [short[name] if unique else name for name in names]


def key_of(definition: SweepDefinition, run: int) -> str:
    """Key of a run among the rows of a folder: its number, and a hash of what the definition says of it."""
    shared = {"profile": definition.judged_by.name, "tune": definition.tune}
    return f"{definition.name_of(run)}-{run_key({**definition.values_of(run), **shared})}"


def build_table(definition: SweepDefinition, rows: Iterable[Row]) -> pa.Table:
    """Table of a sweep, sorted by run, from the rows of the engine; a batch of them at a time in memory."""
    names, source, batches = schema(definition.options), iter(rows), []
    texts = [key for key in definition.options if pa.types.is_string(names.field(key).type)]
    while batch := [_table_row(definition, row, texts) for row in islice(source, _BATCH)]:
        batches.append(pa.RecordBatch.from_pylist(batch, schema=names))
    table = pa.Table.from_batches(batches, names).sort_by("run").combine_chunks()
    return table.replace_schema_metadata({TABLE_METADATA: json.dumps(table_metadata(definition)).encode()})


def _table_row(definition: SweepDefinition, row: Row, texts: Sequence[str]) -> dict[str, Any]:
    """A row of the engine with the parameters of its run; values of some options become texts."""
    name = row["key"].partition("-")[0]
    run = int(name)
    values, gait = definition.values_of(run), definition.gaits[definition.gait_of(run)]
    found = {**values, **row, "run": run, "name": name, "gait": gait, "key": run_key(values)}
    found |= {key: float(value) for key, value in row.items() if value in ("inf", "-inf")}
    for key in texts:
        value = found[key]
        found[key] = str(value).lower() if isinstance(value, bool) else str(value)  # as `--set` takes it
    return found


def table_metadata(definition: SweepDefinition) -> dict[str, Any]:
    """Description of a table, JSON-ready.

    ``definition`` (TOML), ``name``, ``runs``, ``varied`` (keys), ``profile``, ``tolerances`` (metric to
    ``limit``, ``unit`` and ``reason``; forces in body weights), ``labels`` (metric to readable name) and
    ``environment`` (versions, platform, hash of the code).
    """
    profile = definition.judged_by
    return {
        "definition": dump_sweep(definition),
        "name": definition.name,
        "runs": len(definition),
        "varied": list(definition.keys),
        "profile": profile.name,
        "tolerances": {name: asdict(item) for name, item in profile.tolerances.items()},
        "labels": {item.name: item.label for item in METRICS.values()},
        "environment": {**describe_environment(), "code": code_hash()},
    }


def is_sweep(folder: Path) -> bool:
    """Whether a folder is one of a sweep."""
    return (folder / SweepFile.DEFINITION).is_file()


def read_sweep(folder: Path | str) -> SweepTable:
    """Read a sweep, finished or not, from its folder.

    Raises :class:`InputError` if there is none, it has no row yet, or its table is damaged.
    """
    folder = Path(folder)
    file = folder / SweepFile.RESULTS
    if not is_sweep(folder):
        lacks = "holds no sweep" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {lacks}; give the --out folder of a sweep.")
    if not file.is_file():
        definition = load_sweep(folder / SweepFile.DEFINITION)
        rows = {row["key"]: row for row in (read_rows(folder) if (folder / ROWS).is_file() else ())}
        keys = (key_of(definition, run) for run in range(len(definition)))
        table = build_table(definition, (rows[key] for key in keys if key in rows))
        if not table.num_rows:
            raise InputError(
                f"the sweep in {folder} has no result yet; wait for one, or go on with --resume."
            )
        return SweepTable(table, folder, str(folder))
    try:
        table = pq.read_table(file, use_threads=False)
    except (pa.ArrowException, OSError) as error:
        line = str(error).partition("\n")[0]
        raise InputError(f"{file} cannot be read ({line}); remove it, rows.jsonl has its rows.") from error
    if TABLE_METADATA not in (table.schema.metadata or {}):
        raise InputError(
            f"{file} is not a table of a sweep of this version: it has no metadata "
            f"{TABLE_METADATA.decode()!r}; remove it, rows.jsonl has its rows."
        )
    for column in schema():  # an earlier version may not have had it
        if column.name not in table.column_names:
            table = table.append_column(column, pa.nulls(table.num_rows, column.type))
    return SweepTable(table, folder, str(folder))

"""Columns of a sweep's table: name, type, unit and meaning of each, in the order of the table.

One row per run. What is undefined is null, never NaN. Every column but those that begin with ``timing_`` or
``environment_`` is a function of the definition alone: the same bits whatever the workers, and whatever
happened on the way.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import pyarrow as pa

from ampm.parameters import RunParameters, keys
from ampm.planner.centroidal import PlanConstants
from validation.judge.metrics import METRICS
from validation.measure.instruments.names import INSTRUMENT_COLUMNS
from validation.store.environment import DISTRIBUTIONS

TABLE_METADATA = b"ampm_sweep"
"""Schema metadata of a table: JSON with the definition, the tolerances, and these columns in words."""

OUTCOMES = (
    "completed",
    "fell",
    "diverged",
    "infeasible",
    "refused",
    "crashed",
    "timed_out",
    "interrupted",
)
"""How a run can end. The first four are ends of a walk; the others never walked, or not to an end."""
WALKED = OUTCOMES[:4]

NOT_REPRODUCIBLE = ("timing_", "environment_")
"""Beginnings of the columns in which equal runs may differ."""

Kind = Literal["real", "whole", "text", "flag"]
_TYPES: Mapping[Kind, pa.DataType] = {
    "real": pa.float64(),
    "whole": pa.int64(),
    "text": pa.string(),
    "flag": pa.bool_(),
}
_KEY_DIGITS = 20


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes:
        name: as in the file.
        kind: real (float64), whole (int64), text (UTF-8), flag (bool).
        unit: SI unit, ``1`` for a plain number, empty for words.
        words: meaning.
    """

    name: str
    kind: Kind
    unit: str
    words: str

    @property
    def reproducible(self) -> bool:
        """Whether equal runs have equal values here, to the bit."""
        return not self.name.startswith(NOT_REPRODUCIBLE)


def _identity() -> list[Column]:
    return [
        Column("run", "whole", "1", "number of the run in the sweep, from 0"),
        Column("name", "text", "", "the same, padded with zeros: name of the run's folder"),
        Column(
            "key",
            "text",
            "",
            "hash of all parameters and of the profile: the same run in another sweep has the same key",
        ),
    ]


def _parameters() -> list[Column]:
    columns = []
    kinds: dict[type, Kind] = {float: "real", int: "whole", bool: "flag"}
    default = RunParameters()
    for key in keys():
        section, _, leaf = key.partition(".")
        model = getattr(default, section)
        field = type(model).model_fields[leaf]
        extra = field.json_schema_extra
        kind = kinds.get(type(getattr(model, leaf)), "text")
        unit = str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"
        columns.append(Column(key, kind, "" if kind == "text" else unit, field.description or ""))
    return columns


_PLAN = (
    *((f.name, f.metadata["unit"], f.metadata["meaning"]) for f in fields(PlanConstants)),
    ("step_duration", "s", "duration of a step"),
    ("duration", "s", "duration of the planned walk"),
)
_MOTION = (
    ("residual", "1", "largest difference of the motion's mirrored return [m, rad, m/s, rad/s]"),
    ("knee_minimum", "rad", "smallest knee flexion of the planned motion"),
    ("joint_limit_margin", "rad", "smallest distance of the planned motion from a joint's limit"),
    ("trunk_pitch", "rad", "mean pitch of the trunk in the planned motion"),
)
"""Columns ``plan_motion_*``."""


def _plan() -> list[Column]:
    columns = [Column(f"plan_{name}", "real", unit, words) for name, unit, words in _PLAN]
    columns.append(
        Column(
            "plan_zmp_margin",
            "real",
            "m",
            "smallest distance of the planned ZMP from the edge of the planned support; negative outside",
        )
    )
    return columns + [Column(f"plan_motion_{name}", "real", unit, words) for name, unit, words in _MOTION]


def _outcome() -> list[Column]:
    return [
        Column("outcome", "text", "", ", ".join(OUTCOMES)),
        Column("reason", "text", "", "of a refusal, its short name; of a crash, the error's type; else null"),
        Column("cause", "text", "", "one sentence on why the run did not complete, else null"),
        Column("verdict", "text", "", "pass, fail or not_measured; null for a run that did not walk"),
        Column("failed", "text", "", "metrics out of tolerance, separated by commas; empty if none is"),
        Column("steps_completed", "whole", "1", "whole steps walked; null for a run that did not walk"),
        Column("outcome_time", "real", "s", "simulated time at the end of the walk"),
    ]


def _metrics() -> list[Column]:
    """Every registered metric, and the joints that come closest to their limits."""
    names = {
        "margin_torque": ("margin_torque_joint", "that motor's joint"),
        "margin_joint": ("margin_joint_name", "that joint"),
    }
    columns = []
    for metric in METRICS.values():
        columns.append(Column(metric.column, "real", metric.unit, metric.meaning))
        if metric.name in names:
            name, words = names[metric.name]
            columns.append(Column(name, "text", "", words))
    return columns


def _solver() -> list[Column]:
    return [
        Column("qp_ticks", "whole", "1", "control ticks"),
        Column("qp_limited", "whole", "1", "control ticks whose QP needed torque or joint limits"),
        Column("qp_unsolved", "whole", "1", "control ticks whose QP stayed unsolved"),
        Column("qp_iterations_maximum", "whole", "1", "most iterations of a control tick's QP"),
    ]


def _recording() -> list[Column]:
    return [
        Column(
            "recording",
            "text",
            "",
            "folder of the run, relative to the sweep's; null if the run was not kept",
        ),
    ]


def _instrument() -> list[Column]:
    """Null without ``sweep.instrument``."""
    return [Column(name, "real", unit, words) for name, (unit, words) in INSTRUMENT_COLUMNS.items()]


def _timings() -> list[Column]:
    return [
        Column("timing_planning", "real", "s", "wall clock of body, plan and whole-body motion"),
        Column("timing_motion", "real", "s", "of which the whole-body motion"),
        Column("timing_simulation", "real", "s", "wall clock of the closed loop"),
        Column("timing_measurement", "real", "s", "wall clock of weighing, measurement, comparison, verdict"),
        Column("timing_recording", "real", "s", "wall clock of writing the run's folder"),
        Column("timing_total", "real", "s", "wall clock of the whole run on its worker"),
        Column("timing_cpu_planning", "real", "s", "processor time of body, plan and whole-body motion"),
        Column("timing_cpu_walk", "real", "s", "processor time of closed loop and measurement"),
        Column("timing_cpu_total", "real", "s", "processor time of the whole run on its worker"),
        Column("timing_real_time_factor", "real", "1", "simulated time over wall clock of the closed loop"),
    ]


def version_column(distribution: str) -> str:
    """Column of a distribution's version."""
    return f"environment_version_{distribution.replace('-', '_')}"


def _environment() -> list[Column]:
    return [
        Column("environment_time", "text", "", "when the run ended (UTC, ISO 8601)"),
        Column("environment_worker", "text", "", "worker that walked it; null if none had to"),
        Column("environment_attempts", "whole", "1", "times it was begun; more than 1 if workers were lost"),
        Column("environment_memory_peak", "real", "MB", "largest resident memory of the worker so far"),
        Column("environment_revision", "text", "", "git commit of the code; null outside a checkout"),
        Column("environment_modified", "flag", "", "whether tracked files differed from that commit"),
        Column("environment_code", "text", "", "hash of the sources and versions that results can depend on"),
        Column("environment_python", "text", "", "version of Python"),
        *(Column(version_column(name), "text", "", f"version of {name}") for name in DISTRIBUTIONS),
        Column("environment_platform", "text", "", "operating system and machine type"),
        Column("environment_processor", "text", "", "processor"),
    ]


_BEFORE = (*_identity(), *_parameters(), *_plan(), *_outcome())
_AFTER = (*_solver(), *_instrument(), *_recording(), *_timings(), *_environment())


def columns() -> tuple[Column, ...]:
    """All columns, in the order of the table; those of registered metrics among them."""
    return (*_BEFORE, *_metrics(), *_AFTER)


def column(name: str) -> Column:
    """The column of that name.

    Raises:
        KeyError: there is none.
    """
    return {item.name: item for item in columns()}[name]


def schema(metadata: Mapping[str, Any] | None = None) -> pa.Schema:
    """Arrow schema of the table.

    Args:
        metadata: goes into the schema as JSON, see :func:`table_metadata`.
    """
    arrow = pa.schema([pa.field(item.name, _TYPES[item.kind]) for item in columns()])
    if metadata is None:
        return arrow
    text = json.dumps(dict(metadata), sort_keys=True, allow_nan=False)
    return arrow.with_metadata({TABLE_METADATA: text.encode()})


def described_columns() -> dict[str, dict[str, str]]:
    """Name to unit and meaning, for a table's metadata."""
    return {item.name: {"unit": item.unit, "words": item.words} for item in columns()}


def reproducible_columns() -> list[str]:
    """Names of the columns that are the same bits in equal sweeps."""
    return [item.name for item in columns() if item.reproducible]


def parameter_values(run: RunParameters) -> dict[str, Any]:
    """Namespaced key to value, in the order of the table."""
    sections = run.model_dump()
    return {f"{name}.{key}": value for name, section in sections.items() for key, value in section.items()}


def run_key(values: Mapping[str, Any], profile: str, instrument: str | None = None) -> str:
    """Hash of all that decides a run's results.

    Args:
        values: of every parameter, see :func:`parameter_values`.
        profile: of the tolerances, which decide the verdict.
        instrument: sensor model beside the simulator's truth, if any.
    """
    listed = [[key, value] for key, value in values.items()]
    text = json.dumps([listed, profile, instrument])
    return hashlib.sha256(text.encode()).hexdigest()[:_KEY_DIGITS]


def tidy(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row as the table holds it: every column there, what is undefined null.

    Raises:
        KeyError: an entry has no column.
    """
    names = [item.name for item in columns()]
    unknown = row.keys() - set(names)
    if unknown:
        raise KeyError(f"no column for {', '.join(sorted(unknown))}")
    return {name: _plain(row.get(name)) for name in names}


def table_of(rows: list[dict[str, Any]], metadata: Mapping[str, Any] | None = None) -> pa.Table:
    """Table of tidied rows."""
    return pa.Table.from_pylist(rows, schema=schema(metadata))


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return None if math.isnan(value) else value
    return value

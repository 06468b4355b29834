"""Columns of a sweep's table: name, type, unit and meaning of each, and the columns that a walk gives.

One row per run. What is undefined is null, never NaN. Every column but those of its cost (``timing_*``,
``worker``, ``memory_peak``) is a function of the definition alone: the same bits for any workers and any
interruptions. Metrics come from the registry (:mod:`validation.judge.metrics`), parameters from
:class:`ampm.parameters.RunParameters`: a new one is a new column.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np
import pyarrow as pa

from ampm.planner.centroidal import PlanConstants
from ampm.run_file import describe_keys, key_info
from ampm.section import Option
from ampm.walk import LIMITED, UNSOLVED
from validation.judge.metrics import METRICS, has_qp
from validation.store.machine import memory_peak

if TYPE_CHECKING:
    from validation.run.trial import Trial

Kind = Literal["real", "whole", "text"]
Options = Mapping[str, Sequence[Option]]
"""Options of users' classes, by their keys, with their values."""
_TYPES = {"real": pa.float64(), "whole": pa.int64(), "text": pa.string()}
_KINDS: Mapping[str, Kind] = {"float": "real", "int": "whole", "text": "text"}


class Column(NamedTuple):
    """One column of the table.

    Attributes:
        name: as in the file.
        kind: real (float64), whole (int64), text (UTF-8).
        unit: SI unit, ``1`` for a plain number, empty for words.
        words: meaning.
    """

    name: str
    kind: Kind
    unit: str
    words: str


@cache
def _listed() -> tuple[tuple[str, Column], ...]:
    """Columns of the file beside this module, each with its place in the table."""
    with Path(__file__).with_name("columns.csv").open(encoding="utf-8", newline="") as file:
        return tuple(
            (row["place"], Column(row["name"], cast(Kind, row["kind"]), row["unit"], row["words"]))
            for row in csv.DictReader(file)
        )


def columns(options: Options = MappingProxyType({})) -> tuple[Column, ...]:
    """All columns, in the order of the table; a metric that is registered later adds its own.

    Args:
        options: of a sweep, each of which adds a column.
    """

    def at(place: str) -> Iterator[Column]:
        return (column for where, column in _listed() if where == place)

    keys = ((item, _KINDS[item.kind]) for item in describe_keys())
    constants = ((f"plan_{item.name}", item.metadata) for item in fields(PlanConstants))
    return (
        *at("run"),
        *(Column(item.key, kind, "" if kind == "text" else item.unit, item.meaning) for item, kind in keys),
        *(Column(key, _kind(values), "", key_info(key).meaning) for key, values in options.items()),
        *(Column(name, "real", data["unit"], data["meaning"]) for name, data in constants),
        *at("plan"),
        *at("walk"),
        *(Column(item.column, "real", item.unit, item.meaning) for item in METRICS.values()),
        *at("cost"),
    )


def _kind(values: Sequence[Option]) -> Kind:
    """Kind of an option's column: numbers if all values are numbers."""
    if any(isinstance(value, bool | str) for value in values):
        return "text"
    return "whole" if all(isinstance(value, int) for value in values) else "real"


def schema(options: Options = MappingProxyType({})) -> pa.Schema:
    """Arrow schema of the table; for ``options`` see :func:`columns`."""
    return pa.schema([pa.field(item.name, _TYPES[item.kind]) for item in columns(options)])


def walk_columns(trial: Trial) -> dict[str, Any]:
    """Plan, outcome, metrics and cost of a walk; what is undefined is None."""
    record, plan, constants = trial.record, trial.plan, trial.plan.constants
    outcome, margins = record.outcome, trial.comparison.costs["margins"]
    row = {
        **{f"plan_{item.name}": getattr(constants, item.name) for item in fields(constants)},
        "plan_step_duration": constants.step_duration,
        "plan_duration": plan.duration,
        "plan_zmp_margin": trial.planned.zmp_margin,
        "outcome": str(outcome.name),
        "cause": outcome.cause or None,
        "verdict": str(trial.verdict.name),
        "failed": ",".join(item.name for item in trial.verdict.failed),
        "steps_completed": outcome.steps_completed,
        "outcome_time": outcome.time,
        "foot_length": trial.comparison.scales["foot_length"],
        **{METRICS[name].column: metric.value for name, metric in trial.metrics.items()},
        "margin_torque_joint": margins["torque"].where or None,
        "margin_joint_name": margins["joint"].where or None,
        "margin_clearance_parts": margins["clearance"].where or None,
        "qp_ticks": int(record.qp_status.size),
        **{f"timing_{name}": seconds for name, seconds in trial.timing.items() if name != "simulated"},
        "memory_peak": memory_peak(),
    }
    if has_qp(record):
        row["qp_limited"] = int(np.count_nonzero(record.qp_status == LIMITED))
        row["qp_unsolved"] = int(np.count_nonzero(record.qp_status == UNSOLVED))
        row["qp_iterations_maximum"] = int(record.qp_iterations.max(initial=0))
    return {name: None if isinstance(v, float) and math.isnan(v) else v for name, v in row.items()}

"""Columns of a sweep's table: name, type, unit and meaning of each, and the columns that a walk gives.

One row per run. What is undefined is null, never NaN. Every column but those of its cost (``timing_total``,
``worker``) is a function of the definition alone: the same bits for any workers and any
interruptions. Metrics come from the registry (:mod:`validation.judge.metrics`), parameters from
:class:`ampm.parameters.RunParameters`: a new one is a new column.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import pyarrow as pa

from ampm.parameters import KEYS
from ampm.planner.centroidal import PlanConstants
from ampm.run_file import key_info
from ampm.section import Option
from validation.judge.metrics import METRICS
from validation.run.trial import Trial
from validation.table import own_rows
from validation.trial.followed import LEADS

Kind = Literal["real", "whole", "text"]
Options = Mapping[str, Sequence[Option]]
"""Options of users' classes, by their keys, with their values."""
AHEAD = ("zmp_x", "zmp_y")
"""Signals with a column of their RMS error for each lead of the plan."""
_TYPES = {"real": pa.float64(), "whole": pa.int64(), "text": pa.string()}
_KINDS: Mapping[str, Kind] = {"float": "real", "int": "whole", "text": "text"}


class Column(NamedTuple):
    """One column of the table."""

    name: str  # as in the file
    kind: Kind  # real (float64), whole (int64), text (UTF-8)
    unit: str  # SI unit, `1` for a plain number, empty for words
    words: str  # meaning


def columns(options: Options = MappingProxyType({})) -> tuple[Column, ...]:
    """All columns, in the order of the table; a metric that is registered later adds its own.

    Args:
        options: of a sweep, each of which adds a column.
    """
    own: dict[str, list[Column]] = {"run": [], "walk": [], "cost": []}
    for row in own_rows("study/sweep/columns.csv"):
        own[row.pop("place")].append(Column(**row))  # type: ignore[arg-type]
    inputs = ((item, _KINDS[item.kind]) for item in map(key_info, KEYS))
    constants = ((f"plan_{item.name}", item.metadata) for item in fields(PlanConstants))
    ahead = ((name, lead, METRICS[f"{name}_rmse"].label) for lead in LEADS for name in AHEAD)
    return (
        *own["run"],
        *(Column(item.key, kind, "" if kind == "text" else item.unit, item.meaning) for item, kind in inputs),
        *(Column(key, _kind(values), "", key_info(key).meaning) for key, values in options.items()),
        *(Column(name, "real", data["unit"], data["meaning"]) for name, data in constants),
        *own["walk"],
        *(
            Column(ahead_column(name, at), "real", "m", f"{label}, {at:g} s ahead")
            for name, at, label in ahead
        ),
        *(Column(item.column, "real", item.unit, item.meaning) for item in METRICS.values()),
        *own["cost"],
    )


def ahead_column(signal: str, lead: float) -> str:
    """Column of the RMS error of a signal from the plan as it stood a while before [s]."""
    return f"ahead_{lead:g}_{signal}"


def _kind(values: Sequence[Option]) -> Kind:
    """Kind of an option's column: numbers if all values are numbers."""
    if any(isinstance(value, bool | str) for value in values):
        return "text"
    return "whole" if all(isinstance(value, int) for value in values) else "real"


def schema(options: Options = MappingProxyType({})) -> pa.Schema:
    """Arrow schema of the table; for ``options`` see :func:`columns`."""
    return pa.schema([pa.field(item.name, _TYPES[item.kind]) for item in columns(options)])


def walk_columns(trial: Trial) -> dict[str, Any]:
    """Plan, outcome and metrics of a walk; what is undefined is None."""
    plan, constants, outcome = trial.plan, trial.plan.constants, trial.record.outcome
    row = {
        **{f"plan_{item.name}": getattr(constants, item.name) for item in fields(constants)},
        "plan_step_duration": constants.step_duration,
        "plan_duration": plan.duration,
        "plan_zmp_margin": plan.least_zmp_margin()[0],
        "outcome": str(outcome.name),
        "cause": outcome.cause or None,
        "verdict": str(trial.verdict.name),
        "failed": ",".join(item.name for item in trial.verdict.failed),
        "steps_completed": outcome.steps_completed,
        "outcome_time": outcome.time,
        "foot_length": trial.comparison.scales["foot_length"],
        **{
            ahead_column(name, lead): errors[name]
            for lead, errors in trial.comparison.ahead.items()
            for name in AHEAD
        },
        **{METRICS[name].column: metric.value for name, metric in trial.metrics.items()},
    }
    return {name: None if isinstance(v, float) and math.isnan(v) else v for name, v in row.items()}

"""Columns of a sweep's table: name, type, unit and meaning of each, and the columns that a walk gives.

One row per run. What is undefined is null, never NaN. Every column but those of its cost (``timing_total``,
``worker``) is a function of the definition alone: the same bits for any workers and any
interruptions. Metrics come from the registry (:mod:`validation.judge.metrics`), parameters from
:class:`ampm.parameters.RunParameters`: a new one is a new column.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

import pyarrow as pa

from ampm.parameters import KEYS
from ampm.planner.centroidal import PlanConstants
from ampm.run_file import key_info
from ampm.section import Option
from validation.judge.metrics import METRICS
from validation.run.trial import Trial
from validation.table import package_rows
from validation.trial.followed import LEADS

AHEAD = ("zmp_x", "zmp_y")
"""Signals with a column of their RMS error for each lead of the plan."""
_TYPES = {"float": pa.float64(), "int": pa.int64(), "text": pa.string()}


def schema(options: Mapping[str, Sequence[Option]] = MappingProxyType({})) -> pa.Schema:
    """All columns, in the order of the table; options of a sweep and registered metrics add their own.

    The metadata of a field has the ``unit`` of its column, SI, `1` for a plain number, empty for words; and
    its ``meaning``.
    """
    own: dict[str, list[pa.Field]] = defaultdict(list)
    for row in package_rows("study/sweep/columns.csv"):
        own[row.pop("place")].append(_column(**row))
    constants = ((f"plan_{item.name}", item.metadata) for item in fields(PlanConstants))
    ahead = ((name, lead, METRICS[f"{name}_rmse"].label) for lead in LEADS for name in AHEAD)
    return pa.schema(
        [
            *own["run"],
            *(_column(item.key, item.kind, item.unit, item.meaning) for item in map(key_info, KEYS)),
            *(_column(key, _kind(values), "", key_info(key).meaning) for key, values in options.items()),
            *(_column(name, "float", data["unit"], data["meaning"]) for name, data in constants),
            *own["walk"],
            *(
                _column(ahead_column(name, at), "float", "m", f"{label}, {at:g} s ahead")
                for name, at, label in ahead
            ),
            *(_column(item.column, "float", item.unit, item.meaning) for item in METRICS.values()),
            *own["cost"],
        ]
    )


def _column(name: str, kind: str, unit: str, meaning: str) -> pa.Field:
    return pa.field(name, _TYPES[kind], metadata={"unit": "" if kind == "text" else unit, "meaning": meaning})


def ahead_column(signal: str, lead: float) -> str:
    """Column of the RMS error of a signal from the plan as it stood a while before [s]."""
    return f"ahead_{lead:g}_{signal}"


def _kind(values: Sequence[Option]) -> str:
    """Kind of an option's column: numbers if all values are numbers."""
    if any(isinstance(value, bool | str) for value in values):
        return "text"
    return "int" if all(isinstance(value, int) for value in values) else "float"


def walk_columns(trial: Trial) -> dict[str, Any]:
    """Plan, outcome and metrics of a walk; what is undefined is None."""
    plan, constants, outcome = trial.plan, trial.plan.constants, trial.record.outcome
    row = {
        **{f"plan_{item.name}": getattr(constants, item.name) for item in fields(constants)},
        "plan_step_duration": constants.step_duration,
        "plan_duration": plan.duration,
        "plan_note": trial.planned.note or None,
        "plan_zmp_margin": plan.least_zmp_margin()[0],
        "outcome": str(outcome.name),
        "cause": outcome.cause or (trial.verdict.reason if trial.verdict.name == "not_measured" else None),
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

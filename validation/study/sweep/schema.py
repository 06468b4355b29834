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

from ampm.planner.centroidal import PlanConstants
from ampm.run_file import describe_keys, key_info
from ampm.section import Option
from validation.judge.metrics import METRICS
from validation.run.trial import Trial
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


_RUN = (
    Column("run", "whole", "1", "number of the run in the sweep, from 0"),
    Column("name", "text", "", "the same, padded with zeros: name of the run's folder"),
    Column("gait", "text", "", "preset, or name of the file, from which the run starts"),
    Column(
        "key",
        "text",
        "",
        "hash of the parameters that are not at their defaults, to find it in another sweep",
    ),
)
_WALK = (
    Column("plan_step_duration", "real", "s", "duration of a step"),
    Column("plan_duration", "real", "s", "duration of the planned walk"),
    Column("plan_zmp_margin", "real", "m", "least distance of the planned ZMP from the edge of the support"),
    Column("outcome", "text", "", "completed, fell, diverged, infeasible, refused, crashed, timed_out"),
    Column("reason", "text", "", "of a refusal, its short name; of a crash, the error's type; else null"),
    Column("cause", "text", "", "one sentence on why the run did not complete, else null"),
    Column("traceback", "text", "", "of a crash, its last lines, else null"),
    Column("verdict", "text", "", "pass, fail or not_measured; null for a run that did not walk"),
    Column("failed", "text", "", "metrics out of tolerance, separated by commas; empty if none is"),
    Column("steps_completed", "whole", "1", "whole steps walked; null for a run that did not walk"),
    Column("outcome_time", "real", "s", "simulated time at the end of the walk"),
    Column("foot_length", "real", "m", "length of the foot, with which limits grow"),
    Column("recording", "text", "", "folder of the run, relative to the sweep's; null if it was not kept"),
)
_COST = (
    Column("timing_total", "real", "s", "wall clock of the whole run on its worker"),
    Column("worker", "text", "", "worker that walked it; null if none had to"),
)


def columns(options: Options = MappingProxyType({})) -> tuple[Column, ...]:
    """All columns, in the order of the table; a metric that is registered later adds its own.

    Args:
        options: of a sweep, each of which adds a column.
    """
    keys = ((item, _KINDS[item.kind]) for item in describe_keys())
    constants = ((f"plan_{item.name}", item.metadata) for item in fields(PlanConstants))
    return (
        *_RUN,
        *(Column(item.key, kind, "" if kind == "text" else item.unit, item.meaning) for item, kind in keys),
        *(Column(key, _kind(values), "", key_info(key).meaning) for key, values in options.items()),
        *(Column(name, "real", data["unit"], data["meaning"]) for name, data in constants),
        *_WALK,
        *(
            Column(
                ahead_column(name, lead), "real", "m", f"{METRICS[f'{name}_rmse'].label}, {lead:g} s ahead"
            )
            for lead in LEADS
            for name in AHEAD
        ),
        *(Column(item.column, "real", item.unit, item.meaning) for item in METRICS.values()),
        *_COST,
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
        "plan_zmp_margin": trial.planned.zmp_margin,
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

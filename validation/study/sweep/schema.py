"""Columns of a sweep's table: name, type, unit and meaning of each, and the row that a run gives.

One row per run. What is undefined is null, never NaN. Every column but those that begin with ``timing_`` or
``environment_`` is a function of the definition alone: the same bits whatever the workers, and whatever
happened on the way. Metrics come from the registry (:mod:`validation.judge.metrics`), parameters from
:class:`ampm.parameters.RunParameters`: a new one is a new column.
"""

from __future__ import annotations

import errno
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa

from ampm.exceptions import AmpmError, InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.centroidal import PlanConstants
from ampm.planner.periodic import plan_gait
from ampm.planner.support import AnyPlan
from validation.judge.metrics import METRICS
from validation.measure.instruments.names import INSTRUMENT_COLUMNS
from validation.store.environment import DISTRIBUTIONS, describe_environment
from validation.store.identity import code_hash, run_key
from validation.store.machine import memory_peak

if TYPE_CHECKING:
    from validation.run.trial import Trial

OUTCOMES = ("completed", "fell", "diverged", "infeasible", "refused", "crashed", "timed_out", "interrupted")
"""How a run can end. The first four are ends of a walk; the others never walked, or not to an end."""

WORKER_DIED = "worker_died"
"""Reason of a crash that took its worker's process along."""
_TRANSIENT = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO, errno.EAGAIN, errno.ESTALE)
MACHINE_FAULTS = frozenset({WORKER_DIED, "MemoryError", *(errno.errorcode[number] for number in _TRANSIENT)})
"""Reasons of crashes that say nothing of the gait: ``--resume`` walks these runs again."""

NOT_REPRODUCIBLE = ("timing_", "environment_")
"""Beginnings of the columns in which equal runs may differ."""

Kind = Literal["real", "whole", "text", "flag"]
_TYPES = {"real": pa.float64(), "whole": pa.int64(), "text": pa.string(), "flag": pa.bool_()}
_KINDS: Mapping[type, Kind] = {float: "real", int: "whole", bool: "flag"}
_CAUSE_LENGTH = 400
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")
_PATH = re.compile(r"(?<![\w.])(?:/[^\s/'\":,]+)+/([^\s/'\":,]+)")


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


def _reals(*rows: tuple[str, str, str]) -> tuple[Column, ...]:
    return tuple(Column(name, "real", unit, words) for name, unit, words in rows)


def _wholes(*rows: tuple[str, str]) -> tuple[Column, ...]:
    return tuple(Column(name, "whole", "1", words) for name, words in rows)


def _texts(*rows: tuple[str, str]) -> tuple[Column, ...]:
    return tuple(Column(name, "text", "", words) for name, words in rows)


_RUN = (
    *_wholes(("run", "number of the run in the sweep, from 0")),
    *_texts(
        ("name", "the same, padded with zeros: name of the run's folder"),
        (
            "key",
            "hash of the parameters that are not at their defaults: the same run in another sweep has it",
        ),
    ),
)
_PLAN = _reals(
    *(
        (f"plan_{item.name}", item.metadata["unit"], item.metadata["meaning"])
        for item in fields(PlanConstants)
    ),
    ("plan_step_duration", "s", "duration of a step"),
    ("plan_duration", "s", "duration of the planned walk"),
    ("plan_zmp_margin", "m", "smallest distance of the planned ZMP from the edge of the planned support"),
    ("plan_motion_residual", "1", "largest difference of the motion's mirrored return [m, rad, m/s, rad/s]"),
    ("plan_motion_knee_minimum", "rad", "smallest knee flexion of the planned motion"),
    ("plan_motion_joint_limit_margin", "rad", "smallest distance of the planned motion from a joint's limit"),
    ("plan_motion_trunk_pitch", "rad", "mean pitch of the trunk in the planned motion"),
)
_WALK = (
    *_texts(
        ("outcome", ", ".join(OUTCOMES)),
        ("reason", "of a refusal, its short name; of a crash, the error's type; else null"),
        ("cause", "one sentence on why the run did not complete, else null"),
        ("verdict", "pass, fail or not_measured; null for a run that did not walk"),
        ("failed", "metrics out of tolerance, separated by commas; empty if none is"),
    ),
    *_wholes(("steps_completed", "whole steps walked; null for a run that did not walk")),
    *_reals(("outcome_time", "s", "simulated time at the end of the walk")),
    *_texts(
        ("margin_torque_joint", "joint of margin_torque"),
        ("margin_joint_name", "joint of margin_joint"),
        ("recording", "folder of the run, relative to the sweep's; null if the run was not kept"),
    ),
    *_wholes(
        ("qp_ticks", "control ticks"),
        ("qp_limited", "control ticks whose QP needed torque or joint limits"),
        ("qp_unsolved", "control ticks whose QP stayed unsolved"),
        ("qp_iterations_maximum", "most iterations of a control tick's QP"),
    ),
)
_TIMING = _reals(
    ("timing_planning", "s", "wall clock of body, plan and whole-body motion"),
    ("timing_motion", "s", "of which the whole-body motion"),
    ("timing_simulation", "s", "wall clock of the closed loop"),
    ("timing_measurement", "s", "wall clock of weighing, measurement, comparison, verdict"),
    ("timing_recording", "s", "wall clock of writing the run's folder"),
    ("timing_total", "s", "wall clock of the whole run on its worker"),
    ("timing_cpu_planning", "s", "processor time of body, plan and whole-body motion"),
    ("timing_cpu_walk", "s", "processor time of closed loop and measurement"),
    ("timing_cpu_total", "s", "processor time of the whole run on its worker"),
    ("timing_real_time_factor", "1", "simulated time over wall clock of the closed loop"),
)
_ENVIRONMENT = (
    *_texts(
        ("environment_time", "when the run ended (UTC, ISO 8601)"),
        ("environment_worker", "worker that walked it; null if none had to"),
    ),
    *_wholes(("environment_attempts", "times it was begun; more than 1 if workers were lost")),
    *_reals(("environment_memory_peak", "MB", "largest resident memory of the worker so far")),
    *_texts(("environment_revision", "git commit of the code; null outside a checkout")),
    Column("environment_modified", "flag", "", "whether tracked files differed from that commit"),
    *_texts(
        ("environment_code", "hash of the sources and versions that results can depend on"),
        ("environment_python", "version of Python"),
        *((f"environment_version_{name.replace('-', '_')}", f"version of {name}") for name in DISTRIBUTIONS),
        ("environment_platform", "operating system and machine type"),
        ("environment_processor", "processor"),
    ),
)


@cache
def _parameters() -> tuple[Column, ...]:
    found = []
    for section, model in RunParameters():
        for name, field in type(model).model_fields.items():
            kind = _KINDS.get(type(getattr(model, name)), "text")
            extra = field.json_schema_extra
            unit = str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"
            words = field.description or ""
            found.append(Column(f"{section}.{name}", kind, "" if kind == "text" else unit, words))
    return tuple(found)


def columns() -> tuple[Column, ...]:
    """All columns, in the order of the table; a metric that is registered later adds its own."""
    metrics = ((item.column, item.unit, item.meaning) for item in METRICS.values())
    instrument = ((name, unit, words) for name, (unit, words) in INSTRUMENT_COLUMNS.items())
    parts = (_RUN, _parameters(), _PLAN, _WALK, _reals(*metrics), _reals(*instrument), _TIMING, _ENVIRONMENT)
    return tuple(column for part in parts for column in part)


def schema() -> pa.Schema:
    """Arrow schema of the table."""
    return pa.schema([pa.field(item.name, _TYPES[item.kind]) for item in columns()])


def reproducible_columns() -> list[str]:
    """Names of the columns that are the same bits in equal sweeps."""
    return [item.name for item in columns() if not item.name.startswith(NOT_REPRODUCIBLE)]


# ------------------------------------------------------------------------------ rows


def first_columns(run: int, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Which run it is.

    Args:
        run: number.
        name: the same as text.
        values: of every parameter, see :func:`validation.store.identity.parameter_values`.
    """
    return {"run": run, "name": name, "key": run_key(values), **values}


def plan_columns(plan: AnyPlan, *, with_motion: bool) -> dict[str, Any]:
    """Derived constants; that of L_y only if it is of a motion."""
    constants = plan.constants
    row = {f"plan_{field.name}": getattr(constants, field.name) for field in fields(constants)}
    if not with_motion:
        row["plan_angular_momentum_y_offset"] = None
    return {**row, "plan_step_duration": constants.step_duration, "plan_duration": plan.duration}


def walk_columns(walk: Trial) -> dict[str, Any]:
    """Plan, motion, outcome, metrics and cost of a walk."""
    record, verdict, report = walk.record, walk.evaluation.verdict, walk.planned.motion.report
    outcome, margins = record.outcome, walk.evaluation.comparison.margins
    return {
        **plan_columns(walk.planned.plan, with_motion=True),
        "plan_zmp_margin": walk.planned.zmp_margin,
        "plan_motion_residual": report.residual,
        "plan_motion_knee_minimum": report.knee_minimum.value,
        "plan_motion_joint_limit_margin": report.joint_limit_margin.value,
        "plan_motion_trunk_pitch": report.mean_trunk_pitch,
        "outcome": str(outcome.name),
        "cause": outcome.cause or None,
        "verdict": str(verdict.name),
        "failed": ",".join(item.name for item in verdict.failed),
        "steps_completed": outcome.steps_completed,
        "outcome_time": outcome.time,
        **{METRICS[name].column: metric.value for name, metric in walk.evaluation.metrics.items()},
        "margin_torque_joint": margins.torque.where or None,
        "margin_joint_name": margins.joint.where or None,
        "qp_ticks": int(record.qp_status.size),
        "qp_limited": int(np.count_nonzero(record.qp_status == 1)),
        "qp_unsolved": int(np.count_nonzero(record.qp_status == 2)),
        "qp_iterations_maximum": int(record.qp_iterations.max(initial=0)),
    }


def refused_columns(error: RefusedGait | InputError, parameters: RunParameters | None) -> dict[str, Any]:
    """A refusal, with the plan's constants where there is a plan."""
    row = {
        "outcome": "refused",
        "reason": getattr(error, "reason", "bad_parameter"),
        "cause": one_line(error),
    }
    if parameters is not None and getattr(error, "kind", "") != "mathematical":
        try:
            plan = plan_gait(parameters.gait, parameters.body.mass)
        except AmpmError:
            return row
        row |= plan_columns(plan, with_motion=False)
    return row


def error_columns(error: BaseException, parameters: RunParameters | None) -> dict[str, Any]:
    """What an error makes of a run: refused if the error says so, crashed otherwise.

    Args:
        error: that ended the run.
        parameters: of the run, if the formula's plan is of interest.
    """
    fault = _machine_fault(error)
    if fault is None and isinstance(error, RefusedGait | InputError):
        return refused_columns(error, parameters)
    return {"outcome": "crashed", "reason": fault or type(error).__name__, "cause": one_line(error) or None}


def _machine_fault(error: BaseException) -> str | None:
    """The host's part in an error, a member of :data:`MACHINE_FAULTS`; None if it has none.

    Libraries wrap what they meet, and bad input may be a file that could not be opened just now: what an
    error was raised from, or beside, counts too.
    """
    for item in _chain(error, set()):
        if isinstance(item, MemoryError):
            return "MemoryError"
        if isinstance(item, OSError) and item.errno in _TRANSIENT:
            return errno.errorcode[item.errno]
    return None


def _chain(error: BaseException | None, seen: set[int]) -> Iterator[BaseException]:
    if error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        yield from _chain(error.__cause__, seen)
        yield from _chain(error.__context__, seen)


def one_line(error: BaseException) -> str:
    """An error's text without what differs from process to process: addresses and folders."""
    text = " ".join(str(error).split())
    text = _PATH.sub(r"\1", _ADDRESS.sub("0x...", text))
    return text if len(text) <= _CAUSE_LENGTH else text[: _CAUSE_LENGTH - 3] + "..."


@cache
def _constant_environment() -> Mapping[str, Any]:
    """Of this process."""
    found = describe_environment()
    names = ("revision", "modified", "python", "platform", "processor")
    row = {f"environment_{name}": found[name] for name in names}
    versions = {f"environment_version_{name.replace('-', '_')}": v for name, v in found["versions"].items()}
    return {**row, **versions, "environment_code": code_hash()}


def environment_columns(worker: str | None = None, attempts: int = 0) -> dict[str, Any]:
    """What a run that ended now ran on.

    Args:
        worker: name of the worker; None for a row that the sweep's own process makes.
        attempts: times the run was begun.
    """
    return {
        **_constant_environment(),
        "environment_time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "environment_worker": worker,
        "environment_attempts": attempts,
        "environment_memory_peak": None if worker is None else memory_peak(),
    }


def tidy(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row as the table holds it: what is undefined is null, and texts are what UTF-8 can hold.

    Raises:
        KeyError: an entry has no column.
    """
    names = schema().names
    if unknown := row.keys() - set(names):
        raise KeyError(f"no column for {', '.join(sorted(unknown))}")
    return {name: _plain(row.get(name)) for name in names}


def clean_text(text: str) -> str:
    """Text that UTF-8 can hold: a lone surrogate, which stands for a byte that was none, is spelled out."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, float) and math.isnan(value):
        return None
    return clean_text(value) if isinstance(value, str) else value

"""Columns of a sweep's table: name, type, unit and meaning of each, and the row that a run gives.

One row per run. What is undefined is null, never NaN. Every column but those that begin with ``timing_`` or
``environment_`` is a function of the definition alone: the same bits for any workers and any interruptions.
Metrics come from the registry (:mod:`validation.judge.metrics`), parameters from
:class:`ampm.parameters.RunParameters`: a new one is a new column.
"""

from __future__ import annotations

import csv
import errno
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np
import pyarrow as pa

from ampm.exceptions import AmpmError, InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.centroidal import CentroidalPlan, PlanConstants
from ampm.planner.periodic import plan_gait
from ampm.run_file import describe_keys
from ampm.walk import LIMITED, UNSOLVED
from validation.judge.metrics import METRICS, has_qp
from validation.measure.instruments.names import INSTRUMENT_COLUMNS
from validation.store.environment import DISTRIBUTIONS, describe_environment
from validation.store.identity import code_hash, run_key
from validation.store.machine import memory_peak
from validation.trial.users import UsersError

if TYPE_CHECKING:
    from ampm.body.motion import MotionReport
    from validation.run.trial import Trial
    from validation.trial.record import SimulationRecord

WORKER_DIED = "worker_died"
"""Reason of a crash that ended its worker's process."""
_TRANSIENT = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO, errno.EAGAIN, errno.ESTALE)
MACHINE_FAULTS = frozenset({WORKER_DIED, "MemoryError", *(errno.errorcode[number] for number in _TRANSIENT)})
"""Reasons of crashes that are no result of the gait: ``--resume`` walks these runs again."""

Kind = Literal["real", "whole", "text", "flag"]
_TYPES = {"real": pa.float64(), "whole": pa.int64(), "text": pa.string(), "flag": pa.bool_()}
_KINDS: Mapping[str, Kind] = {"float": "real", "int": "whole", "text": "text"}
_CAUSE_LENGTH = 400
_DEPTH = 20  # errors that one was raised from, at most
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")
_PATH = re.compile(r"(?<![\w.])(?:/[^\s/'\":,]+)+/([^\s/'\":,]+)")


class Column(NamedTuple):
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


@cache
def _columns(metrics: tuple[Column, ...]) -> tuple[Column, ...]:
    with Path(__file__).with_name("columns.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))

    def listed(place: str) -> Iterator[Column]:
        """Columns of one part of the table."""
        for row in rows:
            if row["place"] == place:
                yield Column(row["name"], cast(Kind, row["kind"]), row["unit"], row["words"])

    keys = ((item, _KINDS[item.kind]) for item in describe_keys())
    constants = ((f"plan_{item.name}", item.metadata) for item in fields(PlanConstants))
    return (
        *listed("run"),
        *(Column(item.key, kind, "" if kind == "text" else item.unit, item.meaning) for item, kind in keys),
        *(Column(name, "real", data["unit"], data["meaning"]) for name, data in constants),
        *listed("plan"),
        *listed("walk"),
        *metrics,
        *(Column(name, "real", unit, words) for name, (unit, words) in INSTRUMENT_COLUMNS.items()),
        *listed("cost"),
        *(Column(_version_column(name), "text", "", f"version of {name}") for name in DISTRIBUTIONS),
    )


def _version_column(distribution: str) -> str:
    return f"environment_version_{distribution.replace('-', '_')}"


def columns() -> tuple[Column, ...]:
    """All columns, in the order of the table; a metric that is registered later adds its own."""
    return _columns(tuple(Column(item.column, "real", item.unit, item.meaning) for item in METRICS.values()))


def schema() -> pa.Schema:
    """Arrow schema of the table."""
    return pa.schema([pa.field(item.name, _TYPES[item.kind]) for item in columns()])


# ------------------------------------------------------------------------------ rows


def make_row(
    run: int,
    name: str,
    values: Mapping[str, Any],
    found: Mapping[str, Any],
    worker: str | None = None,
    attempts: int = 0,
) -> dict[str, Any]:
    """The row of a run that ended now, as the table holds it: undefined is null, texts are valid UTF-8.

    Args:
        run: number.
        name: the same as text; of its folder.
        values: of every parameter, see :func:`validation.store.identity.parameter_values`.
        found: columns of the result.
        worker: name of the worker; None for a row that the sweep's own process makes.
        attempts: times that the run was begun.

    Raises:
        KeyError: an entry has no column.
    """
    row = {
        "run": run,
        "name": name,
        "key": run_key(values),
        **values,
        **found,
        **_constant_environment(),
        "environment_time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "environment_worker": worker,
        "environment_attempts": attempts,
        "environment_memory_peak": None if worker is None else memory_peak(),
    }
    names = [item.name for item in columns()]
    if unknown := row.keys() - set(names):
        raise KeyError(f"no column for {', '.join(sorted(unknown))}")
    return {name: _plain(row.get(name)) for name in names}


def _plain(value: Any) -> Any:
    if isinstance(value, float) and math.isnan(value):
        return None
    return clean_text(value) if isinstance(value, str) else value


def clean_text(text: str) -> str:
    """Valid UTF-8 text: a lone surrogate, which stands for an invalid byte, is escaped."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


@cache
def _constant_environment() -> Mapping[str, Any]:
    """Of this process."""
    found = describe_environment()
    names = ("revision", "modified", "python", "platform", "processor")
    row = {f"environment_{name}": found[name] for name in names}
    versions = {_version_column(name): version for name, version in found["versions"].items()}
    return {**row, **versions, "environment_code": code_hash()}


def walk_columns(walk: Trial) -> dict[str, Any]:
    """Plan, motion, outcome, metrics and cost of a walk."""
    from ampm.body.motion import PeriodicPosture  # imported here: Pinocchio is slow to load

    record, verdict, posture = walk.record, walk.verdict, walk.planned.plan.posture
    outcome, margins = record.outcome, walk.comparison.costs["margins"]
    return {
        **_plan_columns(walk.planned.plan),
        "plan_zmp_margin": walk.planned.zmp_margin,
        **(_motion_columns(posture.motion.report) if isinstance(posture, PeriodicPosture) else {}),
        "outcome": str(outcome.name),
        "cause": outcome.cause or None,
        "verdict": str(verdict.name),
        "failed": ",".join(item.name for item in verdict.failed),
        "steps_completed": outcome.steps_completed,
        "outcome_time": outcome.time,
        "foot_length": walk.comparison.scales["foot_length"],
        **{METRICS[name].column: metric.value for name, metric in walk.metrics.items()},
        "margin_torque_joint": margins["torque"].where or None,
        "margin_joint_name": margins["joint"].where or None,
        "margin_clearance_parts": margins["clearance"].where or None,
        "qp_ticks": int(record.qp_status.size),
        **(_qp_columns(record) if has_qp(record) else {}),
    }


def _motion_columns(report: MotionReport) -> dict[str, float]:
    return {
        "plan_motion_residual": report.residual,
        "plan_motion_knee_minimum": report.knee_minimum.value,
        "plan_motion_joint_limit_margin": report.joint_limit_margin.value,
        "plan_motion_clearance": report.clearance.value,
        "plan_motion_trunk_pitch": report.mean_trunk_pitch,
    }


def _qp_columns(record: SimulationRecord) -> dict[str, int]:
    return {
        "qp_limited": int(np.count_nonzero(record.qp_status == LIMITED)),
        "qp_unsolved": int(np.count_nonzero(record.qp_status == UNSOLVED)),
        "qp_iterations_maximum": int(record.qp_iterations.max(initial=0)),
    }


def _plan_columns(plan: CentroidalPlan) -> dict[str, Any]:
    constants = {f"plan_{item.name}": getattr(plan.constants, item.name) for item in fields(plan.constants)}
    return constants | {"plan_step_duration": plan.constants.step_duration, "plan_duration": plan.duration}


def error_columns(error: BaseException, parameters: RunParameters | None) -> dict[str, Any]:
    """Columns of a run that an error ended: refused if the error is a refusal, crashed otherwise.

    Args:
        error: that ended the run.
        parameters: of the run, to add the columns of its plan by the formula.
    """
    cause = one_line(error) or None
    fault = _host_fault(error)
    refused = isinstance(error, RefusedGait | InputError) and not isinstance(error, UsersError)
    if fault is not None or not refused:
        return {"outcome": "crashed", "reason": fault or type(error).__name__, "cause": cause}
    row = {"outcome": "refused", "reason": getattr(error, "reason", "bad_parameter"), "cause": cause}
    with suppress(AmpmError):
        if parameters is not None:
            plan = plan_gait(parameters.gait, parameters.body.mass)
            # The offset of L_y is that of a motion, which there is not.
            row |= _plan_columns(plan) | {"plan_angular_momentum_y_offset": None}
    return row


def _host_fault(error: BaseException) -> str | None:
    """Host fault behind an error, a member of :data:`MACHINE_FAULTS`; None if there is none.

    Libraries wrap errors, so causes and contexts of an error count, too.
    """
    found: BaseException | None = error
    for _ in range(_DEPTH):
        if isinstance(found, MemoryError):
            return "MemoryError"
        if isinstance(found, OSError) and found.errno in _TRANSIENT:
            return errno.errorcode[found.errno]
        found = found and (found.__cause__ or found.__context__)
    return None


def one_line(error: BaseException) -> str:
    """An error's text without addresses and folders, which differ between processes."""
    text = " ".join(str(error).split())
    text = _PATH.sub(r"\1", _ADDRESS.sub("0x...", text))
    return text if len(text) <= _CAUSE_LENGTH else text[: _CAUSE_LENGTH - 3] + "..."

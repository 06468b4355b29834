"""From what a run has become to its row."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import AmpmError, InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.periodic import plan_gait
from ampm.planner.support import AnyPlan
from validation.judge.metrics import METRICS
from validation.store.environment import describe_environment
from validation.store.machine import memory_peak
from validation.study.sweep.columns import parameter_values, run_key, version_column
from validation.study.sweep.identity import code_hash

if TYPE_CHECKING:
    from validation.judge.examine import Walk
    from validation.trial.plan import PlannedWalk

REFUSED, CRASHED, TIMED_OUT = "refused", "crashed", "timed_out"
BAD_PARAMETER = "bad_parameter"
WORKER_DIED = "worker_died"
"""Reason of a crash that took its worker's process along."""

_CAUSE_LENGTH = 400
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")
_PATH = re.compile(r"(?<![\w.])(?:/[^\s/'\":,]+)+/([^\s/'\":,]+)")


def first_columns(
    run: int, name: str, parameters: RunParameters, profile: str, instrument: str | None
) -> dict[str, Any]:
    """Which run it is."""
    values = parameter_values(parameters)
    return {"run": run, "name": name, "key": run_key(values, profile, instrument), **values}


def plan_columns(plan: AnyPlan, *, with_motion: bool) -> dict[str, Any]:
    """Derived constants.

    Args:
        plan: of the run.
        with_motion: whether the constant of L_y is that of a motion.
    """
    constants = plan.constants
    row = {f"plan_{field.name}": getattr(constants, field.name) for field in fields(constants)}
    row |= {"plan_step_duration": constants.step_duration, "plan_duration": plan.duration}
    if not with_motion:
        row["plan_angular_momentum_y_offset"] = None
    return row


def motion_columns(planned: PlannedWalk) -> dict[str, Any]:
    """Plan and whole-body motion."""
    report = planned.motion.report
    return {
        **plan_columns(planned.plan, with_motion=True),
        "plan_zmp_margin": planned.zmp_margin,
        "plan_motion_residual": report.residual,
        "plan_motion_knee_minimum": report.knee_minimum,
        "plan_motion_joint_limit_margin": report.joint_limit_margin,
        "plan_motion_trunk_pitch": report.mean_trunk_pitch,
    }


def walk_columns(walk: Walk) -> dict[str, Any]:
    """Outcome, metrics, margins and cost of a walk."""
    record, verdict = walk.record, walk.evaluation.verdict
    outcome, margins = record.outcome, walk.evaluation.comparison.margins
    return {
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
    """A refusal, with the plan's constants where the formula has a plan."""
    row: dict[str, Any] = {
        "outcome": REFUSED,
        "reason": error.reason if isinstance(error, RefusedGait) else BAD_PARAMETER,
        "cause": one_line(error),
    }
    if parameters is not None and not (isinstance(error, RefusedGait) and error.kind == "mathematical"):
        try:
            plan = plan_gait(parameters.gait, parameters.body.mass)
        except AmpmError:
            return row
        row |= plan_columns(plan, with_motion=False)
    return row


def crashed_columns(error: BaseException) -> dict[str, Any]:
    """A crash."""
    return {"outcome": CRASHED, "reason": type(error).__name__, "cause": one_line(error) or None}


def worker_died_columns(attempts: int) -> dict[str, Any]:
    """A run that took its worker's process along every time."""
    return {
        "outcome": CRASHED,
        "reason": WORKER_DIED,
        "cause": f"the worker's process died in this run, {attempts} times out of {attempts}",
    }


def timed_out_columns(wall_clock: float) -> dict[str, Any]:
    """A run that hung."""
    return {
        "outcome": TIMED_OUT,
        "reason": "wall_clock",
        "cause": f"the run had not ended after limits.wall_clock = {wall_clock:g} s",
    }


def one_line(error: BaseException) -> str:
    """An error's text without what differs from process to process: addresses and folders."""
    text = " ".join(str(error).split())
    text = _PATH.sub(r"\1", _ADDRESS.sub("0x...", text))
    return text if len(text) <= _CAUSE_LENGTH else text[: _CAUSE_LENGTH - 3] + "..."


@cache
def _constant_environment() -> Mapping[str, Any]:
    """Of this process."""
    found = describe_environment()
    row = {f"environment_{name}": found[name] for name in ("revision", "modified", "python", "platform")}
    row |= {version_column(name): version for name, version in found["versions"].items()}
    return {**row, "environment_processor": found["processor"], "environment_code": code_hash()}


def environment_columns(worker: str | None, attempts: int, time: str) -> dict[str, Any]:
    """What the run ran on.

    Args:
        worker: name of the worker, if there was one.
        attempts: times the run was begun.
        time: when it ended.
    """
    return {
        **_constant_environment(),
        "environment_time": time,
        "environment_worker": worker,
        "environment_attempts": attempts,
        "environment_memory_peak": memory_peak(),
    }

"""Values of the built-in metrics that are neither an error of a signal nor a cost; see ``metrics.csv``."""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from ampm.body.limits import CLEARANCE
from ampm.geometry import Array, Flags
from ampm.walk import UNSOLVED
from validation.judge.compare import Comparison, push_rows, signal_pairs
from validation.measure.measure import largest
from validation.trial.record import SimulationRecord

_ONE_STEP = 1.9  # most RMS error of a later step over its limit: with noise, steps vary by 1.8 [1]


def rms(values: Array) -> float:
    """Root mean square of the finite values, NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else math.nan


def _distances(one: Array, other: Array, walk: Comparison) -> Array:
    """Distance of two vectors where they are judged, shape (n,)."""
    return np.asarray(np.linalg.norm((one - other)[walk.inside], axis=1))


def _shortfall(walk: Comparison) -> float | None:
    """How much is missing to the least clearance [m]; None if the body's shapes are not known."""
    clearance = walk.costs["margins"]["clearance"].value
    return None if math.isnan(clearance) else max(0.0, CLEARANCE - clearance)


def _velocity_error(walk: Comparison, part: int) -> float | None:
    """Distance of one part of the mean velocity from the commanded one; None where none was commanded."""
    velocity = walk.costs.get("velocity")
    return None if velocity is None else abs(velocity["measured"][part] - velocity["commanded"][part])


def _steps_missing(walk: Comparison) -> float | None:
    """1 without a touchdown on a way over a foot or 0.5 rad, NaN on a shorter one; None without a command."""
    if (command := walk.plan.command) is None:
        return None
    vx, vy, wz = command.at(math.inf)
    way = max(math.hypot(vx, vy) / walk.scales["foot_length"], abs(wz) / 0.5)  # in a second [1]
    way *= command.duration - command.settling
    return 0.0 if walk.record.outcome.steps_completed or not way else 1.0 if way > 1.0 else math.nan


def _drift(walk: Comparison) -> float | None:
    """Drift in a step [m]; None for less than three steps, or where the first or last was not measured."""
    ends = walk.plan.contacts.step_ends
    ends = ends[ends <= walk.time[-1] + 2.0 * walk.record.time_step] if walk.time.size else ends[:0]
    if len(ends) < 3:
        return None
    error = (walk.measured.com - walk.sample.com)[:, :2]
    second = error[(walk.time >= ends[0]) & (walk.time < ends[1])]
    last = error[(walk.time >= ends[-2]) & (walk.time < ends[-1])]
    if not (len(second) and len(last)):
        return None
    return float(np.linalg.norm(last.mean(axis=0) - second.mean(axis=0))) / (len(ends) - 2)


def _zmp_gaps(walk: Comparison) -> Array:
    """Distance of both measured ZMPs in the window, shape (n,) [m]; NaN where there is none."""
    return _distances(walk.measured.zmp, walk.measured.zmp_momentum, walk)


def _equations(walk: Comparison, which: str) -> float | None:
    """Defect of the equations of motion, relative to the median change of velocity; None if not checked.

    The velocity of a body that stands still changes by rounding only: a thousandth of a fall's counts.
    """
    found, record = walk.measured.self_checks.equations, walk.record
    if found is None:
        return None
    return float(getattr(found, which)) / max(found.change, 1e-3 * record.gravity * record.time_step)


def has_qp(record: SimulationRecord) -> bool:
    """Whether the controller reported anything of a QP; otherwise nothing of a QP applies to it."""
    return bool(record.qp_status.any() or np.isfinite([record.qp_residual, record.qp_time]).any())


def _unsupported(walk: Comparison) -> float:
    """Instants in the window that have no ZMP; NaN if it was never measured, as in a log of forces."""
    known: Flags = np.isfinite(walk.measured.zmp[:, 0])
    return float(np.count_nonzero(~known[walk.inside])) if known.any() else math.nan


def _recovery_time(walk: Comparison) -> float | None:
    """Longest time from the end of a push until all errors keep their limits [s].

    They keep them from an instant on if they do so both in the step that follows and in all that remains, up
    to the next push or to the end of the walk, and no later step exceeds 1.9 times an RMS limit. Pushes less
    than a step apart are one, and a force that never ends is none. Infinite if the errors do not keep their
    limits within its own limit, or did not from the begin to the first push, if that was a step or more; NaN
    if the walk ends before that; None if nothing pushed the body, or without a plan.
    """
    record = walk.record
    if walk.plan.command is not None or not (pushes := push_rows(record)):
        return None
    (first, start), *others = pushes
    duration = float(np.median(np.diff(walk.plan.contacts.step_ends, prepend=0.0)))
    step, judged = max(round(duration / record.time_step), 1), int(walk.inside.argmax())
    pairs = signal_pairs(walk.sample, walk.measured, record)
    errors = {name: np.abs(value - reference) for name, (value, reference) in pairs.items()}
    kept = partial(_kept, errors, walk.recovery_limits)
    if first - judged >= step and not kept(judged, first, first - judged)[0]:
        return math.inf
    longest = 0
    for begin, end in others:
        if begin - start < step:
            start = end
        elif (recovered := np.flatnonzero(kept(start, begin, step))).size:
            longest, start = max(longest, int(recovered[0])), end
    if (recovered := np.flatnonzero(kept(start, record.steps, step))).size:
        return max(longest, int(recovered[0])) * record.time_step
    left = record.time_step * (record.steps - start - step)
    return math.nan if left < walk.recovery_limits.get("recovery_time", math.inf) else math.inf


def _kept(errors: Mapping[str, Array], limits: Mapping[str, float], begin: int, end: int, rows: int) -> Flags:
    """Whether errors keep their limits, by the begin of a window of some rows, in it and to the end."""
    within = np.ones(max(end - begin - rows + 1, 0), dtype=bool)
    lengths = end - begin - np.arange(within.size)
    for name, error in errors.items() if within.size else ():
        of = error[begin:end]
        broken = ~(of <= limits.get(f"{name}_maximum", math.inf))
        squares = np.where(broken, 0.0, of) ** 2
        sums = np.cumsum(np.vstack([np.zeros(2), np.column_stack([broken, squares])]), axis=0)
        (count, rest), mean = (sums[-1] - sums[:-rows]).T, limits.get(f"{name}_rmse", math.inf) ** 2
        square = (sums[rows:, 1] - sums[:-rows, 1]) / rows
        later = np.logical_and.accumulate(square[::-1] <= _ONE_STEP**2 * mean)[::-1]
        within &= (count == 0) & (square <= mean) & later & (rest <= lengths * mean)
    return within


COMPUTED: Mapping[str, Callable[[Comparison], float | None]] = {
    "recovery_time": _recovery_time,
    "stride_duration_error": lambda walk: None,  # of logs alone, see `judge_log`
    "slip_maximum": lambda walk: (  # None where none was measured, as in a log
        None if np.isnan(walk.measured.slip).all() else largest(walk.measured.slip[walk.inside])
    ),
    "clearance_shortfall": _shortfall,
    "speed_excess": lambda walk: (  # None for a body without such limits
        max(0.0, walk.costs["margins"]["speed"].value - 1.0) if "speed" in walk.costs["margins"] else None
    ),
    "velocity_x_error": lambda walk: _velocity_error(walk, 0),
    "velocity_y_error": lambda walk: _velocity_error(walk, 1),
    "yaw_rate_error": lambda walk: _velocity_error(walk, 2),
    "steps_missing": _steps_missing,
    "drift_per_step": _drift,
    "plan_newton_residual": lambda walk: max(plan.newton_residual for plan in walk.followed.plans),
    "plan_moved_zmp_maximum": lambda walk: (
        None if walk.first is None else largest(_distances(walk.valid.zmp, walk.first.zmp, walk))
    ),
    "plan_changes": lambda walk: None if walk.first is None else float(walk.followed.changes),
    "zmp_agreement_rmse": lambda walk: rms(_zmp_gaps(walk)),
    "zmp_agreement_maximum": lambda walk: largest(_zmp_gaps(walk)),
    "force_agreement_rmse": lambda walk: rms(
        _distances(walk.measured.force, walk.measured.momentum_force, walk)
    ),
    "impulse_residual": lambda walk: abs(walk.measured.self_checks.impulse_residual),
    "com_agreement_maximum": lambda walk: walk.measured.self_checks.com_agreement,
    "angular_momentum_agreement_maximum": lambda walk: walk.measured.self_checks.angular_momentum_agreement,
    "equations_defect_median": lambda walk: _equations(walk, "median"),
    "equations_defect_maximum": lambda walk: _equations(walk, "largest"),
    "failed_qp": lambda walk: (
        float(np.count_nonzero(walk.record.qp_status == UNSOLVED)) if has_qp(walk.record) else None
    ),
    "unsupported_instants": _unsupported,
}
"""Metric to its value; None if the walk has no such metric."""

"""Cost of a walk and its margins to every limit of body and floor.

Units and meanings are listed in :mod:`validation.judge.metrics`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.geometry import polygon_margin
from validation.trial.record import state_steps
from validation.trial.spill import blocks, zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Gaps
    from ampm.description import BodyDescription
    from ampm.geometry import Array
    from ampm.planner.centroidal import PlanSample
    from validation.measure.measure import MeasuredGait
    from validation.store.record import StoredRecord
    from validation.trial.followed import Followed
    from validation.trial.record import SimulationRecord
    from validation.trial.shapes import Shapes

    Rows = NDArray[np.bool_]

LOADED = 0.05
"""Share of body weight from which a foot's friction counts [1]: the ratio of two small forces is noise."""
SLIDING = 0.99
"""Share of the floor's friction from which a point slides [1]."""
SATURATED = 0.999
"""Share of its limit from which a motor counts as saturated [1]."""

CLEARANCE_ROWS = 2
"""States on disk, 10 ms apart, from one posture of which the clearance is measured to the next: at 10 m/s^2
half a millimetre is lost in 20 ms."""


@dataclass(frozen=True)
class Extreme:
    """The worst value of a quantity, and where and when it occurred.

    Attributes:
        value: in the unit that the owner states; NaN if nothing was measured.
        time: [s], None if nothing was measured.
        where: joint, foot or both parts of the body, empty if there is none to name.
    """

    value: float
    time: float | None = None
    where: str = ""


def feedback_effort(record: SimulationRecord, sample: PlanSample, rows: Rows) -> dict[str, Any]:
    """RMS of command minus plan over ``rows``, shape (K,): the controller's correction of the formula.

    Returns:
        Components of ``com_acceleration`` [m/s^2], ``force`` [N], ``angular_momentum`` [N m s], ``zmp`` and
        ``com`` [m]; largest components ``force_maximum`` and ``zmp_maximum``.
    """
    force = (record.command_force - sample.force)[rows]
    momentum = (record.command_angular_momentum[:, :2] - sample.angular_momentum)[rows]
    zmp = (record.command_zmp - sample.zmp)[rows]
    com = (record.command_com - sample.com)[rows]
    return {
        "com_acceleration": _rms_columns(force / record.mass),
        "force": _rms_columns(force),
        "angular_momentum": _rms_columns(momentum),
        "zmp": _rms_columns(zmp),
        "com": _rms_columns(com),
        "force_maximum": _largest(force),
        "zmp_maximum": _largest(zmp),
    }


def margins(
    followed: Followed,
    sample: PlanSample,
    record: SimulationRecord,
    measured: MeasuredGait,
    description: BodyDescription | None = None,
    shapes: Shapes | None = None,
) -> dict[str, Any]:
    """Distances to the limits of body and floor, over the whole record, first step included.

    Args:
        followed: the plans that were walked, one after another.
        sample: the plan then valid at the record's steps.
        record: the run.
        measured: its measurement.
        description: names the knees; without it ``knee`` is NaN.
        shapes: the body's; without them ``clearance`` is NaN.

    Returns:
        :class:`Extreme` values, the share ``saturated``, the largest share of each motor's limit
        ``torque_by_joint`` [1], and the floor's coefficient ``friction_available`` [1]; ``speed``, a share of
        a joint's limit [1], of a body with speed limits only.
    """
    time, joints, feet = measured.time, record.joint_names, ("left", "right")
    peak, saturated = np.zeros(len(joints)), 0

    def use(part: slice) -> Array:
        return np.asarray(np.abs(record.torque[part]) / record.torque_limit)

    def room(part: slice) -> Array:
        q, (low, high) = record.hinge_q[part], record.joint_range.T
        return np.asarray(np.minimum(q - low, high - q))

    for part in blocks(record.steps):
        share = use(part)
        peak = np.maximum(peak, share.max(axis=0))
        saturated += int(np.count_nonzero((share >= SATURATED).any(axis=1)))
    legs = () if description is None else description.legs
    knees = tuple(leg.knee for leg in legs if leg.knee in joints)
    flexion = [
        leg.knee_sign * (record.hinge_q[:, joints.index(leg.knee)] - leg.straight_knee)
        for leg in legs
        if leg.knee in joints
    ]
    knee_q = np.stack(flexion, axis=1) if flexion else np.zeros((len(record.hinge_q), 0))
    foot_ratio, net_ratio = (
        _ratio(force, LOADED * measured.weight) for force in (measured.foot_force, measured.force)
    )
    planned = Extreme(math.nan)
    if time.size:
        planned = Extreme(*followed.least_zmp_margin(time))
    sliding = _sliding_weight(record)
    reached = np.empty(record.steps)
    for part in blocks(record.steps):
        points, loaded = record.point_position[part, :, :2], measured.point_contact[part]
        reached[part] = polygon_margin(points, loaded, sample.zmp[part])
    fastest = {} if description is None else dict(description.speed_limits)
    columns = [joints.index(name) for name in fastest]

    def rate(part: slice) -> Array:
        return np.asarray(np.abs(record.hinge_qd[part][:, columns]) / np.array(list(fastest.values())))

    speed = {"speed": _extreme_of(rate, record.time, tuple(fastest), largest=True)} if fastest else {}
    return {
        **speed,
        "torque": _extreme_of(use, time, joints, largest=True),
        "torque_by_joint": dict(zip(joints, peak.tolist(), strict=True)),
        "saturated": saturated / time.size if time.size and joints else math.nan,
        "friction": _extreme(foot_ratio, time, feet, largest=True),
        "friction_net": _extreme(net_ratio[:, None], time, largest=True),
        "friction_available": record.friction,
        "joint": _extreme_of(room, record.time, joints),
        "knee": _extreme(knee_q, record.time, knees),
        "clearance": Extreme(math.nan) if shapes is None or not len(shapes) else _clearance(record, shapes),
        "plan_polygon": planned,
        "plan_in_measured_polygon": _extreme(reached[:, None], time),
        "measured_polygon": _extreme(measured.polygon_margin[:, None], time),
        "sliding_weight": _extreme(sliding[:, None], time, largest=True),
        "sliding_time": Extreme(math.nan)
        if np.isnan(sliding).all()
        else _longest(sliding > LOADED, time, record.time_step),
        "penetration": _extreme(measured.penetration, time, feet, largest=True),
    }


def energy(record: SimulationRecord, rows: Rows) -> dict[str, float]:
    """Work of the motors over ``rows``, shape (K,): torque of the step times the mean joint rate over it.

    The mechanical cost of transport is that of Collins, Ruina, Tedrake and Wisse, Science 307 (2005), over
    the length of the COM's path on the floor.
    """
    names = ("positive_work", "negative_work", "distance", "cost_of_transport", "mean_power")
    used = np.flatnonzero(rows)
    if used.size == 0 or not record.joint_names:
        return dict.fromkeys(names, math.nan)
    positive, negative = (
        float(_motors(record, used, part).sum() * record.time_step) for part in (np.maximum, np.minimum)
    )
    moves = np.diff(record.com[used[0] : used[-1] + 2, :2], axis=0)
    distance = float(np.sqrt((moves * moves).sum(axis=1)).sum())
    transport = positive / (record.mass * record.gravity * distance) if distance > 0.0 else math.nan
    mean_power = positive / (used.size * record.time_step)
    return dict(zip(names, (positive, negative, distance, transport, mean_power), strict=True))


def _motors(record: SimulationRecord, steps: NDArray[np.intp], part: np.ufunc) -> Array:
    """Positive or negative part of every motor's power in some steps, shape (n, nu) [W]."""
    power = zeros((steps.size, len(record.joint_names)))
    for rows in blocks(steps.size):
        k = steps[rows]
        rate = 0.5 * (record.hinge_qd[k + 1] + record.hinge_qd[k])
        power[rows] = part(record.torque[k] * rate, 0.0)
    return power


def clearance_over_time(record: SimulationRecord | StoredRecord, shapes: Shapes) -> tuple[Array, Gaps]:
    """Instants [s], :data:`CLEARANCE_ROWS` states on disk apart, and the closest parts of the body then."""
    instants = record.state_rows
    rows = instants % (CLEARANCE_ROWS * state_steps(record.time_step)) == 0
    return instants[rows] * record.time_step, shapes.recorded_gaps(record.q[rows])


def _clearance(record: SimulationRecord, shapes: Shapes) -> Extreme:
    """Least distance of two parts of the body."""
    time, gaps = clearance_over_time(record, shapes)
    closest = int(gaps.distance.argmin())
    return Extreme(float(gaps.distance[closest]), float(time[closest]), gaps.parts[closest])


def _sliding_weight(record: SimulationRecord) -> Array:
    """Share of the weight that rests on points at the floor's friction, shape (K,) [1]."""
    share = np.full(record.steps, np.nan)
    if not np.isfinite(record.friction):
        return share
    for part in blocks(record.steps):
        along_x, along_y, normal = np.moveaxis(record.point_force[part], 2, 0)
        slides = np.hypot(along_x, along_y) > SLIDING * record.friction * normal
        share[part] = np.where(slides, normal, 0.0).sum(axis=1) / (record.mass * record.gravity)
    return share


def _longest(on: NDArray[np.bool_], time: Array, step: float) -> Extreme:
    """Longest time [s] for which a condition held without a break, and when that began."""
    edges = np.flatnonzero(np.diff(on, prepend=False, append=False))
    begin, lasted = edges[::2], edges[1::2] - edges[::2]
    if not lasted.size:
        return Extreme(0.0)
    longest = int(lasted.argmax())
    return Extreme(float(lasted[longest] * step), float(time[begin[longest]]))


def _ratio(force: Array, least: float) -> Array:
    """Tangential over normal force, NaN where the normal force is below ``least``; drops the last axis."""
    normal = np.where(force[..., 2] >= least, force[..., 2], np.nan)
    return np.hypot(force[..., 0], force[..., 1]) / normal


def _extreme(values: Array, time: Array, names: tuple[str, ...] = (), *, largest: bool = False) -> Extreme:
    """Largest or smallest entry of (N, M), with its time and the name of its column."""
    known = np.isfinite(values)
    if not known.any():
        return Extreme(math.nan)
    filled = np.where(known, values, -np.inf if largest else np.inf)
    flat = int(filled.argmax() if largest else filled.argmin())
    row, column = divmod(flat, values.shape[1])
    return Extreme(float(values[row, column]), float(time[row]), names[column] if names else "")


def _extreme_of(
    values: Callable[[slice], Array], time: Array, names: tuple[str, ...], *, largest: bool = False
) -> Extreme:
    """The same of values that are computed a part at a time."""
    worst = Extreme(math.nan)
    for part in blocks(time.size):
        found = _extreme(values(part), time[part], names, largest=largest)
        if math.isnan(worst.value) or (found.value > worst.value if largest else found.value < worst.value):
            worst = found
    return worst


def _rms_columns(values: Array) -> tuple[float, ...]:
    if values.shape[0] == 0:
        return (math.nan,) * values.shape[1]
    return tuple(float(value) for value in np.sqrt(np.mean(values * values, axis=0)))


def _largest(values: Array) -> float:
    return float(np.abs(values).max()) if values.size else math.nan

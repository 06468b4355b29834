"""Cost of a walk and its margins to every limit of body and floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ampm.geometry import polygon_margin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from ampm.planner.centroidal import PlanSample
    from ampm.walk import WalkPlan
    from validation.measure.measure import MeasuredGait
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]
    Rows = NDArray[np.bool_]

LOADED = 0.05
"""Share of body weight from which a foot's friction counts [1]: the ratio of two tiny forces is noise."""
SATURATED = 0.999
"""Share of its limit from which a motor counts as saturated [1]."""


@dataclass(frozen=True)
class FeedbackEffort:
    """Command minus plan: how much the controller had to add to what the formula asks for.

    Attributes:
        com_acceleration: RMS of (command force - plan force) / m, x, y, z [m/s^2].
        force: RMS of command force - plan force, x, y, z [N].
        angular_momentum: RMS of command - plan, x, y [N m s].
        zmp: RMS of command - plan, x, y [m].
        com: RMS of command - plan, x, y, z [m].
        force_maximum: largest component of command force - plan force [N].
        zmp_maximum: largest component of command ZMP - plan ZMP [m].
    """

    com_acceleration: tuple[float, ...]
    force: tuple[float, ...]
    angular_momentum: tuple[float, ...]
    zmp: tuple[float, ...]
    com: tuple[float, ...]
    force_maximum: float
    zmp_maximum: float


@dataclass(frozen=True)
class Extreme:
    """The worst value of a quantity, and where and when it occurred.

    Attributes:
        value: in the unit that the owner states.
        time: [s], None if nothing was measured.
        where: joint or foot, empty if there is none to name.
    """

    value: float
    time: float | None = None
    where: str = ""


@dataclass(frozen=True)
class Margins:
    """Distance to the limits of body and floor, over the whole record, first step included.

    Attributes:
        torque: largest share of a motor's limit that was used [1].
        torque_by_joint: the same for every joint [1].
        saturated: share of the steps in which some motor was at its limit [1].
        friction: largest tangential over normal force of either foot, while it carries :data:`LOADED` [1].
        friction_net: the same for the net force [1].
        friction_available: the floor's coefficient [1].
        joint: smallest distance of a joint to its range, negative beyond it [rad].
        knee: smallest knee flexion [rad]; NaN without a body description.
        plan_polygon: smallest distance of the planned ZMP into the polygon planned in contact [m].
        plan_in_measured_polygon: of the planned ZMP into the polygon of the points that carried force [m].
        measured_polygon: of the measured ZMP into that polygon [m].
        slip: longest way a foot slid in one stance [m].
        penetration: deepest sole point [m].
    """

    torque: Extreme
    torque_by_joint: dict[str, float]
    saturated: float
    friction: Extreme
    friction_net: Extreme
    friction_available: float
    joint: Extreme
    knee: Extreme
    plan_polygon: Extreme
    plan_in_measured_polygon: Extreme
    measured_polygon: Extreme
    slip: Extreme
    penetration: Extreme


@dataclass(frozen=True)
class Energy:
    """Mechanical work of the motors, without the first step.

    Attributes:
        positive_work: [J].
        negative_work: [J], negative.
        distance: way of the COM along x [m].
        cost_of_transport: positive work over weight times distance [1]; the mechanical cost of transport of
            Collins, Ruina, Tedrake and Wisse, Science 307 (2005).
        mean_power: positive work over time [W].
    """

    positive_work: float
    negative_work: float
    distance: float
    cost_of_transport: float
    mean_power: float


def feedback_effort(record: SimulationRecord, sample: PlanSample, rows: Rows) -> FeedbackEffort:
    """Command minus plan over ``rows``, shape (K,)."""
    force = (record.command_force - sample.force)[rows]
    momentum = (record.command_angular_momentum[:, :2] - sample.angular_momentum)[rows]
    zmp = (record.command_zmp - sample.zmp)[rows]
    return FeedbackEffort(
        com_acceleration=_rms_columns(force / record.mass),
        force=_rms_columns(force),
        angular_momentum=_rms_columns(momentum),
        zmp=_rms_columns(zmp),
        com=_rms_columns((record.command_com - sample.com)[rows]),
        force_maximum=_largest(force),
        zmp_maximum=_largest(zmp),
    )


def margins(
    plan: WalkPlan,
    sample: PlanSample,
    record: SimulationRecord,
    measured: MeasuredGait,
    description: BodyDescription | None = None,
) -> Margins:
    """Distances to all limits.

    Args:
        plan: the plan that was walked.
        sample: the plan at the record's steps.
        record: the run.
        measured: its measurement.
        description: names the knees; without it ``knee`` is NaN.
    """
    time = measured.time
    use = np.abs(record.torque) / record.torque_limit
    low = record.hinge_q - record.joint_range[:, 0]
    high = record.joint_range[:, 1] - record.hinge_q
    legs = () if description is None else description.legs
    knees = tuple(leg.knee for leg in legs if leg.knee in record.joint_names)
    knee_q = record.hinge_q[:, [record.joint_names.index(name) for name in knees]]
    feet = ("left", "right")
    foot_ratio, net_ratio = (
        _ratio(force, LOADED * measured.weight) for force in (measured.foot_force, measured.force)
    )
    planned = Extreme(float("nan"))
    if time.size:
        planned = Extreme(*plan.least_zmp_margin(min(float(time[-1]), plan.duration)))
    reached = polygon_margin(record.point_position[:, :, :2], measured.point_contact, sample.zmp)
    return Margins(
        torque=_extreme(use, time, record.joint_names, largest=True),
        torque_by_joint=dict(zip(record.joint_names, use.max(axis=0, initial=0.0).tolist(), strict=True)),
        saturated=float((use >= SATURATED).any(axis=1).mean()) if time.size else float("nan"),
        friction=_extreme(foot_ratio, time, feet, largest=True),
        friction_net=_extreme(net_ratio[:, None], time, largest=True),
        friction_available=record.friction,
        joint=_extreme(np.minimum(low, high), record.time, record.joint_names),
        knee=_extreme(knee_q, record.time, knees),
        plan_polygon=planned,
        plan_in_measured_polygon=_extreme(reached[:, None], time),
        measured_polygon=_extreme(measured.polygon_margin[:, None], time),
        slip=_extreme(measured.slip, time, feet, largest=True),
        penetration=_extreme(measured.penetration, time, feet, largest=True),
    )


def energy(record: SimulationRecord, rows: Rows) -> Energy:
    """Work of the motors over ``rows``, shape (K,): torque of the step times the mean joint rate over it."""
    rate = 0.5 * (record.hinge_qd[1:] + record.hinge_qd[:-1])
    power = (record.torque * rate)[rows]
    used = np.flatnonzero(rows)
    if used.size == 0:
        return Energy(*([float("nan")] * 5))
    positive = float(np.maximum(power, 0.0).sum() * record.time_step)
    negative = float(np.minimum(power, 0.0).sum() * record.time_step)
    distance = float(record.com[used[-1] + 1, 0] - record.com[used[0], 0])
    weight = record.mass * record.gravity
    return Energy(
        positive_work=positive,
        negative_work=negative,
        distance=distance,
        cost_of_transport=positive / (weight * distance) if distance > 0.0 else float("nan"),
        mean_power=positive / (used.size * record.time_step),
    )


def _ratio(force: Array, least: float) -> Array:
    """Tangential over normal force, NaN where the normal force is below ``least``; drops the last axis."""
    normal = np.where(force[..., 2] >= least, force[..., 2], np.nan)
    return np.hypot(force[..., 0], force[..., 1]) / normal


def _extreme(values: Array, time: Array, names: tuple[str, ...] = (), *, largest: bool = False) -> Extreme:
    """Largest or smallest entry of (N, M), with its time and the name of its column."""
    known = np.isfinite(values)
    if not known.any():
        return Extreme(float("nan"))
    filled = np.where(known, values, -np.inf if largest else np.inf)
    flat = int(filled.argmax() if largest else filled.argmin())
    row, column = divmod(flat, values.shape[1])
    return Extreme(float(values[row, column]), float(time[row]), names[column] if names else "")


def _rms_columns(values: Array) -> tuple[float, ...]:
    if values.shape[0] == 0:
        return (float("nan"),) * values.shape[1]
    return tuple(float(value) for value in np.sqrt(np.mean(values * values, axis=0)))


def _largest(values: Array) -> float:
    return float(np.abs(values).max()) if values.size else float("nan")

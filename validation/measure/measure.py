"""Measurement of a walk from its record alone, without the plan.

The ZMP is measured twice. Once as the centre of pressure of the logged contact forces; once from the rates of
linear and angular momentum, which Pinocchio computes from the recorded ``q`` and ``qd`` only. The second uses
no force and no acceleration of the simulator, so the two disagree as soon as one contact is missing from the
log.
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array, polygon_margin
from validation.measure.equations import Equations, ToPinocchio, check_equations
from validation.trial.passive import PassiveJoints
from validation.trial.record import SimulationRecord, support_height
from validation.trial.spill import blocks

LEAST_SUPPORT = 0.01
"""Share of body weight below which there is no ZMP: the quotient of two vanishing numbers is meaningless."""


@dataclass(frozen=True)
class SelfChecks:
    """Checks of the instrument over the whole run that rows of a measurement do not tell."""

    com_agreement: float  # largest distance between the simulator's COM and Pinocchio's [m]
    angular_momentum_agreement: float  # largest distance between the two momenta about the COM [N m s]
    # vertical impulse over the run, less weight and gain of momentum, over the weight's impulse [1]. A
    # standing body presses with exactly its weight; a walking one with its weight and the rate of its
    # momentum
    impulse_residual: float
    # the equations of motion of the recorded steps; None if they were not checked
    equations: Equations | None = None


@dataclass(frozen=True)
class MeasuredGait(Brief):
    """Measured signals of one run, row k for step k ([t_k, t_(k+1)]); world frame, floor at z = 0.

    Forces and torques act on the body. Where fewer than :data:`LEAST_SUPPORT` of the weight are carried, both
    ZMPs are NaN.
    """

    time: Array  # t_k, shape (K,) [s]
    foot_force: Array  # sum over each foot's sole points, left first, shape (K, 2, 3) [N]
    foot_torque: Array  # their moment about the world origin, shape (K, 2, 3) [N m]
    force: Array  # net ground force, shape (K, 3) [N]
    torque: Array  # net moment about the world origin, shape (K, 3) [N m]
    zmp: Array  # from contact forces, on the level plane of height `floor`, shape (K, 2) [m]
    zmp_momentum: Array  # from momentum rates and external forces, on the same plane, shape (K, 2) [m]
    # height of the floor under the sole points, averaged by their vertical forces, shape (K,) [m]
    floor: Array
    com: Array  # the simulator's COM at t_k, shape (K, 3) [m]
    com_pin: Array  # Pinocchio's COM at t_k, shape (K, 3) [m]
    com_velocity: Array  # Pinocchio's COM velocity at t_k, shape (K, 3) [m/s]
    com_acceleration: Array  # forward difference of `com_velocity` over the step, shape (K, 3) [m/s^2]
    # ground force by the rate of momentum, `m (com_acceleration + g e_z)` less what else pushed the body,
    # shape (K, 3) [N]
    momentum_force: Array
    angular_momentum: Array  # the simulator's, about the COM at t_k, shape (K, 3) [N m s]
    # forward difference of Pinocchio's over the step, less the moment of what else pushed the body,
    # shape (K, 3) [N m]
    angular_momentum_rate: Array
    foot_contact: NDArray[np.bool_]  # any sole point of the foot carries force, shape (K, 2), bool
    point_contact: NDArray[np.bool_]  # the sole point carries force, shape (K, P), bool
    foot_position: Array  # reference points of the soles at t_k, shape (K, 2, 3) [m]
    # integral of the force-weighted mean horizontal speed of the loaded points since the foot last touched
    # down, shape (K, 2) [m]
    slip: Array
    penetration: Array  # deepest loaded point of each foot, shape (K, 2) [m]
    # distance of `zmp` to the edge of the loaded points' convex hull, inside positive, shape (K,) [m]
    polygon_margin: Array
    mass: float  # total mass [kg]
    gravity: float  # g [m/s^2]
    time_step: float  # dt [s]
    self_checks: SelfChecks  # agreement of the independent measurements

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def weight(self) -> float:
        """Body weight m g [N]."""
        return self.mass * self.gravity


def measure(
    record: SimulationRecord,
    model: pin.Model,
    to_pinocchio: ToPinocchio,
    passive: PassiveJoints | None = None,
) -> MeasuredGait:
    """Measure a run.

    The force of step k acts at q_k and turns v_k, the velocity that brought the body from q_(k-1) to q_k,
    into v_(k+1), which carries it on from q_k to q_(k+1). Each velocity is paired with the configuration that
    it departs from: the momentum rate of row k is the difference of the momenta of (q_k, v_(k+1)) and
    (q_(k-1), v_k), the rate over the interval in which the force acts. Momenta of the recorded pairs (q_k,
    v_k) would be off by half a step. The moment is taken about the COM at t_k, where the contacts of step k
    were evaluated.

    Args:
        record: the run.
        model: Pinocchio's model of the same body, free-flyer root.
        to_pinocchio: turns MuJoCo's (q, qd), shape (N, nq) and (N, nv), into Pinocchio's (q, v).
        passive: springs and dampers of the body, for the equations of motion; without them these are not
            checked, and neither are they if a joint has dry friction, whose force is not recorded.

    Raises:
        InputError: the model is not of the recorded body.
    """
    mass, gravity, dt = record.mass, record.gravity, record.time_step
    model_mass = float(pin.computeTotalMass(model))
    if abs(model_mass - mass) > 1e-9 * mass:
        raise InputError(
            f"the model weighs {model_mass:.9g} kg, the recorded body {mass:.9g} kg; "
            "measure with the model that was simulated"
        )
    steps = record.steps
    weight = mass * gravity
    least = LEAST_SUPPORT * weight

    soles = _soles(record)
    force, torque = soles.force.sum(axis=1), soles.torque.sum(axis=1)
    zmp = centre_of_pressure(force, torque, least, soles.floor)

    com_pin, com_velocity, momentum = _centroidal(model, to_pinocchio, record.q, record.qd)
    first = _step_back(record.q[:1], record.qd[:1], dt)
    starts = [
        _centroidal(model, to_pinocchio, q, qd)
        for q, qd in ((first, record.qd[:1]), (record.q[:-1], record.qd[1:]))
    ]
    departing_velocity, departing_momentum = (
        np.concatenate(parts) for parts in tuple(zip(*starts, strict=True))[1:]
    )
    com_acceleration = np.diff(departing_velocity, axis=0) / dt
    momentum_rate = np.diff(departing_momentum, axis=0) / dt
    momentum_force = mass * (com_acceleration + np.array([0.0, 0.0, gravity]))
    lifted = 0.0
    if record.external_segments:
        pushes = record.external_force.sum(axis=1)
        lever = record.external_position - com_pin[:-1, None]
        moments = record.external_moment + np.cross(lever, record.external_force)
        momentum_force, momentum_rate = momentum_force - pushes, momentum_rate - moments.sum(axis=1)
        lifted = pushes[:, 2].sum() * dt
    impulse = force[:, 2].sum() * dt
    gained = mass * (com_velocity[-1, 2] - com_velocity[0, 2])
    checks = SelfChecks(
        com_agreement=_largest(np.linalg.norm(record.com - com_pin, axis=1)),
        angular_momentum_agreement=_largest(np.linalg.norm(record.angular_momentum - momentum, axis=1)),
        impulse_residual=float((impulse + lifted - gained) / (weight * steps * dt) - 1.0)
        if steps
        else float("nan"),
        equations=None
        if passive is None or passive.friction.any()
        else check_equations(record, model, passive, to_pinocchio),
    )
    return MeasuredGait(
        time=record.time[:-1],
        foot_force=soles.force,
        foot_torque=soles.torque,
        force=force,
        torque=torque,
        zmp=zmp,
        zmp_momentum=zmp_from_momentum(com_pin[:-1], momentum_force, momentum_rate, least, soles.floor),
        floor=soles.floor,
        com=record.com[:-1],
        com_pin=com_pin[:-1].copy(),
        com_velocity=com_velocity[:-1].copy(),
        com_acceleration=com_acceleration,
        momentum_force=momentum_force,
        angular_momentum=record.angular_momentum[:-1],
        angular_momentum_rate=momentum_rate,
        foot_contact=soles.foot_contact,
        point_contact=soles.point_contact,
        foot_position=record.foot_position[:-1],
        slip=soles.slip,
        penetration=soles.penetration,
        polygon_margin=_polygon_margin(record, soles.point_contact, zmp),
        mass=mass,
        gravity=gravity,
        time_step=dt,
        self_checks=checks,
    )


def zmp_from_momentum(
    com: Array, force: Array, angular_momentum_rate: Array, least: float, floor: Array | float = 0.0
) -> Array:
    """ZMP on a level floor from momentum rates, shape (N, 2) [m]; NaN where ``force_z < least``.

    ``p_x = x - (z F_x + M_y) / F_z`` and ``p_y = y - (z F_y - M_x) / F_z`` hold for any motion whose only
    external forces are gravity and the floor's, with F the net ground force and M the rate of angular
    momentum about the COM; the moment of any other force is to be subtracted from it.

    Args:
        com: shape (N, 3) [m].
        force: net ground force m (a + g e_z), shape (N, 3) [N].
        angular_momentum_rate: about the COM, shape (N, 2) or (N, 3) [N m].
        least: smallest vertical force for which there is a ZMP [N].
        floor: its height, from which z counts, shape (N,) [m].
    """
    z = com[:, 2] - floor
    vertical = np.where(force[:, 2] >= least, force[:, 2], np.nan)
    x = com[:, 0] - (z * force[:, 0] + angular_momentum_rate[:, 1]) / vertical
    y = com[:, 1] - (z * force[:, 1] - angular_momentum_rate[:, 0]) / vertical
    return np.stack([x, y], axis=1)


def _step_back(q: Array, qd: Array, dt: float) -> Array:
    """Configurations one step of ``qd`` before ``q``, both MuJoCo's with a free root first."""
    back = q.copy()
    back[:, :3] -= dt * qd[:, :3]
    back[:, 7:] -= dt * qd[:, 6:]
    turn = -dt * qd[:, 3:6]  # rotation vector in the root's axes
    angle = np.linalg.norm(turn, axis=1)
    cosine, sine = np.cos(0.5 * angle), np.sin(0.5 * angle)
    x, y, z = (turn * np.where(angle > 0.0, sine / np.where(angle > 0.0, angle, 1.0), 0.5)[:, None]).T
    w0, x0, y0, z0 = q[:, 3:7].T
    back[:, 3] = w0 * cosine - x0 * x - y0 * y - z0 * z
    back[:, 4] = w0 * x + x0 * cosine + y0 * z - z0 * y
    back[:, 5] = w0 * y - x0 * z + y0 * cosine + z0 * x
    back[:, 6] = w0 * z + x0 * y - y0 * x + z0 * cosine
    return back


class _Soles(NamedTuple):
    """What the sole points tell, see :class:`MeasuredGait`; ``force`` and ``torque`` are of each foot."""

    force: Array
    torque: Array
    floor: Array
    foot_contact: NDArray[np.bool_]
    point_contact: NDArray[np.bool_]
    penetration: Array
    slip: Array


def _soles(record: SimulationRecord) -> _Soles:
    """Forces, contacts and motion of the sole points, some steps at a time."""
    steps = record.steps
    force, torque = np.empty((steps, 2, 3)), np.empty((steps, 2, 3))
    floor, penetration, slip_speed = np.empty(steps), np.empty((steps, 2)), np.empty((steps, 2))
    foot_contact = np.empty((steps, 2), dtype=bool)
    point_contact = np.empty((steps, len(record.point_foot)), dtype=bool)
    for part in blocks(steps):
        position, point_force = record.point_position[part], record.point_force[part]
        point_torque = np.cross(position, point_force)
        surface = position[:, :, 2] + record.point_penetration[part]
        floor[part] = support_height(record.floor, surface, point_force[:, :, 2])
        contact = point_contact[part] = point_force[:, :, 2] > 0.0
        depth = np.where(contact, record.point_penetration[part], 0.0)
        load = np.where(contact, point_force[:, :, 2], 0.0)
        moved = np.diff(record.point_place[part.start : part.stop + 1, :, :2], axis=0)
        speed = np.hypot(moved[:, :, 0], moved[:, :, 1]) / record.time_step
        for foot in (0, 1):
            mine = record.point_foot == foot
            force[part, foot] = point_force[:, mine].sum(axis=1)
            torque[part, foot] = point_torque[:, mine].sum(axis=1)
            foot_contact[part, foot] = contact[:, mine].any(axis=1)
            penetration[part, foot] = depth[:, mine].max(axis=1, initial=0.0)
            total = load[:, mine].sum(axis=1)
            weighted = (load[:, mine] * speed[:, mine]).sum(axis=1)
            slip_speed[part, foot] = weighted / np.where(total > 0.0, total, 1.0)
    travelled = np.cumsum(slip_speed, axis=0) * record.time_step
    # In the air the speed is zero, so the travel of the last unloaded row is where this stance began.
    at_lift = np.maximum.accumulate(np.where(foot_contact, 0.0, travelled), axis=0)
    slip = np.where(foot_contact, travelled - at_lift, 0.0)
    return _Soles(force, torque, floor, foot_contact, point_contact, penetration, slip)


def _polygon_margin(record: SimulationRecord, contact: NDArray[np.bool_], zmp: Array) -> Array:
    """Distance of the ZMP to the edge of the loaded points' convex hull, shape (K,) [m]."""
    margin = np.empty(record.steps)
    for part in blocks(record.steps):
        margin[part] = polygon_margin(record.point_position[part, :, :2], contact[part], zmp[part])
    return margin


def _centroidal(
    model: pin.Model, to_pinocchio: ToPinocchio, q: Array, qd: Array
) -> tuple[Array, Array, Array]:
    """COM, its velocity and the angular momentum about it for every row of MuJoCo's, each shape (N, 3)."""
    data = model.createData()
    rows = q.shape[0]
    com, velocity, momentum = np.empty((rows, 3)), np.empty((rows, 3)), np.empty((rows, 3))
    for part in blocks(rows):
        for row, state in enumerate(zip(*to_pinocchio(q[part], qd[part]), strict=True), part.start):
            about_com = pin.computeCentroidalMomentum(model, data, *state)
            com[row] = data.com[0]
            velocity[row] = data.vcom[0]
            momentum[row] = about_com.angular
    return com, velocity, momentum


def centre_of_pressure(force: Array, torque: Array, least: float, floor: Array | float = 0.0) -> Array:
    """Where the net force meets a level floor, of a height [m], without horizontal moment, (..., 2) [m]."""
    vertical = np.where(force[..., 2] >= least, force[..., 2], np.nan)
    x, y = floor * force[..., 0] - torque[..., 1], floor * force[..., 1] + torque[..., 0]
    return np.stack([x / vertical, y / vertical], axis=-1)


def _largest(values: Any) -> float:
    finite = values[np.isfinite(values)]
    return float(np.abs(finite).max()) if finite.size else float("nan")

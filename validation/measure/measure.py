"""Measurement of a walk from its record alone, without the plan.

The ZMP is measured twice. Once as the centre of pressure of the logged contact forces; once from the rates of
linear and angular momentum, which Pinocchio computes from the recorded ``q`` and ``qd`` only. The second uses
no force and no acceleration of the simulator, so the two disagree as soon as one contact is missing from the
log. Else they agree to what the simulator's contact solver leaves, some nanometres.
"""

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array, ReadOnly, blocks, polygon_margin
from validation.trial.coordinates import PassiveJoints, spatial_acceleration, to_pinocchio
from validation.trial.record import SimulationRecord, stored_rows, support_height

LEAST_SUPPORT = 0.01
"""Share of body weight below which there is no ZMP: the quotient of two vanishing numbers is meaningless."""


@dataclass(frozen=True)
class Equations:
    """How well recorded steps satisfy the equations of motion.

    The defect of a step is the largest difference, over all coordinates, between the recorded change of
    velocity and that of the equations [m/s or rad/s].
    """

    steps: int  # that were checked
    median: float  # median defect of those without a joint beyond its range, as no stop's torque is recorded
    largest: float  # largest defect
    coordinate: str  # that has the largest one
    time: float  # of the step with the largest one [s]
    change: float  # median over those, too, of the largest change of velocity, for comparison


@dataclass(frozen=True)
class SelfChecks:
    """Checks of the instrument, one number each for the whole run."""

    com_agreement: float  # largest distance between the simulator's COM and Pinocchio's [m]
    angular_momentum_agreement: float  # largest distance between the two momenta about the COM [N m s]
    # vertical impulse over the run, less weight and gain of momentum, over the weight's impulse [1]. A
    # standing body presses with exactly its weight; a walking one with its weight and the rate of its
    # momentum
    impulse_residual: float
    # the equations of motion of the recorded steps; None if they were not checked
    equations: Equations | None = None


@dataclass(frozen=True)
class MeasuredGait(Brief, ReadOnly):
    """Measured signals of one run, row k for step k ([t_k, t_(k+1)]); world frame, floor at z = 0.

    Forces and torques act on the body. Where fewer than :data:`LEAST_SUPPORT` of the weight are carried, both
    ZMPs are NaN.
    """

    time: Array  # t_k, shape (K,) [s]
    foot_force: Array  # sum over each foot's sole points, left first, shape (K, 2, 3) [N]
    foot_torque: Array  # their moment about the world origin, shape (K, 2, 3) [N m]
    force: Array  # net ground force, shape (K, 3) [N]
    zmp: Array  # from contact forces, on the level plane of height `floor`, shape (K, 2) [m]
    zmp_momentum: Array  # from momentum rates and external forces, on the same plane, shape (K, 2) [m]
    # height of the floor under the sole points, averaged by their vertical forces, shape (K,) [m]
    floor: Array
    com: Array  # the simulator's COM at t_k, shape (K, 3) [m]
    com_pin: Array  # Pinocchio's COM at t_k, shape (K, 3) [m]
    # ground force by the rate of Pinocchio's momentum, less what else pushed the body, shape (K, 3) [N]
    momentum_force: Array
    angular_momentum: Array  # the simulator's, about the COM at t_k, shape (K, 3) [N m s]
    # rate of Pinocchio's over the step, less the moment of what else pushed the body, shape (K, 3) [N m]
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

    @property
    def weight(self) -> float:
        """Body weight m g [N]."""
        return self.mass * self.gravity


def measure(record: SimulationRecord, model: pin.Model, passive: PassiveJoints | None = None) -> MeasuredGait:
    """Measure a run.

    The force of step k acts at q_k and turns v_k into v_(k+1). So the momentum rate of row k is that of the
    accelerations (v_(k+1) - v_k) / dt at (q_k, v_k), where the simulator evaluates the equations of motion. A
    difference of recorded momenta would be off by half a step, as q_k and v_k belong to different instants.

    Args:
        record: the run.
        model: Pinocchio's model of the same body, free-flyer root.
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
    least = LEAST_SUPPORT * (mass * gravity)
    soles = _soles(record)
    floor, force = soles["floor"], soles["foot_force"].sum(axis=1)
    zmp = centre_of_pressure(force, soles["foot_torque"].sum(axis=1), least, floor)
    com_pin, momentum, rate = _centroidal(model, record)
    turned = record.angular_momentum - momentum[:, 3:]
    pushes = record.external_force.sum(axis=1)
    lever = record.external_position - com_pin[:-1, None]
    moments = record.external_moment + np.cross(lever, record.external_force)
    momentum_force = rate[:-1, :3] + np.array([0.0, 0.0, mass * gravity]) - pushes
    momentum_rate = rate[:-1, 3:] - moments.sum(axis=1)
    lifted = pushes[:, 2].sum() * dt
    moment = momentum_rate + np.cross(com_pin[:-1], momentum_force)  # about the origin
    impulse, full = force[:, 2].sum() * dt, mass * gravity * record.steps * dt
    gained = momentum[-1, 2] - momentum[0, 2]
    equations = None
    if passive is not None and not passive.friction.any():
        equations = check_equations(record, model, passive)
    checks = SelfChecks(
        com_agreement=largest(np.linalg.norm(record.com - com_pin, axis=1)),
        angular_momentum_agreement=largest(np.linalg.norm(turned, axis=1)),
        impulse_residual=float((impulse + lifted - gained) / (full or math.nan) - 1.0),
        equations=equations,
    )
    return MeasuredGait(
        **soles,
        time=record.time[:-1],
        force=force,
        zmp=zmp,
        zmp_momentum=centre_of_pressure(momentum_force, moment, least, floor),
        com=record.com[:-1],
        com_pin=com_pin[:-1].copy(),
        momentum_force=momentum_force,
        angular_momentum=record.angular_momentum[:-1],
        angular_momentum_rate=momentum_rate,
        foot_position=record.foot_position[:-1],
        polygon_margin=polygon_margin(record.point_position[:, :, :2], soles["point_contact"], zmp),
        mass=mass,
        gravity=gravity,
        time_step=dt,
        self_checks=checks,
    )


def _soles(record: SimulationRecord) -> dict[str, Any]:
    """What the sole points tell: some fields of :class:`MeasuredGait`."""
    parts = [_soles_of(record, rows) for rows in blocks(record.steps)]
    found = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    travelled = np.cumsum(found["slip"], axis=0) * record.time_step
    # In the air the speed is zero, so the travel of the last unloaded row is where this stance began.
    at_lift = np.maximum.accumulate(np.where(found["foot_contact"], 0.0, travelled), axis=0)
    return {**found, "slip": np.where(found["foot_contact"], travelled - at_lift, 0.0)}


def _soles_of(record: SimulationRecord, rows: slice) -> dict[str, Any]:
    """The same for some steps, but ``slip`` is the speed [m/s]."""
    position, point_force, depth = (
        values[rows] for values in (record.point_position, record.point_force, record.point_penetration)
    )
    point_torque, vertical = np.cross(position, point_force), point_force[:, :, 2]
    floor = support_height(record.floor, position[:, :, 2] + depth, vertical)
    contact = vertical > 0.0
    load, depth = (np.where(contact, values, 0.0) for values in (vertical, depth))
    moved = np.diff(record.point_place[rows.start : rows.stop + 1, :, :2], axis=0)
    speed = np.hypot(moved[:, :, 0], moved[:, :, 1]) / record.time_step
    feet: dict[str, list[Any]] = defaultdict(list)
    for foot in (0, 1):
        mine = record.point_foot == foot
        total = load[:, mine].sum(axis=1)
        weighted = (load[:, mine] * speed[:, mine]).sum(axis=1)
        feet["foot_force"].append(point_force[:, mine].sum(axis=1))
        feet["foot_torque"].append(point_torque[:, mine].sum(axis=1))
        feet["foot_contact"].append(contact[:, mine].any(axis=1))
        feet["penetration"].append(depth[:, mine].max(axis=1, initial=0.0))
        feet["slip"].append(weighted / np.where(total > 0.0, total, 1.0))
    found = {name: np.stack(values, axis=1) for name, values in feet.items()}
    return {**found, "floor": floor, "point_contact": contact}


def _centroidal(model: pin.Model, record: SimulationRecord) -> tuple[Array, Array, Array]:
    """COM, momentum about it and rate of that momentum over each step, shapes (K+1, 3), (K+1, 6), (K+1, 6).

    Linear parts first; the last rate is of no acceleration.
    """
    data, size = model.createData(), record.steps + 1
    com, momentum, rate = np.empty((size, 3)), np.empty((size, 6)), np.empty((size, 6))
    change = np.diff(record.qd, axis=0, append=record.qd[-1:]) / record.time_step
    for rows in blocks(size):
        q, v = to_pinocchio(record.q[rows], record.qd[rows])
        acceleration = spatial_acceleration(record.q[rows], v, change[rows])
        for row, state in enumerate(zip(q, v, acceleration, strict=True), rows.start):
            rate[row] = pin.computeCentroidalMomentumTimeVariation(model, data, *state).vector
            com[row], momentum[row] = data.com[0], data.hg.vector
    return com, momentum, rate


def check_equations(record: SimulationRecord, model: pin.Model, passive: PassiveJoints) -> Equations:
    """Hold a step every 10 ms, and the last one, to the equations of motion.

    A step of the simulator turns the velocity ``v_k`` into ``v_(k+1)``. The equations of motion say by how
    much: ``v_(k+1) - v_k = h ABA(q_k, v_k, torque, forces)``, the articulated-body algorithm (Featherstone
    2008, ch. 7) with the recorded torques, contact forces and pushes, and the joints' springs and dampers.
    What is left is the defect. It needs no contact law: a simulator of another law has the same equations.
    All coordinates count, not only the six of the momentum.

    The model is the simulated body, with armature and gravity, a free root first.
    """
    rows = np.minimum(stored_rows(record.steps, record.time_step), record.steps - 1)
    rows = np.unique(rows[rows >= 0])
    if not len(rows):
        return Equations(0, math.nan, math.nan, "", math.nan, math.nan)
    dt, change = record.time_step, np.abs(record.qd[rows + 1] - record.qd[rows])
    size = np.abs(_defects(record, model, passive, rows))
    row, column = divmod(int(np.argmax(size)), size.shape[1])
    angles, (low, high) = record.q[rows, 7:], record.joint_range.T
    free = ((angles >= low) & (angles <= high)).all(axis=1)
    root = [f"root {what} {axis}" for what in ("velocity", "rate") for axis in "xyz"]  # in its own axes
    return Equations(
        steps=len(rows),
        median=float(np.median(size[free].max(axis=1))) if free.any() else math.nan,
        largest=float(size[row, column]),
        coordinate=[*root, *record.joint_names][column],
        time=float(rows[row] * dt),
        change=float(np.median(change[free].max(axis=1))) if free.any() else math.nan,
    )


def _defects(
    record: SimulationRecord, model: pin.Model, passive: PassiveJoints, rows: NDArray[np.intp]
) -> Array:
    """Recorded change of velocity less that by the equations, shape (n, nv) [m/s, rad/s].

    The root's are in its own axes.
    """
    dt = record.time_step
    if passive.implicit:  # (M + h D) a = ... with D v at the start of the step
        model = pin.Model(model)
        model.armature = model.armature + dt * passive.damping
    data = model.createData()
    point_force = record.point_force[rows]
    force = np.concatenate([point_force, record.external_force[rows]], axis=1)
    moment = np.concatenate([np.zeros_like(point_force), record.external_moment[rows]], axis=1)
    place = np.concatenate([record.point_position[rows], record.external_position[rows]], axis=1)
    moment = moment + np.cross(place, force)  # about the origin
    segments = [*record.point_sites, *record.external_segments]
    joints = np.array([model.frames[model.getFrameId(name)].parentJoint for name in segments])
    loads = {
        joint: np.concatenate([part[:, joints == joint].sum(axis=1) for part in (force, moment)], axis=1)
        for joint in np.unique(joints).tolist()
    }
    forces = pin.StdVec_Force()
    forces.extend([pin.Force.Zero()] * model.njoints)
    states = to_pinocchio(record.q[rows], record.qd[rows])
    change = (record.qd[rows + 1] - record.qd[rows]) / dt
    result = dt * spatial_acceleration(record.q[rows], states[1], change)
    for row, (q, v, torque) in enumerate(zip(*states, record.torque_at(rows), strict=True)):
        pin.forwardKinematics(model, data, q)
        for joint, load in loads.items():
            forces[joint] = data.oMi[joint].actInv(pin.Force(load[row]))
        generalized = -passive.damping * v
        generalized[6:] += torque - passive.stiffness[6:] * (q[7:] - passive.rest[6:])
        result[row] -= dt * pin.aba(model, data, q, v, generalized, forces)
    return result


def centre_of_pressure(force: Array, torque: Array, least: float, floor: Array | float = 0.0) -> Array:
    """Where a net force meets a level floor without horizontal moment, shape (..., 2) [m].

    ``p_x = (h F_x - M_y) / F_z`` and ``p_y = (h F_y + M_x) / F_z``, of the force F, shape (..., 3) [N], the
    torque M about the world origin, shape (..., 3) [N m], and the floor's height h, shape (...) [m]; NaN
    where ``F_z`` is below ``least`` [N].
    """
    vertical = np.where(force[..., 2] >= least, force[..., 2], np.nan)
    x, y = floor * force[..., 0] - torque[..., 1], floor * force[..., 1] + torque[..., 0]
    return np.stack([x / vertical, y / vertical], axis=-1)


def largest(values: Array) -> float:
    """Largest value that is not NaN; NaN if none is finite."""
    return float(np.nanmax(values)) if np.isfinite(values).any() else math.nan

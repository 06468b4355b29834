"""The equations of motion of every step, by Pinocchio, from recorded states, torques and forces.

A step of the simulator turns the velocity ``v_k`` into ``v_(k+1)``. The equations of motion say by how much:
``v_(k+1) - v_k = h ABA(q_k, v_k, torque, forces)``, the articulated-body algorithm (Featherstone 2008, ch. 7)
with the recorded torques, contact forces and pushes, and the joints' springs and dampers. What is left is the
defect. It needs no contact law: a simulator of another law has the same equations. All coordinates count, not
only the six of the momentum.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.geometry import Array
from validation.trial.coordinates import PassiveJoints, spatial_acceleration, to_pinocchio
from validation.trial.record import SimulationRecord, stored_rows


@dataclass(frozen=True)
class Equations(Brief):
    """How well recorded steps satisfy the equations of motion.

    The defect of a step is the largest difference, over all coordinates, between the recorded change of
    velocity and that of the equations [m/s or rad/s].
    """

    steps: int  # that were checked
    median: float  # median defect without a joint beyond its range, whose stop's torque is not recorded
    largest: float  # largest defect
    coordinate: str  # that has the largest one
    time: float  # of the step with the largest one [s]
    change: float  # median over the steps of the largest change of velocity, for comparison


def check_equations(record: SimulationRecord, model: pin.Model, passive: PassiveJoints) -> Equations:
    """Hold a step every 10 ms, and the last one, to the equations of motion.

    The model is the simulated body, with armature and gravity, a free root first.
    """
    rows = np.minimum(stored_rows(record.steps, record.time_step), record.steps - 1)
    rows = np.unique(rows[rows >= 0])
    if not len(rows):
        return Equations(0, math.nan, math.nan, "", math.nan, math.nan)
    dt, change = record.time_step, record.qd[rows + 1] - record.qd[rows]
    size = np.abs(_defects(record, model, passive, rows))
    row, column = divmod(int(np.argmax(size)), size.shape[1])
    angles, (low, high) = record.q[rows, 7:], record.joint_range.T
    free = size.max(axis=1)[((angles >= low) & (angles <= high)).all(axis=1)]
    root = [f"root {what} {axis}" for what in ("velocity", "rate") for axis in "xyz"]  # in its own axes
    return Equations(
        steps=len(rows),
        median=float(np.median(free)) if len(free) else math.nan,
        largest=float(size[row, column]),
        coordinate=[*root, *record.joint_names][column],
        time=float(rows[row] * dt),
        change=float(np.median(np.abs(change).max(axis=1))),
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

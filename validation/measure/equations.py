"""The equations of motion of every step, by Pinocchio, from recorded states, torques and forces.

A step of the simulator turns the velocity ``v_k`` into ``v_(k+1)``. The equations of motion say by how much:
``v_(k+1) - v_k = h ABA(q_k, v_k, torque, forces)``, the articulated-body algorithm (Featherstone 2008, ch. 7)
with the recorded torques, contact forces and pushes, and the joints' springs and dampers. What is left is the
defect. It needs no contact law: a simulator of another law has the same equations. All coordinates count, not
only the six of the momentum.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.geometry import Array
from validation.trial.passive import PassiveJoints
from validation.trial.record import SimulationRecord, stored_rows
from validation.trial.spill import blocks

ToPinocchio = Callable[[Array, Array], tuple[Array, Array]]

_BLOCK = 1024  # steps that are checked at a time


class Steps(NamedTuple):
    """Recorded steps, Pinocchio's coordinates, n rows."""

    q: Array  # configuration at the start of each step, shape (n, nq)
    v: Array  # velocity at the start, shape (n, nv)
    change: Array  # of MuJoCo's velocity over the step, shape (n, nv) [m/s, rad/s]
    torque: Array  # of the motors, shape (n, nu) [N m]
    force: Array  # forces on the body in world, shape (n, S, 3) [N]
    moment: Array  # moments beside them in world, shape (n, S, 3) [N m]
    position: Array  # where the forces act in world, shape (n, S, 3) [m]


@dataclass(frozen=True)
class Equations(Brief):
    """How well recorded steps satisfy the equations of motion.

    The defect of a step is the largest difference, over all coordinates, between the recorded change of
    velocity and that of the equations [m/s or rad/s].
    """

    steps: int  # that were checked
    median: float  # median defect
    largest: float  # largest defect
    coordinate: str  # that has the largest one
    time: float  # of the step with the largest one [s]
    change: float  # median over the steps of the largest change of velocity, for comparison

    def __str__(self) -> str:
        return (
            f"{self.steps} steps against the equations of motion: median defect {self.median:.2g}, largest "
            f"{self.largest:.2g} ({self.coordinate} at {self.time:.6g} s); velocities change by "
            f"{self.change:.2g} in a step [m/s, rad/s]"
        )


def defects(
    model: pin.Model, passive: PassiveJoints, time_step: float, segments: Sequence[str], steps: Steps
) -> Array:
    """Recorded change of velocity less that by the equations of motion.

    Args:
        model: the body, with armature and gravity, a free root first.
        passive: of its coordinates.
        time_step: [s].
        segments: frames on which the forces act, S names.
        steps: to check.

    Returns:
        Shape (n, nv) [m/s, rad/s], the root's in its own axes.
    """
    if passive.implicit:  # (M + h D) a = ... with D v at the start of the step
        model = pin.Model(model)
        model.armature = model.armature + time_step * passive.damping
    data = model.createData()
    joints = np.array([model.frames[model.getFrameId(name)].parentJoint for name in segments])
    loaded = np.unique(joints).tolist()
    about_origin = steps.moment + np.cross(steps.position, steps.force)
    force = {joint: steps.force[:, joints == joint].sum(axis=1) for joint in loaded}
    moment = {joint: about_origin[:, joints == joint].sum(axis=1) for joint in loaded}
    forces = pin.StdVec_Force()
    forces.extend([pin.Force.Zero()] * model.njoints)
    # MuJoCo's velocity of the root is in world, and Pinocchio's acceleration is spatial.
    spatial = time_step * np.cross(steps.v[:, 3:6], steps.v[:, :3])
    result = np.empty(steps.v.shape)
    for row, (q, v, torque) in enumerate(zip(steps.q, steps.v, steps.torque, strict=True)):
        pin.forwardKinematics(model, data, q)
        for joint in loaded:
            forces[joint] = data.oMi[joint].actInv(pin.Force(force[joint][row], moment[joint][row]))
        generalized = -passive.damping * v
        generalized[6:] += torque - passive.stiffness[6:] * (q[7:] - passive.rest[6:])
        recorded = steps.change[row].copy()
        recorded[:3] = data.oMi[1].rotation.T @ recorded[:3] - spatial[row]
        result[row] = recorded - time_step * pin.aba(model, data, q, v, generalized, forces)
    return result


def check_equations(
    record: SimulationRecord,
    model: pin.Model,
    passive: PassiveJoints,
    to_pinocchio: ToPinocchio,
    rows: NDArray[np.intp] | None = None,
) -> Equations:
    """Hold steps of a record to the equations of motion.

    Args:
        record: of the walk.
        model: the simulated body.
        passive: of its coordinates.
        to_pinocchio: turns MuJoCo's (q, qd) into Pinocchio's (q, v).
        rows: steps to check, ascending; by default those that a run folder keeps, one every 10 ms and the
            last.
    """
    if rows is None:
        rows = np.minimum(stored_rows(record.steps, record.time_step), record.steps - 1)
        rows = np.unique(rows[rows >= 0])
    segments = [*record.point_sites, *record.external_segments]
    found, change = np.empty((2, len(rows), model.nv))
    for part in blocks(len(rows), _BLOCK):
        k = rows[part]
        q, v = to_pinocchio(record.q[k], record.qd[k])
        force, place = record.point_force[k], record.point_position[k]
        change[part] = record.qd[k + 1] - record.qd[k]
        steps = Steps(
            q=q,
            v=v,
            change=change[part],
            torque=record.torque[k],
            force=np.concatenate([force, record.external_force[k]], axis=1),
            moment=np.concatenate([np.zeros_like(force), record.external_moment[k]], axis=1),
            position=np.concatenate([place, record.external_position[k]], axis=1),
        )
        found[part] = defects(model, passive, record.time_step, segments, steps)
    return summarize(found, change, record.time[rows], velocity_names(record.joint_names))


def velocity_names(joints: Sequence[str]) -> list[str]:
    """Names of the coordinates of a free root, in its own axes, and of the joints."""
    return [f"root {what} {axis}" for what in ("velocity", "rate") for axis in "xyz"] + list(joints)


def summarize(defect: Array, change: Array, time: Array, names: Sequence[str]) -> Equations:
    """Median and largest defect.

    Args:
        defect: of every step, shape (n, nv).
        change: of the velocity, shape (n, nv).
        time: of the steps, shape (n,) [s].
        names: of the nv coordinates.
    """
    if not len(defect):
        return Equations(0, math.nan, math.nan, "", math.nan, math.nan)
    size = np.abs(defect)
    row, column = divmod(int(np.argmax(size)), size.shape[1])
    return Equations(
        steps=len(defect),
        median=float(np.median(size.max(axis=1))),
        largest=float(size[row, column]),
        coordinate=names[column],
        time=float(time[row]),
        change=float(np.median(np.abs(change).max(axis=1))),
    )

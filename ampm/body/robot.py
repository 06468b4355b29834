"""A Pinocchio model with its :class:`~ampm.description.BodyDescription`: indices, frames, task terms.

The ``pin.Model`` is an argument, so this module is independent of the simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.description import SOLE_POINT_GROUPS, BodyDescription
from ampm.exceptions import InputError
from ampm.geometry import Array

if TYPE_CHECKING:
    from ampm.body.rigid_body import RigidBody

TASK_ROWS = 6 + 2 * 6
"""com 3, angular momentum 3, left foot 6 (linear, angular), right foot 6; toes are further rows."""
MOMENTUM, L_Z, ROLLS = slice(3, 5), 5, [9, 15]
"""Rows of the angular momentum about x and y, of that about z, and of the rolls of both soles."""


class TaskTerms(NamedTuple):
    """Task Jacobian and poses of one state."""

    # rows com velocity [m/s], angular momentum about the COM / mass [m^2/s], left foot, right foot (linear
    # then angular, world axes), toe joints; shape (R, nv)
    jacobian: Array
    com: Array  # COM in world, shape (3,) [m]
    sole: Array  # places of both soles in world, shape (2, 3) [m]
    sole_turn: Array  # their rotations to world, shape (2, 3, 3)


class Unsupported(NamedTuple):
    """What a motion needs of motors and floor at T instants; the force is that of the floor on the body."""

    torque: Array  # without any contact, with dampers, springs and dry friction, shape (T, nu) [N m]
    force: Array  # in world, shape (T, 3) [N]
    moment: Array  # of this force about the origin, in world, shape (T, 3) [N m]
    jacobian: Array  # task Jacobian of the hinges, shape (T, R, nu)

    def taken(self, foot: int, force: Array, moment: Array) -> Array:
        """What a force on a sole, with its moment about the reference point, takes from the torques."""
        rows = self.jacobian[:, 6 + 6 * foot : 12 + 6 * foot]
        return np.asarray(np.einsum("ki,kij->kj", np.hstack([force, moment]), rows))


class Gaps(NamedTuple):
    """Parts of a body that come closest to each other, at T configurations."""

    distance: Array  # negative where they overlap, shape (T,) [m]
    parts: tuple[str, ...]  # names of both, T texts; empty where nothing is near
    points: Array  # nearest points of both, in world, shape (T, 2, 3) [m]; NaN where nothing is near


class Robot:
    """Indices and dynamics terms of one body.

    Args:
        model: free-flyer root first, one Pinocchio joint per hinge.
        description: names of joints, segments and frames.
        gaps: parts that come closest at configurations (T, nq); the model's owner knows their shapes.

    Attributes:
        roll_rows: task rows of the rolls of soles that legs without a roll of the ankle cannot hold.
        lower, upper: joint limits, shape (nu,) [rad].
        torque_limit: largest torque of every hinge, shape (nu,) [N m].
        speed_limit: largest rate of every hinge, infinite where there is no limit, shape (nu,) [rad/s].
        passive: damping, stiffness, angle of the spring and dry friction of the hinges, shape (nu, 4).

    Raises:
        InputError: the description names a joint or frame that the model lacks.
    """

    def __init__(self, model: pin.Model, description: BodyDescription, gaps: Callable[[Array], Gaps]) -> None:
        self.model, self.gaps = model, gaps
        self.description = description
        self.data = model.createData()
        self.nq, self.nv = model.nq, model.nv
        self.nu = model.nv - 6
        self.mass = pin.computeTotalMass(model)
        self.gravity = float(-model.gravity.linear[2])
        self.sole_frames = tuple(self._frame(leg.sole_frame) for leg in description.legs)
        self.trunk_frame = self._frame(description.trunk_segment)
        self.toe_joints = self.velocity_indices(tuple(toe for leg in description.legs for toe in leg.toes))
        self.task_rows = TASK_ROWS + len(self.toe_joints)
        self.roll_rows = np.array(ROLLS if description.upright else [], dtype=np.intp)
        self.knee_joints = self.velocity_indices(tuple(leg.knee for leg in description.legs))
        self._knee_signs = np.array([leg.knee_sign for leg in description.legs])
        self.straight_knees = np.array([leg.straight_knee for leg in description.legs])
        self.trunk_joints = self.velocity_indices(description.trunk)
        self.arm_joints = self.velocity_indices(description.arms)
        arms = {model.getJointId(joint) for joint in (*description.left_arm, *description.right_arm)}
        self._arm_parts = {f.name.replace("_", " ") for f in model.frames if f.parentJoint in arms}
        self.leg_joints = tuple(self.velocity_indices(leg.joints) for leg in description.legs)
        points = list(description.sole_points())
        self.point_frames = tuple(self._frame(site) for _, _, site in points)
        self.point_foot = np.array([foot for foot, _, _ in points])
        self.point_group = np.array([SOLE_POINT_GROUPS.index(group) for _, group, _ in points])
        joints, images, signs = zip(*description.mirror, strict=True)
        order = self.velocity_indices(joints) - 6
        self._mirror_index, self._mirror_sign = np.zeros(self.nu, dtype=np.intp), np.zeros(self.nu)
        self._mirror_index[order], self._mirror_sign[order] = self.velocity_indices(images) - 6, signs
        self.passive = np.zeros((self.nu, 4))
        for item in description.passive:
            values = item.damping, item.stiffness, item.spring, item.friction
            self.passive[self.velocity_indices((item.joint,)) - 6] = values
        self.speed_limit = np.full(self.nu, np.inf)
        for joint, speed in description.speed_limits:
            self.speed_limit[self.velocity_indices((joint,)) - 6] = speed
        limits = model.lowerPositionLimit[7:], model.upperPositionLimit[7:], model.effortLimit[6:]
        self.lower, self.upper, self.torque_limit = map(np.array, limits)
        for value in vars(self).values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    array.setflags(write=False)

    def _frame(self, name: str) -> int:
        if not self.model.existFrame(name):
            raise InputError(
                f"the model has no frame {name!r}, which the body's description names; add it or rename."
            )
        return int(self.model.getFrameId(name))

    def velocity_indices(self, joints: tuple[str, ...]) -> NDArray[np.intp]:
        """Indices of hinges in the velocity vector; a hinge's index in q is one more."""
        indices = []
        for name in joints:
            if not self.model.existJointName(name):
                raise InputError(f"the model has no joint {name!r}; correct the body's description.")
            indices.append(self.model.joints[self.model.getJointId(name)].idx_v)
        return np.array(indices, dtype=np.intp)

    def by_group(self, values: Mapping[str, float]) -> Array:
        """One value per velocity, shape (nv,), from one per group of coordinates.

        Args:
            values: of ``root_linear``, ``root_angular``, ``legs``, ``trunk`` and ``arms``; hinges of no group
                count as arms.
        """
        out = np.full(self.nv, values["arms"])
        out[:3], out[3:6] = values["root_linear"], values["root_angular"]
        for legs in self.leg_joints:
            out[legs] = values["legs"]
        out[self.trunk_joints] = values["trunk"]
        return out

    def knee_angles(self, flexion: float) -> Array:
        """Angles of both knees at a flexion, shape (2,) [rad]."""
        return self.straight_knees + self._knee_signs * flexion

    def knee_flexion(self, q: Array) -> Array:
        """Flexion of both knees at configurations (..., nq), 0 where they are straight, (..., 2) [rad]."""
        return np.asarray(self._knee_signs * (q[..., self.knee_joints + 1] - self.straight_knees))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Hinges in velocity order."""
        return tuple(self.model.names[2:])

    def mirror_joints(self, values: Array) -> Array:
        """Reflect joint values (..., nu) in the sagittal plane."""
        return values[..., self._mirror_index] * self._mirror_sign

    def mirror_q(self, q: Array, advance: float = 0.0, rise: float = 0.0) -> Array:
        """Reflect configurations (..., nq) in the plane y = 0; move them along x and z [m]."""
        out = q.copy()
        out[..., [1, 3, 5]] *= -1.0  # y, and of the quaternion x, y, z, w roll and yaw
        out[..., 0] += advance
        out[..., 2] += rise
        out[..., 7:] = self.mirror_joints(q[..., 7:])
        return out

    def step_gaps(self, q: Array) -> Gaps:
        """Parts that come closest in a step (T, nq), or in its mirror image if the sides' shapes differ."""
        gaps = self.gaps(q)
        if not self._one_sided:
            return gaps
        other = self.gaps(self.mirror_q(q))
        nearer = other.distance < gaps.distance
        parts = np.where(nearer, other.parts, gaps.parts).tolist()
        points = np.where(nearer[:, None, None], other.points, gaps.points)
        return Gaps(np.minimum(gaps.distance, other.distance), tuple(parts), points)

    def of_arm(self, parts: str) -> bool:
        """Whether one of two parts, by their names in :class:`Gaps`, is moved by an arm's hinge."""
        return not self._arm_parts.isdisjoint(parts.split(" and "))

    @cached_property
    def _one_sided(self) -> bool:
        """Whether shapes of one side are not the mirror images of the other's, to a millimetre."""
        low, high = np.clip((self.lower, self.upper), -1.0, 1.0)
        q = np.tile(pin.neutral(self.model), (16, 1))
        q[:, 7:] = low + (high - low) * np.random.default_rng(0).uniform(size=(len(q), self.nu))
        distance = self.gaps(q).distance - self.gaps(self.mirror_q(q)).distance
        return bool(np.abs(distance).max() > 1e-3)

    def mirror_v(self, v: Array) -> Array:
        """Reflect velocities or accelerations (..., nv), root part in the root's own axes."""
        out = v.copy()
        out[..., [1, 3, 5]] *= -1.0
        out[..., 6:] = self.mirror_joints(v[..., 6:])
        return out

    @cached_property
    def rigid_body(self) -> RigidBody:
        """The body as arrays, with its physics in compiled functions."""
        # Loads numba, which a plan with a known motion does without.
        from ampm.body.rigid_body import RigidBody

        return RigidBody.of(self.model, self.sole_frames, self.trunk_frame, self.toe_joints)

    def jacobian(self, q: Array) -> TaskTerms:
        """Task Jacobian and poses at a configuration, shape (nq,)."""
        body = self.rigid_body
        body.place(q)
        place, turn = body.places(body.soles)
        com = body.link["first"][0] / body.link["mass"][0]  # from the root
        return TaskTerms(np.ascontiguousarray(body.columns.T), q[:3] + com, q[:3] + place, turn)

    def drift(self, q: Array, v: Array) -> Array:
        """``d(jacobian)/dt v`` at (q, v), shape (R,)."""
        from ampm.body.rigid_body import task_drift  # as above

        drift = np.zeros(self.task_rows)
        self.rigid_body.place(q)
        task_drift(self.rigid_body, v, v, drift)
        return drift

    def unsupported(self, q: Array, v: Array, acceleration: Array) -> Unsupported:
        """Inverse dynamics (Newton and Euler) of T configurations, (T, nq), with rates and accelerations."""
        # Loads numba, which a plan with a known motion does without.
        from ampm.body.rigid_body import passive_torques

        count = len(q)
        jacobian, torque = np.empty((count, self.task_rows, self.nu)), np.empty((count, self.nu))
        force, moment = np.empty((2, count, 3))
        for k in range(count):
            self.rigid_body.place(q[k])
            rows = np.ascontiguousarray(self.rigid_body.columns.T)
            total = pin.rnea(self.model, self.data, q[k], v[k], acceleration[k])
            passive_torques(self.passive, q[k], v[k], v[k], torque[k])
            torque[k] += total[6:]
            turn = rows[6:9, :3]  # of the root to world
            jacobian[k] = rows[:, 6:]
            force[k], moment[k] = np.einsum("ij,kj->ki", turn, total[:6].reshape(2, 3))
        return Unsupported(torque, force, moment + np.cross(q[:, :3], force), jacobian)

    def trunk_rotations(self, q: Array) -> Array:
        """Rotation of the trunk segment to world at configurations (T, nq), shape (T, 3, 3)."""
        rotations = np.empty((len(q), 3, 3))
        for k, configuration in enumerate(q):
            pin.forwardKinematics(self.model, self.data, configuration)
            rotations[k] = pin.updateFramePlacement(self.model, self.data, self.trunk_frame).rotation
        return rotations

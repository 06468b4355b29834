"""A Pinocchio model with its :class:`~ampm.description.BodyDescription`: indices, frames, task terms.

The ``pin.Model`` is an argument, so this module is independent of the simulator.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from ampm.description import SOLE_POINT_GROUPS, BodyDescription
from ampm.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LEFT, RIGHT = 0, 1
_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
FOOT_ROWS = 6
TASK_ROWS = 6 + 2 * FOOT_ROWS + 2
"""com 3, angular momentum 3, left foot 6 (linear, angular), right foot 6, toes 2."""
POINTS, SOLES = 6, 4
"""Points of one sole. The first of them, heel and ball, sit on the foot segment, the tips on the toes."""


class TaskTerms(NamedTuple):
    """Task Jacobian and poses of one state.

    Attributes:
        jacobian: rows com velocity [m/s], angular momentum about the COM / mass [m^2/s], left foot, right
            foot (linear then angular, world axes), toe joints; shape (20, nv).
        com: COM in world, shape (3,) [m].
        soles: poses of left and right sole in world [m].
        trunk: pose of the trunk segment in world [m].
    """

    jacobian: Array
    com: Array
    soles: tuple[pin.SE3, pin.SE3]
    trunk: pin.SE3


class Kinematics(NamedTuple):
    """One state of a body, and all that its tasks and contact forces need of it; axes of the world.

    Attributes:
        q, v: Pinocchio configuration and velocity, shapes (nq,), (nv,).
        now: velocity at the instant of ``q``, shape (nv,).
        jacobian: of the tasks, see :class:`TaskTerms`, shape (20, nv).
        rates: ``jacobian @ now``, 20 plain numbers.
        drift: ``d(jacobian)/dt v``, the feet's rows with ``now``, shape (20,).
        com: shape (3,) [m].
        trunk: rotation of the trunk segment, plain numbers of shape (3, 3).
        soles: homogeneous placements of both soles, plain numbers of shape (2, 4, 4) [m].
        sole_arm: their reference points about the COM, plain numbers of shape (2, 3) [m].
        arm: sole points about the COM, shape (2, 6, 3) [m].
        toe_lever: moment about the toe joint per force at each tip, shape (2, 2, 3) [m].
    """

    q: Array
    v: Array
    now: Array
    jacobian: Array
    rates: list[float]
    drift: Array
    com: Array
    trunk: list[list[float]]
    soles: tuple[list[list[float]], list[list[float]]]
    sole_arm: list[list[float]]
    arm: Array
    toe_lever: Array


class Gaps(NamedTuple):
    """Parts of a body that come closest to each other, at T configurations.

    Attributes:
        distance: negative where they overlap, shape (T,) [m].
        parts: names of both, T texts; empty where nothing is near.
        points: nearest points of both, in world, shape (T, 2, 3) [m]; NaN where nothing is near.
    """

    distance: Array
    parts: tuple[str, ...]
    points: Array


class BodyShapes(Protocol):
    """Shapes of a body.

    Attributes:
        digest: text that is another for other shapes.
    """

    digest: str

    def gaps(self, q: Array) -> Gaps:
        """Parts that come closest at configurations (T, nq)."""
        ...


class Robot:
    """Indices and dynamics terms of one body.

    Args:
        model: free-flyer root first, one Pinocchio joint per hinge.
        description: names of joints, segments and frames.
        shapes: of the body; the model's owner knows them.

    Raises:
        InputError: the description names a joint or frame that the model lacks.
    """

    def __init__(self, model: pin.Model, description: BodyDescription, shapes: BodyShapes) -> None:
        self.model, self.shapes = model, shapes
        self.description = description
        self.data = model.createData()
        self.nq, self.nv = model.nq, model.nv
        self.nu = model.nv - 6
        self.mass = pin.computeTotalMass(model)
        self.gravity = float(-model.gravity.linear[2])
        self.sole_frames = tuple(self._frame(leg.sole_frame) for leg in description.legs)
        self.toe_frames = tuple(self._frame(leg.toe_frame) for leg in description.legs)
        self.trunk_frame = self._frame(description.trunk_segment)
        self.toe_joints = self.velocity_indices(tuple(leg.toe for leg in description.legs))
        self.knee_joints = self.velocity_indices(tuple(leg.knee for leg in description.legs))
        self.trunk_joints = self.velocity_indices(description.trunk)
        self.arm_joints = self.velocity_indices(description.arms)
        self.leg_joints = tuple(self.velocity_indices(leg.joints) for leg in description.legs)
        points = list(description.sole_points())
        self.point_frames = tuple(self._frame(site) for _, _, site in points)
        self.point_foot = np.array([foot for foot, _, _ in points])
        self.point_group = np.array([SOLE_POINT_GROUPS.index(group) for _, group, _ in points])
        self._mirror_index, self._mirror_sign = self._mirror_map()
        self._constant_rows = np.zeros((TASK_ROWS, self.nv))
        for row, joint in enumerate(self.toe_joints):
            self._constant_rows[TASK_ROWS - 2 + row, joint] = 1.0
        self._zero = np.zeros(self.nv)
        # Views of Pinocchio's own memory, which its algorithms write in place: making them at every call
        # would cost more than the arithmetic.
        feet = zip(self.sole_frames, self.toe_frames, strict=True)
        self._foot_placements = [self.data.oMf[frame] for pair in feet for frame in pair]
        self._trunk = self.data.oMf[self.trunk_frame].rotation
        self._momentum_map, self._com = self.data.Ag, self.data.com[0]
        self._momentum_rate = self.data.dhg.vector
        self._local_points, self._frames = self._points_in_frames(), np.empty((4, 4, 4))

    # ------------------------------------------------------------------ names

    def _frame(self, name: str) -> int:
        if not self.model.existFrame(name):
            raise InputError(
                f"the model has no frame {name!r}, which the body's description names; add it or rename"
            )
        return int(self.model.getFrameId(name))

    def velocity_indices(self, joints: tuple[str, ...]) -> NDArray[np.intp]:
        """Indices of hinges in the velocity vector; a hinge's index in q is one more."""
        indices = []
        for name in joints:
            if not self.model.existJointName(name):
                raise InputError(
                    f"the model has no joint {name!r}, which the body's description names; rename it"
                )
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

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Hinges in velocity order."""
        return tuple(self.model.names[2:])

    @property
    def lower(self) -> Array:
        """Lower joint limits, shape (nu,) [rad]."""
        return np.asarray(self.model.lowerPositionLimit[7:])

    @property
    def upper(self) -> Array:
        """Upper joint limits, shape (nu,) [rad]."""
        return np.asarray(self.model.upperPositionLimit[7:])

    @property
    def torque_limit(self) -> Array:
        """Largest torque of every hinge, shape (nu,) [N m]."""
        return np.asarray(self.model.effortLimit[6:])

    # ----------------------------------------------------------------- mirror

    def _mirror_map(self) -> tuple[NDArray[np.intp], Array]:
        index, sign = np.zeros(self.nu, dtype=np.intp), np.zeros(self.nu)
        for joint, other, s in self.description.mirror:
            to = self.velocity_indices((joint,))[0] - 6
            index[to] = self.velocity_indices((other,))[0] - 6
            sign[to] = s
        return index, sign

    def mirror_joints(self, values: Array) -> Array:
        """Reflect joint values (..., nu) in the sagittal plane."""
        return values[..., self._mirror_index] * self._mirror_sign

    def mirror_q(self, q: Array, advance: float = 0.0) -> Array:
        """Reflect configurations (..., nq) in the plane y = 0 and move them by ``advance`` along x [m]."""
        out = np.empty_like(q)
        out[..., 0] = q[..., 0] + advance
        out[..., 1] = -q[..., 1]
        out[..., 2] = q[..., 2]
        out[..., 3] = -q[..., 3]  # quaternion x, y, z, w: roll and yaw turn the other way
        out[..., 4] = q[..., 4]
        out[..., 5] = -q[..., 5]
        out[..., 6] = q[..., 6]
        out[..., 7:] = self.mirror_joints(q[..., 7:])
        return out

    def mirror_v(self, v: Array) -> Array:
        """Reflect velocities or accelerations (..., nv), root part in the root's own axes."""
        out = np.empty_like(v)
        out[..., :6] = v[..., :6] * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
        out[..., 6:] = self.mirror_joints(v[..., 6:])
        return out

    # ------------------------------------------------------------------ terms

    def _points_in_frames(self) -> Array:
        """Points fixed to left sole, left toes, right sole and right toes, homogeneous, shape (4, 4, 4).

        Soles: heel and ball points. Toes: tip points, and of each the direction ``e_y x point``, which turned
        to world is the toe joint's moment per force at that point.
        """
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, pin.neutral(self.model))
        local = np.zeros((4, 4, 4))
        for index, (frame, foot) in enumerate(zip(self.point_frames, self.point_foot, strict=True)):
            point = index % POINTS
            tip = point >= SOLES
            base = self.toe_frames[foot] if tip else self.sole_frames[foot]
            x, y, z = data.oMf[base].actInv(data.oMf[frame].translation)
            local[2 * foot + tip, point % SOLES] = x, y, z, 1.0
            if tip:
                local[2 * foot + 1, 2 + point % SOLES] = z, 0.0, -x, 0.0
        return local

    def kinematics(self, q: Array, v: Array, now: Array | None = None) -> Kinematics:
        """All terms of one state.

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: Pinocchio velocity, shape (nv,).
            now: velocity at the instant of ``q``, if ``v`` is older, shape (nv,).
        """
        now = v if now is None else now
        jacobian, com = self._jacobian(q, v), self._com.copy()
        drift = self.drift(q, v, now)
        pin.updateFramePlacements(self.model, self.data)
        frames = self._frames
        for index, placement in enumerate(self._foot_placements):
            frames[index] = placement.homogeneous
        left, _, right, _ = frames.tolist()
        frames[:, :3, 3] -= com
        points = (self._local_points @ frames.transpose(0, 2, 1)).reshape(2, 8, 4)
        return Kinematics(
            q,
            v,
            now,
            jacobian,
            (jacobian @ now).tolist(),
            drift,
            com,
            self._trunk.tolist(),
            (left, right),
            frames[::2, :3, 3].tolist(),
            points[:, :POINTS, :3],
            points[:, POINTS:, :3],
        )

    def jacobian(self, q: Array, v: Array) -> TaskTerms:
        """Task Jacobian and poses at (q, v).

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: Pinocchio velocity, shape (nv,).
        """
        model, data, (left, right) = self.model, self.data, self.sole_frames
        jacobian, place = self._jacobian(q, v), pin.updateFramePlacement
        soles = place(model, data, left), place(model, data, right)
        return TaskTerms(jacobian, self._com.copy(), soles, place(model, data, self.trunk_frame))

    def _jacobian(self, q: Array, v: Array) -> Array:
        model, data = self.model, self.data
        pin.ccrba(model, data, q, v)  # fills the joint Jacobians as well
        jacobian = self._constant_rows.copy()
        np.multiply(self._momentum_map, 1.0 / self.mass, out=jacobian[:6])
        for foot, frame in enumerate(self.sole_frames):
            jacobian[6 + 6 * foot : 12 + 6 * foot] = pin.getFrameJacobian(model, data, frame, _ALIGNED)
        return jacobian

    def drift(self, q: Array, v: Array, feet_v: Array | None = None) -> Array:
        """``d(jacobian)/dt v`` at (q, v), shape (20,).

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: velocity for the momentum rows, shape (nv,).
            feet_v: velocity for the feet's rows, ``v`` by default, shape (nv,).
        """
        model, data = self.model, self.data
        drift = np.zeros(TASK_ROWS)
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, self._zero)
        np.multiply(self._momentum_rate, 1.0 / self.mass, out=drift[:6])
        if feet_v is not None:
            pin.forwardKinematics(model, data, q, feet_v, self._zero)
        for foot, frame in enumerate(self.sole_frames):
            a = pin.getFrameClassicalAcceleration(model, data, frame, _ALIGNED)
            drift[6 + 6 * foot : 12 + 6 * foot] = a.vector
        return drift

    def trunk_rotations(self, q: Array) -> Array:
        """Rotation of the trunk segment to world at configurations (T, nq), shape (T, 3, 3)."""
        rotations, data = np.empty((len(q), 3, 3)), self.model.createData()
        for k, configuration in enumerate(q):
            pin.forwardKinematics(self.model, data, configuration)
            rotations[k] = pin.updateFramePlacement(self.model, data, self.trunk_frame).rotation
        return rotations

"""A Pinocchio model seen through its :class:`~ampm.description.BodyDescription`: indices, frames, task terms.

The ``pin.Model`` is handed in ready made; nothing here knows which simulator it came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.description import SOLE_POINT_GROUPS, BodyDescription
from ampm.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

LEFT, RIGHT = 0, 1
_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
FOOT_ROWS = 6
TASK_ROWS = 6 + 2 * FOOT_ROWS + 2
"""com 3, angular momentum 3, left foot 6 (linear, angular), right foot 6, toes 2."""


@dataclass
class TaskTerms:
    """Task Jacobian and drift of one state; the arrays are overwritten by the next call.

    Attributes:
        jacobian: rows com velocity [m/s], angular momentum about the COM / mass [m^2/s], left foot, right
            foot (linear then angular, world axes), toe joints; shape (20, nv).
        drift: ``d(jacobian)/dt v``, shape (20,).
        com: COM in world, shape (3,) [m].
    """

    jacobian: NDArray[np.float64]
    drift: NDArray[np.float64]
    com: NDArray[np.float64]


class Robot:
    """Indices and dynamics terms of one body.

    Args:
        model: free-flyer root first, one Pinocchio joint per hinge.
        description: names of joints, segments and frames.

    Raises:
        InputError: the description names a joint or frame that the model lacks.
    """

    def __init__(self, model: pin.Model, description: BodyDescription) -> None:
        self.model = model
        self.description = description
        self.data = model.createData()
        self.nq, self.nv = model.nq, model.nv
        self.nu = model.nv - 6
        self.mass = pin.computeTotalMass(model)
        self.gravity = float(-model.gravity.linear[2])
        self.sole_frames = tuple(self._frame(leg.sole_frame) for leg in description.legs)
        self.toe_frames = tuple(self._frame(leg.toe_frame) for leg in description.legs)
        self.trunk_frame = self._frame(description.trunk_segment)
        self.root_frame = self._frame(description.root_segment)
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
        # One set of arrays for all calls; whoever keeps a view of them reads the latest state.
        self.terms = TaskTerms(
            jacobian=np.zeros((TASK_ROWS, self.nv)), drift=np.zeros(TASK_ROWS), com=np.zeros(3)
        )
        for row, joint in enumerate(self.toe_joints):
            self.terms.jacobian[TASK_ROWS - 2 + row, joint] = 1.0
        self._zero = np.zeros(self.nv)
        # Views of Pinocchio's own memory, which its algorithms write in place: reading them anew costs more
        # than the arithmetic.
        self.placements = self.data.oMf
        self._momentum_map, self._com = self.data.Ag, self.data.com[0]
        self._momentum_rate = self.data.dhg.vector

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

    def by_group(self, values: Mapping[str, float]) -> NDArray[np.float64]:
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
    def lower(self) -> NDArray[np.float64]:
        """Lower joint limits, shape (nu,) [rad]."""
        return np.asarray(self.model.lowerPositionLimit[7:])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper joint limits, shape (nu,) [rad]."""
        return np.asarray(self.model.upperPositionLimit[7:])

    @property
    def torque_limit(self) -> NDArray[np.float64]:
        """Largest torque of every hinge, shape (nu,) [N m]."""
        return np.asarray(self.model.effortLimit[6:])

    # ----------------------------------------------------------------- mirror

    def _mirror_map(self) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        index, sign = np.zeros(self.nu, dtype=np.intp), np.zeros(self.nu)
        for joint, other, s in self.description.mirror:
            to = self.velocity_indices((joint,))[0] - 6
            index[to] = self.velocity_indices((other,))[0] - 6
            sign[to] = s
        return index, sign

    def mirror_joints(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reflect joint values (..., nu) in the sagittal plane."""
        return values[..., self._mirror_index] * self._mirror_sign

    def mirror_q(self, q: NDArray[np.float64], advance: float = 0.0) -> NDArray[np.float64]:
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

    def mirror_v(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reflect velocities or accelerations (..., nv), root part in the root's own axes."""
        out = np.empty_like(v)
        out[..., :6] = v[..., :6] * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
        out[..., 6:] = self.mirror_joints(v[..., 6:])
        return out

    # ------------------------------------------------------------------ terms

    def jacobian(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> TaskTerms:
        """Kinematics and task Jacobian at (q, v); the drift is left as it was.

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: Pinocchio velocity, shape (nv,).
        """
        model, data, terms = self.model, self.data, self.terms
        pin.ccrba(model, data, q, v)  # fills the joint Jacobians as well
        jacobian = terms.jacobian
        np.multiply(self._momentum_map, 1.0 / self.mass, out=jacobian[:6])
        for foot, frame in enumerate(self.sole_frames):
            jacobian[6 + 6 * foot : 12 + 6 * foot] = pin.getFrameJacobian(model, data, frame, _ALIGNED)
        terms.com[:] = self._com
        return terms

    def drift(
        self, q: NDArray[np.float64], v: NDArray[np.float64], feet_v: NDArray[np.float64] | None = None
    ) -> TaskTerms:
        """Add ``d(jacobian)/dt v`` at (q, v) to the terms of the last :meth:`jacobian` call.

        Args:
            q: configuration of that call, shape (nq,).
            v: velocity for the momentum rows, shape (nv,).
            feet_v: velocity for the feet's rows, ``v`` by default, shape (nv,).
        """
        model, data, terms = self.model, self.data, self.terms
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, self._zero)
        np.multiply(self._momentum_rate, 1.0 / self.mass, out=terms.drift[:6])
        if feet_v is not None:
            pin.forwardKinematics(model, data, q, feet_v, self._zero)
        for foot, frame in enumerate(self.sole_frames):
            a = pin.getFrameClassicalAcceleration(model, data, frame, _ALIGNED)
            terms.drift[6 + 6 * foot : 12 + 6 * foot] = a.vector
        return terms

    def sole_pose(self, foot: int) -> pin.SE3:
        """Pose of a sole frame after :meth:`jacobian`; call with 0 for left, 1 for right."""
        return pin.updateFramePlacement(self.model, self.data, self.sole_frames[foot])

    def trunk_rotations(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotation of the trunk segment to world at configurations (T, nq), shape (T, 3, 3)."""
        rotations, data = np.empty((len(q), 3, 3)), self.model.createData()
        for k, configuration in enumerate(q):
            pin.forwardKinematics(self.model, data, configuration)
            rotations[k] = pin.updateFramePlacement(self.model, data, self.trunk_frame).rotation
        return rotations

    def rotation_of(self, frame: int) -> NDArray[np.float64]:
        """Rotation matrix of a frame after :meth:`jacobian`, shape (3, 3)."""
        return np.asarray(pin.updateFramePlacement(self.model, self.data, frame).rotation)

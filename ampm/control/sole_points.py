"""Where soles and sole points are about the COM: all of them by one product, every tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.control.wrench_qp import POINTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot

_FIRST_TIP = 4  # heel and ball points sit on the foot segment, tip points on the toe segment


class SolePoints:
    """Soles, sole points and the toes' levers at the robot's last state.

    Args:
        robot: whose kinematics are up to date when :meth:`update` is called.

    Attributes:
        pose: homogeneous placements of left sole, left toes, right sole, right toes, world axes, positions
            about the COM, shape (4, 4, 4) [m].
        sole: reference points about the COM, shape (2, 3) [m].
        arm: sole points about the COM, shape (2, 6, 3) [m].
        toe_lever: moment about the toe joint per force at each tip, shape (2, 2, 3) [m].
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._local = self._local_points(robot)
        frames = zip(robot.sole_frames, robot.toe_frames, strict=True)
        self._placements = [robot.placements[frame] for pair in frames for frame in pair]
        self.pose = np.zeros((4, 4, 4))
        self.sole = self.pose[::2, :3, 3]
        self.arm = np.zeros((2, POINTS, 3))
        self.toe_lever = np.zeros((2, 2, 3))

    @staticmethod
    def _local_points(robot: Robot) -> NDArray[np.float64]:
        """What is fixed to each frame of ``pose``, homogeneous, shape (4, 4, 4).

        Soles: heel and ball points. Toes: tip points, and of each the direction ``e_y x point``, which turned
        to world is the toe joint's moment per force at that point.
        """
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, pin.neutral(robot.model))
        local = np.zeros((4, 4, 4))
        for index, (frame, foot) in enumerate(zip(robot.point_frames, robot.point_foot, strict=True)):
            point = index % POINTS
            tip = point >= _FIRST_TIP
            base = robot.toe_frames[foot] if tip else robot.sole_frames[foot]
            x, y, z = data.oMf[base].actInv(data.oMf[frame].translation)
            local[2 * foot + tip, point % _FIRST_TIP] = x, y, z, 1.0
            if tip:
                local[2 * foot + 1, 2 + point % _FIRST_TIP] = z, 0.0, -x, 0.0
        return local

    def update(self, com: NDArray[np.float64]) -> None:
        """Read the placements; call after the robot's kinematics.

        Args:
            com: shape (3,) [m].
        """
        robot, pose = self._robot, self.pose
        pin.updateFramePlacements(robot.model, robot.data)
        for index, placement in enumerate(self._placements):
            pose[index] = placement.homogeneous
        pose[:, :3, 3] -= com
        world = (self._local @ pose.transpose(0, 2, 1)).reshape(2, 8, 4)
        self.arm, self.toe_lever = world[:, :POINTS, :3], world[:, POINTS:, :3]

    def sole_position(self, foot: int) -> list[float]:
        """Reference point of a sole in world, plain numbers [m]."""
        return self._placements[2 * foot].translation.tolist()

    def sole_rotation(self, foot: int) -> list[list[float]]:
        """Rotation of a sole to world, plain numbers, shape (3, 3)."""
        return self.pose[2 * foot, :3, :3].tolist()

"""Coordinates of MuJoCo and of Pinocchio for one body, and the passive forces along them.

Conventions (R is the root's rotation, root to world):

========================  ==========================  ===================================
quantity                  MuJoCo                      Pinocchio
========================  ==========================  ===================================
root quaternion           w, x, y, z                  x, y, z, w
root linear velocity      of the origin, in world     ``R^T`` times that, in the root
root angular velocity     in the root                 the same
root linear acceleration  d/dt of the above           spatial: ``R^T a - omega x v``
========================  ==========================  ===================================
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ampm.geometry import Array


class PassiveJoints(NamedTuple):
    """Springs, dampers and dry friction of a body's coordinates, each shape (nv,)."""

    damping: Array  # [N m s/rad]
    stiffness: Array  # [N m/rad]
    rest: Array  # angle of the spring at rest [rad]
    friction: Array  # dry friction [N m]
    implicit: bool  # whether the integrator takes the damping at the velocity after the step


def _rotate(quaternion_wxyz: Array, vector: Array, *, inverse: bool = False) -> Array:
    """Rotate ``vector`` (..., 3) by unit quaternions (..., 4), or by their inverses.

    With the quaternion's parts w and u: ``v + 2 w (u x v) + 2 u x (u x v)``.
    """
    w, u = quaternion_wxyz[..., :1], quaternion_wxyz[..., 1:]
    across = 2.0 * np.cross(u, vector)
    return np.asarray(vector + (-w if inverse else w) * across + np.cross(u, across))


def to_pinocchio(qpos: ArrayLike, qvel: ArrayLike) -> tuple[Array, Array]:
    """Convert states of a free-root body from MuJoCo to Pinocchio, as new arrays.

    ``qpos`` (..., nq), with a unit quaternion, and ``qvel`` (..., nv) become q and v of the same shapes.
    """
    q, v = np.array(qpos, dtype=float), np.array(qvel, dtype=float)
    v[..., :3] = _rotate(q[..., 3:7], v[..., :3], inverse=True)
    q[..., 3:7] = np.roll(q[..., 3:7], -1, axis=-1)
    return q, v


def spatial_acceleration(qpos: Array, v: Array, change: Array) -> Array:
    """Accelerations in Pinocchio's coordinates, as a new array.

    ``qpos`` (..., nq) is MuJoCo's, ``v`` (..., nv) Pinocchio's, and ``change`` (..., nv) the rate of MuJoCo's
    ``qvel``.
    """
    acceleration = np.array(change)
    root = _rotate(qpos[..., 3:7], change[..., :3], inverse=True)
    acceleration[..., :3] = root - np.cross(v[..., 3:6], v[..., :3])
    return acceleration


def to_mujoco(q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Convert states of a free-root body from Pinocchio to MuJoCo; the inverse of :func:`to_pinocchio`."""
    qpos, qvel = np.array(q, dtype=float), np.array(v, dtype=float)
    qpos[..., 3:7] = np.roll(qpos[..., 3:7], 1, axis=-1)
    qvel[..., :3] = _rotate(qpos[..., 3:7], qvel[..., :3])
    return qpos, qvel

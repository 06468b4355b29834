"""From MuJoCo to Pinocchio: the same body for the planner's and controller's algebra.

The Pinocchio model is built from the *compiled* MuJoCo model, so both have the same numbers; Pinocchio's own
MJCF reader loses the mass of geoms that touch nothing, the joint names of hinge stacks and the effort limits.
Joint, velocity and actuator order are MuJoCo's.

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

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from ampm.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

_FREE, _SLIDE, _HINGE = (
    int(mujoco.mjtJoint.mjJNT_FREE),
    int(mujoco.mjtJoint.mjJNT_SLIDE),
    int(mujoco.mjtJoint.mjJNT_HINGE),
)
_ALIGNED = {
    (_HINGE, 0): pin.JointModelRX,
    (_HINGE, 1): pin.JointModelRY,
    (_HINGE, 2): pin.JointModelRZ,
    (_SLIDE, 0): pin.JointModelPX,
    (_SLIDE, 1): pin.JointModelPY,
    (_SLIDE, 2): pin.JointModelPZ,
}


def _pose(position: ArrayLike, quaternion_wxyz: ArrayLike) -> pin.SE3:
    """Pose from a position (3,) [m] and a MuJoCo quaternion (4,)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion_wxyz, dtype=float))
    return pin.SE3(matrix.reshape(3, 3), np.asarray(position, dtype=float))


def _shift(offset: Array) -> pin.SE3:
    return pin.SE3(np.eye(3), np.asarray(offset, dtype=float))


def _joint_model(kind: int, axis: Array) -> Any:
    for index in range(3):
        if np.array_equal(axis, np.eye(3)[index]):
            return _ALIGNED[kind, index]()
    return pin.JointModelRevoluteUnaligned(axis) if kind == _HINGE else pin.JointModelPrismaticUnaligned(axis)


class Passive(NamedTuple):
    """Springs, dampers and dry friction of a body's coordinates, each shape (nv,).

    Attributes:
        damping: [N m s/rad].
        stiffness: [N m/rad].
        rest: angle of the spring at rest [rad].
        friction: dry friction [N m].
        implicit: whether the integrator takes the damping at the velocity after the step.
    """

    damping: Array
    stiffness: Array
    rest: Array
    friction: Array
    implicit: bool


def passive_joints(model: mujoco.MjModel) -> Passive:
    """Springs, dampers and dry friction of a compiled model with a free root."""
    stiffness, rest = np.zeros(model.nv), np.zeros(model.nv)
    stiffness[model.jnt_dofadr] = model.jnt_stiffness
    rest[model.jnt_dofadr] = model.qpos_spring[model.jnt_qposadr]
    stiffness[:6] = rest[:6] = 0.0
    explicit = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    euler = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    return Passive(
        damping=model.dof_damping.copy(),
        stiffness=stiffness,
        rest=rest,
        friction=model.dof_frictionloss.copy(),
        implicit=not (euler and model.opt.disableflags & explicit),
    )


def pinocchio_model(model: mujoco.MjModel) -> pin.Model:
    """Build the Pinocchio model of a compiled MuJoCo model.

    One Pinocchio joint per MuJoCo joint, of the same name and in the same order, chained through hinge
    stacks; inertias from ``body_mass/ipos/iquat/inertia``; armature; gravity; limits of position and effort
    (motors on joints). Frames: one per body (``BODY``), per site (``OP_FRAME``) and per joint (``JOINT``).

    Args:
        model: compiled model with a free root or none, and hinges and slides.

    Returns:
        The model; it shares no memory with ``model``.

    Raises:
        InputError: for what has no counterpart: ball joints, free joints below the world, reference angles,
            names that are missing or used twice.
    """
    result = pin.Model()
    result.name = model.names[: model.names.index(b"\0")].decode() or "body"
    result.gravity = pin.Motion(np.asarray(model.opt.gravity, dtype=float), np.zeros(3))

    # Per MuJoCo body: the Pinocchio joint it moves with, and the body's frame relative to that joint.
    joint_of = [0] * model.nbody
    placement_of = [pin.SE3.Identity() for _ in range(model.nbody)]
    frame_of = [0] * model.nbody
    used: set[str] = {"universe"}

    def take(name: str, what: str) -> str:
        if not name:
            raise InputError(f"A {what} of the model has no name; name every joint, body and site.")
        if name in used:
            raise InputError(f"The name {name!r} is used twice in the model; rename the {what}.")
        used.add(name)
        return name

    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        parent_joint, parent_frame = joint_of[parent], frame_of[parent]
        placement = placement_of[parent] * _pose(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            kind = int(model.jnt_type[joint])
            name = take(model.joint(joint).name, "joint")
            if kind == _FREE:
                if parent != 0:
                    raise InputError(
                        f"The free joint {name!r} hangs on a segment; it must hang on the world."
                    )
                placement = pin.SE3.Identity()
                kind_model, anchor = pin.JointModelFreeFlyer(), np.zeros(3)
            elif kind in (_HINGE, _SLIDE):
                address = int(model.jnt_qposadr[joint])
                if model.qpos0[address] != 0.0:
                    raise InputError(f"The joint {name!r} has a reference angle; set its ref to 0.")
                kind_model, anchor = _joint_model(kind, model.jnt_axis[joint]), model.jnt_pos[joint]
            else:
                raise InputError(f"The ball joint {name!r} is not supported; use three hinges.")
            parent_joint = result.addJoint(parent_joint, kind_model, placement * _shift(anchor), name)
            parent_frame = result.addJointFrame(parent_joint, parent_frame)
            # The body frame (before the next joint moves it) lies at minus the anchor.
            placement = _shift(-np.asarray(anchor))
            _set_limits(result, model, joint, parent_joint)
        joint_of[body], placement_of[body] = parent_joint, placement
        result.appendBodyToJoint(parent_joint, _inertia(model, body), placement)
        frame_of[body] = result.addBodyFrame(
            take(model.body(body).name, "body"), parent_joint, placement, parent_frame
        )

    for site in range(model.nsite):
        body = int(model.site_bodyid[site])
        pose = placement_of[body] * _pose(model.site_pos[site], model.site_quat[site])
        frame = pin.Frame(
            take(model.site(site).name, "site"), joint_of[body], frame_of[body], pose, pin.FrameType.OP_FRAME
        )
        result.addFrame(frame)

    if result.nq != model.nq or result.nv != model.nv:
        raise InputError(f"The model has {model.nv} velocities, its Pinocchio twin {result.nv}.")
    result.armature = np.array(model.dof_armature, dtype=float)
    _set_efforts(result, model)
    return result


def _inertia(model: mujoco.MjModel, body: int) -> pin.Inertia:
    """Inertia of a body in its frame, from the compiled principal axes."""
    pose = _pose(model.body_ipos[body], model.body_iquat[body])
    principal = np.diag(model.body_inertia[body])
    return pose * pin.Inertia(float(model.body_mass[body]), np.zeros(3), principal)


def _set_limits(result: pin.Model, model: mujoco.MjModel, joint: int, pin_joint: int) -> None:
    entry = result.joints[pin_joint]
    if entry.nq > 1:  # Pinocchio's own limits of a free joint are its largest numbers
        return
    lower, upper = result.lowerPositionLimit, result.upperPositionLimit
    limited = model.jnt_limited[joint]
    lower[entry.idx_q], upper[entry.idx_q] = model.jnt_range[joint] if limited else (-np.inf, np.inf)
    result.lowerPositionLimit, result.upperPositionLimit = lower, upper


def _set_efforts(result: pin.Model, model: mujoco.MjModel) -> None:
    """Effort limits of motors, in both directions: gear times the tightest range; 0 without motor."""
    limit = np.zeros(model.nv)
    for actuator in range(model.nu):
        if int(model.actuator_trntype[actuator]) != int(mujoco.mjtTrn.mjTRN_JOINT):
            continue
        dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
        low, high = -np.inf, np.inf
        if model.actuator_ctrllimited[actuator]:
            low, high = model.actuator_ctrlrange[actuator]
        if model.actuator_forcelimited[actuator]:
            low = max(low, model.actuator_forcerange[actuator, 0])
            high = min(high, model.actuator_forcerange[actuator, 1])
        limit[dof] = min(-low, high) * abs(float(model.actuator_gear[actuator, 0]))
    result.effortLimit = limit


def _rotate(quaternion_wxyz: Array, vector: Array, *, inverse: bool = False) -> Array:
    """Rotate ``vector`` (..., 3) by unit quaternions (..., 4), or by their inverses."""
    w, x, y, z = (quaternion_wxyz[..., i] for i in range(4))
    if inverse:
        w = -w
    a, b, c = (vector[..., i] for i in range(3))
    # v + 2 w (u x v) + 2 u x (u x v), written out for speed: this runs in every control tick.
    s, t, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    result = np.empty((*np.broadcast_shapes(quaternion_wxyz.shape[:-1], vector.shape[:-1]), 3))
    result[..., 0] = a + w * s + (y * r - z * t)
    result[..., 1] = b + w * t + (z * s - x * r)
    result[..., 2] = c + w * r + (x * t - y * s)
    return result


def _check(positions: ArrayLike, rates: ArrayLike) -> tuple[Array, Array]:
    q, v = np.asarray(positions, dtype=float), np.asarray(rates, dtype=float)
    if q.ndim == 0 or q.shape[-1] < 7 or v.shape != (*q.shape[:-1], q.shape[-1] - 1):
        raise InputError(
            f"A state with positions of shape {q.shape} and rates of shape {v.shape} is no free-root state; "
            "the last axes must be nq >= 7 and nq - 1."
        )
    return q, v


def to_pinocchio(qpos: ArrayLike, qvel: ArrayLike) -> tuple[Array, Array]:
    """Convert states of a free-root body from MuJoCo to Pinocchio.

    Args:
        qpos: MuJoCo positions (..., nq); unit quaternion.
        qvel: MuJoCo velocities (..., nv).

    Returns:
        Pinocchio q (..., nq) and v (..., nv), new arrays.

    Raises:
        InputError: if the shapes do not belong together.
    """
    qpos, qvel = _check(qpos, qvel)
    q, v = qpos.copy(), qvel.copy()
    q[..., 3:6], q[..., 6] = qpos[..., 4:7], qpos[..., 3]
    v[..., :3] = _rotate(qpos[..., 3:7], qvel[..., :3], inverse=True)
    return q, v


def to_mujoco(q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Convert states of a free-root body from Pinocchio to MuJoCo; the inverse of :func:`to_pinocchio`."""
    q, v = _check(q, v)
    qpos, qvel = q.copy(), v.copy()
    qpos[..., 4:7], qpos[..., 3] = q[..., 3:6], q[..., 6]
    qvel[..., :3] = _rotate(qpos[..., 3:7], v[..., :3])
    return qpos, qvel

"""From MuJoCo to Pinocchio: the same body for the planner's and controller's algebra.

The Pinocchio model is built from the *compiled* MuJoCo model, so both have the same numbers; Pinocchio's own
MJCF reader loses the mass of geoms that touch nothing, the joint names of hinge stacks and the effort limits.
Joint, velocity and actuator order are MuJoCo's, root coordinates those of
:mod:`validation.trial.coordinates`.
"""

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ampm.geometry import Array
from validation.trial.coordinates import PassiveJoints

_ALIGNED = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)  # hinges about an axis of their frame


def rotation(quaternion_wxyz: ArrayLike) -> Array:
    """Rotation matrix of a unit quaternion, w first."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion_wxyz, dtype=float))
    return matrix.reshape(3, 3)


def _pose(position: ArrayLike, quaternion_wxyz: ArrayLike) -> pin.SE3:
    """Pose from a position (3,) [m] and a MuJoCo quaternion (4,)."""
    return pin.SE3(rotation(quaternion_wxyz), np.asarray(position, dtype=float))


def _hinge(axis: Array) -> Any:
    for own, along in zip(_ALIGNED, np.eye(3), strict=True):
        if np.array_equal(axis, along):
            return own()
    return pin.JointModelRevoluteUnaligned(axis)


def passive_joints(model: mujoco.MjModel) -> PassiveJoints:
    """Springs, dampers and dry friction of a compiled model with a free root."""
    stiffness, rest = np.zeros(model.nv), np.zeros(model.nv)
    stiffness[model.jnt_dofadr] = model.jnt_stiffness
    rest[model.jnt_dofadr] = model.qpos_spring[model.jnt_qposadr]
    stiffness[:6] = rest[:6] = 0.0
    explicit = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    euler = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    return PassiveJoints(
        damping=model.dof_damping.copy(),
        stiffness=stiffness,
        rest=rest,
        friction=model.dof_frictionloss.copy(),
        implicit=not (euler and model.opt.disableflags & explicit),
    )


def pinocchio_model(model: mujoco.MjModel) -> pin.Model:
    """Build the Pinocchio model of a compiled body; it shares no memory with it.

    One Pinocchio joint per MuJoCo joint, of the same name and in the same order, chained through hinge
    stacks; inertias from ``body_mass/ipos/iquat/inertia``; armature; gravity; limits of position and effort.
    Frames: one per body (``BODY``), per site (``OP_FRAME``) and per joint (``JOINT``). The model is as
    :mod:`models.load` makes it: a free root, hinges without a reference angle, a motor for every hinge;
    names of joints, bodies and sites differ.
    """
    result = pin.Model()
    result.name = model.names[: model.names.index(b"\0")].decode() or "body"
    result.gravity = pin.Motion(np.asarray(model.opt.gravity, dtype=float), np.zeros(3))
    # Per MuJoCo body: the Pinocchio joint it moves with, and the body's frame relative to that joint.
    joint_of = [0] * model.nbody
    placement_of = [pin.SE3.Identity() for _ in range(model.nbody)]
    frame_of = [0] * model.nbody
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        parent_joint, parent_frame = joint_of[parent], frame_of[parent]
        placement = placement_of[parent] * _pose(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            kind, anchor = _hinge(model.jnt_axis[joint]), model.jnt_pos[joint]
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                kind, anchor, placement = pin.JointModelFreeFlyer(), np.zeros(3), pin.SE3.Identity()
            name = model.joint(joint).name
            parent_joint = result.addJoint(parent_joint, kind, placement * pin.SE3(np.eye(3), anchor), name)
            parent_frame = result.addJointFrame(parent_joint, parent_frame)
            # The body frame (before the next joint moves it) lies at minus the anchor.
            placement = pin.SE3(np.eye(3), -anchor)
        joint_of[body], placement_of[body] = parent_joint, placement
        inertia = pin.Inertia(float(model.body_mass[body]), np.zeros(3), np.diag(model.body_inertia[body]))
        own = _pose(model.body_ipos[body], model.body_iquat[body])
        result.appendBodyToJoint(parent_joint, own * inertia, placement)
        name = model.body(body).name
        frame_of[body] = result.addBodyFrame(name, parent_joint, placement, parent_frame)
    for site in range(model.nsite):
        body, name = int(model.site_bodyid[site]), model.site(site).name
        pose = placement_of[body] * _pose(model.site_pos[site], model.site_quat[site])
        kind = pin.FrameType.OP_FRAME
        result.addFrame(pin.Frame(name, joint_of[body], frame_of[body], pose, kind))
    limited = model.jnt_limited[1:, None].astype(bool)
    low, high = np.where(limited, model.jnt_range[1:], [-np.inf, np.inf]).T
    limits = [result.lowerPositionLimit, result.upperPositionLimit, np.zeros(model.nv)]
    limits[0][7:], limits[1][7:] = low, high
    limits[2][model.jnt_dofadr[model.actuator_trnid[:, 0]]] = model.actuator_ctrlrange[:, 1]
    result.lowerPositionLimit, result.upperPositionLimit, result.effortLimit = limits
    result.armature = np.array(model.dof_armature, dtype=float)
    return result

"""Bodies small enough to check by hand, simulated into records: a block on four points that swings an arm."""

from collections import defaultdict
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from tests.records import blank
from validation.trial.outcome import Outcome, OutcomeName

MASS = 10.0
ARM_MASS = 2.0
GRAVITY = 9.81
CORNERS = ((-0.2, 0.15), (0.2, 0.15), (-0.2, -0.15), (0.2, -0.15))
XML = """
<mujoco>
  <option timestep="{dt}" integrator="Euler" cone="elliptic" impratio="10"/>
  <default><geom contype="1" conaffinity="0" condim="3" friction="0.8" solref="0.015 1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" contype="0" conaffinity="1"/>
    <body name="block">
      <freejoint name="root"/>
      <inertial pos="0 0 .25" mass="10" diaginertia=".4 .5 .3"/>
      {points}
      <body name="arm" pos="0 .02 .4">
        <joint name="swing" type="hinge" axis="0 1 0" range="-2 2"/>
        <inertial pos="0 0 -.3" mass="2" diaginertia=".02 .02 .005"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="swing" gear="1" ctrlrange="-50 50"/></actuator>
  <sensor><subtreecom name="com" body="block"/><subtreeangmom name="momentum" body="block"/></sensor>
</mujoco>
"""


def pinocchio_model():
    """The same body by hand: written from the numbers above, not converted: a second witness."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    block = pin.Inertia(MASS, np.array([0, 0, 0.25]), np.diag([0.4, 0.5, 0.3]))
    model.appendBodyToJoint(root, block, pin.SE3.Identity())
    placement = pin.SE3(np.eye(3), np.array([0, 0.02, 0.4]))
    swing = model.addJoint(root, pin.JointModelRY(), placement, "swing")
    arm = pin.Inertia(ARM_MASS, np.array([0, 0, -0.3]), np.diag([0.02, 0.02, 0.005]))
    model.appendBodyToJoint(swing, arm, pin.SE3.Identity())
    return model


def simulate(steps=500, dt=0.002, torque=lambda time: 0.0, height=0.0, sink=0.0):
    """Step the block and log it as the testbed logs a walk: forces of step k belong to the state at t_k."""
    point = '<geom name="p{}" type="sphere" size=".001" pos="{} {} .001"/>'
    points = "\n".join(point.format(i, *corner) for i, corner in enumerate(CORNERS))
    model = mujoco.MjModel.from_xml_string(XML.format(dt=dt, points=points))
    data = mujoco.MjData(model)
    data.qpos[2] = height - sink
    log: dict[str, list] = defaultdict(list)
    geoms = [model.geom(f"p{i}").id for i in range(4)]

    def keep(**values):
        for name, value in values.items():
            log[name].append(np.array(value))

    for k in range(steps):
        data.ctrl[:] = torque(k * dt)
        keep(q=data.qpos, qd=data.qvel, tick_torque=data.ctrl)
        mujoco.mj_step1(model, data)
        positions = data.geom_xpos[geoms].copy()
        keep(point_place=positions)
        mujoco.mj_step2(model, data)
        force, depth = np.zeros((4, 3)), np.zeros(4)
        for index, contact in enumerate(data.contact):
            local = np.zeros(6)
            mujoco.mj_contactForce(model, data, index, local)
            i = geoms.index(contact.geom2)
            force[i] = contact.frame.reshape(3, 3).T @ local[:3]
            positions[i] = contact.pos
            depth[i] = max(0.0, -contact.dist)
        keep(point_force=force, point_position=positions, point_penetration=depth)
        keep(com=data.sensor("com").data, angular_momentum=data.sensor("momentum").data)
    keep(q=data.qpos, qd=data.qvel)
    mujoco.mj_forward(model, data)
    keep(com=data.sensor("com").data, angular_momentum=data.sensor("momentum").data)
    keep(point_place=data.geom_xpos[geoms])
    arrays: dict[str, Any] = {name: np.array(values) for name, values in log.items()}
    q, force = arrays["q"], arrays["point_force"]
    return blank(
        steps,
        **arrays,
        point_foot=np.array([0, 0, 1, 1], dtype=np.int8),
        point_group=np.array([0, 2, 0, 2], dtype=np.int8),
        foot_position=np.stack([q[:, :3], q[:, :3]], axis=1),
        command_com=arrays["com"][:-1],
        command_force=force.sum(axis=1),
        command_angular_momentum=arrays["angular_momentum"][:-1],
        outcome=Outcome(OutcomeName.COMPLETED, steps * dt, "", 4),
        mass=MASS + ARM_MASS,
        gravity=GRAVITY,
        time_step=dt,
        friction=0.8,
        torque_limit=np.array([50.0]),
        joint_range=model.jnt_range[1:].copy(),
        joint_names=("swing",),
    )


def swinging(steps=500, dt=0.002):
    """A walk's stand-in: the arm swings hard enough to move the ZMP by centimetres, the block stays down."""
    return simulate(steps, dt, torque=lambda time: 6.0 * np.sin(2 * np.pi * 1.5 * time), sink=0.0005)

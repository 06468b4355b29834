"""The smallest physics first: what a block, a falling body and a still human must do."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from ampm.description import BodyDescription
from ampm.parameters import BodyParameters, RunParameters
from models.human import build
from validation.trial.bridge import pinocchio_model, to_pinocchio

GRAVITY = 9.81

BLOCK_XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" cone="elliptic" impratio="10" tolerance="1e-12"/>
  <default><geom condim="3" friction="0.8" solref="0.015 1" solimp="0.9 0.95 0.001"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="0"/>
    <body name="block" pos="0 0 0.1">
      <freejoint/>
      <inertial pos="0.03 -0.02 0" mass="4" diaginertia="0.05 0.05 0.05"/>
      <geom type="sphere" size="0.001" pos=" 0.1  0.08 -0.099" contype="0" conaffinity="1"/>
      <geom type="sphere" size="0.001" pos="-0.1  0.08 -0.099" contype="0" conaffinity="1"/>
      <geom type="sphere" size="0.001" pos=" 0.1 -0.08 -0.099" contype="0" conaffinity="1"/>
      <geom type="sphere" size="0.001" pos="-0.1 -0.08 -0.099" contype="0" conaffinity="1"/>
    </body>
  </worldbody>
</mujoco>
"""


def contact_wrench(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Force (3,) [N] of the floor on the rest and its moment (3,) [N m] about the world's origin."""
    force, moment, local = np.zeros(3), np.zeros(3), np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        mujoco.mj_contactForce(model, data, index, local)
        # MuJoCo's contact frame has its normal as first row, pointing from geom1 (the floor) to geom2.
        world = contact.frame.reshape(3, 3).T @ local[:3]
        force += world
        moment += np.cross(contact.pos, world)
    return force, moment


def zmp(force: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Point of the floor (2,) [m] about which the horizontal moment of the contact wrench vanishes."""
    return np.array([-moment[1], moment[0]]) / force[2]


def test_resting_block_weighs_mg_under_its_com() -> None:
    model = mujoco.MjModel.from_xml_string(BLOCK_XML)
    data = mujoco.MjData(model)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    force, moment = contact_wrench(model, data)
    np.testing.assert_allclose(force, [0.0, 0.0, 4.0 * GRAVITY], atol=1e-5)
    np.testing.assert_allclose(zmp(force, moment), data.subtree_com[1][:2], atol=1e-6)
    np.testing.assert_allclose(data.subtree_com[1][:2], [0.03, -0.02], atol=1e-3)


def test_pulled_block_has_its_zmp_where_statics_puts_it() -> None:
    """A horizontal pull P at height h shifts the ZMP by P h / (m g) and is answered by friction."""
    model = mujoco.MjModel.from_xml_string(BLOCK_XML)
    data = mujoco.MjData(model)
    data.xfrc_applied[1, 0] = pull = 5.0
    for _ in range(2000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    force, moment = contact_wrench(model, data)
    com = data.subtree_com[1]
    np.testing.assert_allclose(force, [-pull, 0.0, 4.0 * GRAVITY], atol=1e-4)
    np.testing.assert_allclose(
        zmp(force, moment), com[:2] + np.array([pull * com[2] / (4.0 * GRAVITY), 0.0]), atol=1e-5
    )


def test_block_slides_where_friction_ends() -> None:
    """No instant exceeds the friction cone, and a sliding block is slowed by mu times the load it had."""
    model = mujoco.MjModel.from_xml_string(BLOCK_XML)
    data = mujoco.MjData(model)
    # Pull at the floor's height, so that the block slides and does not tip.
    data.xfrc_applied[1, 0] = pull = 1.2 * 0.8 * 4.0 * GRAVITY
    data.xfrc_applied[1, 4] = -pull * 0.1
    total = np.zeros(3)
    for _ in range(60):
        mujoco.mj_step(model, data)
        force, _ = contact_wrench(model, data)
        assert np.hypot(force[0], force[1]) <= 0.8 * force[2] + 1e-9
        total += force
    assert data.qvel[0] > 0.1
    assert -total[0] / total[2] == pytest.approx(0.8, rel=0.02)
    # Impulse and momentum: what is not friction has gone into speed.
    gained = 4.0 * (data.qvel[0] + np.cross(data.qvel[3:6], [0.03, -0.02, 0.0])[0])
    assert gained == pytest.approx((60 * pull + total[0]) * model.opt.timestep, rel=2e-3)


def test_falling_body_follows_the_scheme_of_the_integrator() -> None:
    """Semi-implicit Euler: v_n = -g n dt exactly, and z_n = z_0 - g dt^2 n (n + 1) / 2."""
    model = mujoco.MjModel.from_xml_string(BLOCK_XML)
    data = mujoco.MjData(model)
    data.qpos[2] = 10.0
    steps, dt = 300, model.opt.timestep
    for _ in range(steps):
        mujoco.mj_step(model, data)
    assert data.ncon == 0
    assert data.qvel[2] == pytest.approx(-GRAVITY * steps * dt, rel=1e-12)
    assert data.qpos[2] == pytest.approx(10.0 - GRAVITY * dt**2 * steps * (steps + 1) / 2.0, rel=1e-12)


class Human:
    """The default human, its Pinocchio twin, and a place to step it."""

    def __init__(self, *, time_step: float = 0.002) -> None:
        run = RunParameters()
        simulation = run.simulation.model_copy(update={"time_step": time_step})
        built = build(BodyParameters(), run.contact, simulation)
        self.description: BodyDescription = built.description
        self.model = built.compile()
        self.data = mujoco.MjData(self.model)
        self.twin = pinocchio_model(self.model)
        self.twin_data = self.twin.createData()
        self.limits = self.model.actuator_ctrlrange[:, 1]

    def bend(self, *, knee: float) -> None:
        """Stand with bent knees, flat soles and the COM over the middle of the soles."""
        model, data = self.model, self.data
        for leg in self.description.legs:
            for joint, angle in ((leg.hip[0], -0.5 * knee), (leg.knee, knee), (leg.ankle[0], -0.5 * knee)):
                data.joint(joint).qpos[0] = angle
        for arm in (self.description.left_arm, self.description.right_arm):
            data.joint(arm[3]).qpos[0] = -0.4
        mujoco.mj_kinematics(model, data)
        data.qpos[2] -= min(data.site(name).xpos[2] for _, _, name in self.description.sole_points())
        # Swing the legs until the soles' middle is under the COM.
        for _ in range(20):
            mujoco.mj_fwdPosition(model, data)
            middle = np.mean([data.site(leg.sole_frame).xpos[0] for leg in self.description.legs])
            error = data.subtree_com[1][0] - middle
            for leg in self.description.legs:
                data.joint(leg.hip[0]).qpos[0] -= error
                data.joint(leg.ankle[0]).qpos[0] += error
        mujoco.mj_fwdPosition(model, data)
        data.qpos[2] -= min(data.site(name).xpos[2] for _, _, name in self.description.sole_points())

    def momentum(self) -> np.ndarray:
        """Linear and angular momentum about the COM, shape (6,), by Pinocchio."""
        q, v = to_pinocchio(self.data.qpos, self.data.qvel)
        return pin.computeCentroidalMomentum(self.twin, self.twin_data, q, v).vector.copy()


def test_flight_keeps_momentum_whatever_the_joints_do() -> None:
    """Internal torques change neither the angular momentum nor the parabola of the COM.

    In a discrete simulation that holds to the order of the time step: halving it must halve the drift.
    """
    drifts = []
    for time_step in (0.002, 0.001, 0.0005):
        human = Human(time_step=time_step)
        rng = np.random.default_rng(5)
        data = human.data
        data.qpos[2] += 20.0
        data.qvel[:6] = [0.5, -0.3, 1.0, 0.4, 0.8, -0.5]
        data.qpos[7:] = np.mean(human.model.jnt_range[1:], axis=1)
        amplitude, phase = 0.001 * human.limits * rng.normal(size=34), rng.uniform(0, 6.28, 34)
        start = human.momentum()
        steps = round(0.1 / time_step)
        for step in range(steps):
            data.ctrl[:] = amplitude * np.sin(30.0 * step * time_step + phase)
            mujoco.mj_step(human.model, data)
        assert np.abs(data.qvel[6:]).max() > 0.5, "the joints must have moved"
        assert data.ncon == 0
        end = human.momentum()
        mass = human.description.mass
        end[2] += mass * GRAVITY * steps * time_step
        drifts.append(np.abs(end - start))
    drift = [float(d[3:].max()) for d in drifts]
    assert drift[0] < 0.05
    assert drift[1] < 0.6 * drift[0]
    assert drift[2] < 0.6 * drift[1]
    assert drifts[2][:3].max() < 0.1 * 60.0 * 0.1 * GRAVITY


def standing_torque(human: Human, qpos: np.ndarray) -> np.ndarray:
    """Torques (34,) [N m] that hold a posture: computed torque, the floor's share by least squares."""
    model, data = human.model, human.data
    difference = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, difference, 1.0, data.qpos, qpos)
    wanted = 150.0 * difference - 25.0 * data.qvel
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    generalised = full @ wanted + data.qfrc_bias
    jacobian = np.zeros((36, model.nv))
    for index, (_, _, name) in enumerate(human.description.sole_points()):
        mujoco.mj_jacSite(model, data, jacobian[3 * index : 3 * index + 3], None, data.site(name).id)
    force = np.linalg.lstsq(jacobian[:, :6].T, generalised[:6], rcond=None)[0]
    return np.clip((generalised - jacobian.T @ force)[6:], -human.limits, human.limits)


def test_still_human_weighs_mg_with_the_zmp_under_the_com() -> None:
    human = Human()
    model, data = human.model, human.data
    human.bend(knee=0.5)
    rest = data.qpos.copy()
    for _ in range(1000):
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.ctrl[:] = standing_torque(human, rest)
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    force, moment = contact_wrench(model, data)
    weight = human.description.mass * GRAVITY
    assert data.ncon == 12
    assert np.abs(data.qvel).max() < 1e-8
    np.testing.assert_allclose(force, [0.0, 0.0, weight], atol=1e-6 * weight)
    np.testing.assert_allclose(zmp(force, moment), data.subtree_com[1][:2], atol=1e-6)
    penetration = -data.contact.dist
    assert 0.0 < penetration.max() < 0.002
    assert np.abs(data.ctrl).max() < 0.5 * human.limits.max()

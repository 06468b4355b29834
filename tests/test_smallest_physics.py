"""The smallest physics first: what a block, a falling body and a human in flight must do."""

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

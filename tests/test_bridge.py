"""MuJoCo and Pinocchio must be the same body: their inverse dynamics, momenta and frames agree to 1e-9.

The human: masses, proportions, symmetry, and that the description tells the truth about the model.
"""

import itertools
import os
import subprocess
import sys

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from ampm.description import BodyDescription
from ampm.parameters import BodyParameters, RunParameters
from docs import human as table
from models.load import build_body
from tests.test_tick import close
from validation.trial.bridge import pinocchio_model
from validation.trial.coordinates import to_pinocchio

# What the human does not exercise: rotated and offset bodies, anchors off the origin, oblique axes, a welded
# segment, armature, turned inertia.
ODD_XML = """
<mujoco model="odd">
  <compiler angle="radian"/>
  <option gravity="0.3 0 -9.7"/>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.9" quat="0.8 0.2 0.5 0.1">
      <freejoint name="free"/>
      <inertial pos="0.02 -0.01 0.05" mass="4" fullinertia="0.05 0.07 0.06 0.004 -0.006 0.003"/>
      <body name="arm" pos="0.1 0 0.2" quat="0.7 0.1 -0.3 0.4">
        <joint name="oblique" axis="1 2 -1" pos="0.02 0.03 -0.05" armature="0.02"/>
        <joint name="second" axis="0 0 1" pos="-0.01 0.01 0.04" range="-1 2"/>
        <inertial pos="0 0.1 0.1" quat="0.9 0.1 0.3 0.2" mass="1.5" diaginertia="0.01 0.02 0.015"/>
        <body name="welded" pos="0 0 0.3" quat="0.5 0.5 0.5 0.5">
          <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.002 0.0015"/>
          <site name="tip" pos="0.1 0.2 0.3" quat="0.6 0.1 0.2 0.7"/>
          <body name="rod" pos="0 0.1 0">
            <joint name="third" axis="0 1 0" armature="0.1"/>
            <joint name="fourth" axis="0.6 0 0.8" pos="0.1 0 0"/>
            <inertial pos="0 0 0.05" mass="0.7" diaginertia="0.003 0.002 0.001"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module", params=["odd", "human"])
def model(request: pytest.FixtureRequest) -> mujoco.MjModel:
    human = RunParameters(body=BodyParameters(height=1.55, mass=95.0))
    odd = request.param == "odd"
    result = mujoco.MjModel.from_xml_string(ODD_XML) if odd else build_body(human).compile()
    result.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    return result


class Both:
    """The same random state in both libraries; ``map`` turns MuJoCo's velocities into Pinocchio's."""

    def __init__(self, model: mujoco.MjModel, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.model, self.data = model, mujoco.MjData(model)
        self.qpos = rng.uniform(-1.2, 1.2, model.nq)
        self.qpos[:3] *= 3.0
        self.qpos[3:7] = rng.normal(size=4)
        self.qpos[3:7] /= np.linalg.norm(self.qpos[3:7])
        self.qvel = rng.normal(size=model.nv) * 2.0
        self.qacc = rng.normal(size=model.nv) * 10.0
        self.data.qpos, self.data.qvel = self.qpos, self.qvel
        mujoco.mj_forward(model, self.data)
        mujoco.mj_subtreeVel(model, self.data)
        self.pin_model = pinocchio_model(model)
        self.pin_data = self.pin_model.createData()
        self.q, self.v = to_pinocchio(self.qpos, self.qvel)
        self.map = np.eye(model.nv)
        self.map[:3, :3] = pin.Quaternion(self.q[3:7]).toRotationMatrix().T
        self.mass = float(model.body_mass.sum())

    def acceleration(self, qacc: np.ndarray) -> np.ndarray:
        """Pinocchio's acceleration: the root's is spatial, in its own axes."""
        a = self.map @ qacc
        a[:3] -= np.cross(self.v[3:6], self.v[:3])
        return a


@pytest.fixture(params=range(2))
def both(model: mujoco.MjModel, request: pytest.FixtureRequest) -> Both:
    return Both(model, request.param)


def test_joint_order_names_and_limits(model: mujoco.MjModel) -> None:
    twin = pinocchio_model(model)
    assert list(twin.names)[1:] == [model.joint(i).name for i in range(model.njnt)]
    for i in range(model.njnt):
        entry = twin.joints[twin.getJointId(model.joint(i).name)]
        assert (entry.idx_v, entry.idx_q) == (model.jnt_dofadr[i], model.jnt_qposadr[i])
        if model.jnt_limited[i]:
            limits = twin.lowerPositionLimit[entry.idx_q], twin.upperPositionLimit[entry.idx_q]
            assert limits == tuple(model.jnt_range[i])
        if model.nu:
            limit = np.pad(model.actuator_ctrlrange[:, 1], (6, 0))
            assert twin.effortLimit[entry.idx_v] == limit[entry.idx_v]
    assert pin.computeTotalMass(twin) == pytest.approx(model.body_mass.sum(), abs=1e-12)


def test_inverse_dynamics(both: Both) -> None:
    both.data.qacc = both.qacc
    mujoco.mj_inverse(both.model, both.data)
    a = both.acceleration(both.qacc)
    close(both.map.T @ pin.rnea(both.pin_model, both.pin_data, both.q, both.v, a), both.data.qfrc_inverse)


def test_com_and_centroidal_momentum(both: Both) -> None:
    momentum = pin.computeCentroidalMomentum(both.pin_model, both.pin_data, both.q, both.v)
    pin.centerOfMass(both.pin_model, both.pin_data, both.q, both.v)
    close(both.pin_data.com[0], both.data.subtree_com[0])
    close(both.pin_data.vcom[0], both.data.subtree_linvel[0])
    close(momentum.linear, both.mass * both.data.subtree_linvel[0])
    close(momentum.angular, both.data.subtree_angmom[0])


def test_frames_their_jacobians_and_drift(both: Both) -> None:
    still = both.acceleration(np.zeros(both.model.nv))
    pin.forwardKinematics(both.pin_model, both.pin_data, both.q, both.v, still)
    pin.computeJointJacobians(both.pin_model, both.pin_data)
    pin.updateFramePlacements(both.pin_model, both.pin_data)
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    linear, angular = np.zeros((2, 3, both.model.nv))
    sites = [(both.data.site(i), both.model.site(i).bodyid[0]) for i in range(both.model.nsite)]
    for there, body in [*sites, *((both.data.body(i), i) for i in range(1, both.model.nbody))]:
        frame, position = both.pin_model.getFrameId(there.name), there.xpos.copy()
        close(both.pin_data.oMf[frame].translation, position)
        close(both.pin_data.oMf[frame].rotation.ravel(), there.xmat)
        mujoco.mj_jac(both.model, both.data, linear, angular, position, body)
        jacobian = pin.getFrameJacobian(both.pin_model, both.pin_data, frame, aligned) @ both.map
        close(jacobian, np.vstack([linear, angular]))
        mujoco.mj_jacDot(both.model, both.data, linear, angular, position, body)
        drift = pin.getFrameClassicalAcceleration(both.pin_model, both.pin_data, frame, aligned).vector
        close(drift, np.concatenate([linear @ both.qvel, angular @ both.qvel]))


@pytest.fixture(scope="module", params=[(1.70, 60.0), (1.20, 25.0)], ids=str)
def body(request: pytest.FixtureRequest) -> tuple[BodyDescription, mujoco.MjModel, mujoco.MjData]:
    """A body in its neutral posture."""
    height, mass = request.param
    built = build_body(RunParameters(body=BodyParameters(height=height, mass=mass)))
    model = built.compile()
    mujoco.mj_forward(model, data := mujoco.MjData(model))
    return built.description, model, data


def test_import_needs_no_display() -> None:
    environment = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    environment.pop("MUJOCO_GL", None)
    code = "import validation.environment, os; assert 'MUJOCO_GL' not in os.environ"
    subprocess.run([sys.executable, "-W", "error", "-c", code], env=environment, check=True, timeout=60)


def test_split_foot_is_the_tables_foot(body) -> None:
    """Foot and toes together have the mass, centre of mass and inertia of the undivided foot."""
    description, model, data = body
    leg, sole = description.left_leg, description.sole
    parts = [model.body(name).id for name in (leg.foot_segment, leg.toe_segment)]
    masses = model.body_mass[parts]
    coms = data.xipos[parts] - data.site(leg.sole_frame).xpos
    com = masses @ coms / masses.sum()
    inertia = np.zeros((3, 3))
    for part, mass, position in zip(parts, masses, coms, strict=True):
        axes = data.ximat[part].reshape(3, 3)
        arm = position - com
        inertia += axes @ np.diag(model.body_inertia[part]) @ axes.T
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    sagittal, transverse, longitudinal = (radius * sole.length for radius in table.FOOT.radii)
    assert masses.sum() == pytest.approx(table.FOOT.mass * description.mass)
    assert com[0] == pytest.approx(sole.heel_x + table.FOOT.com * sole.length)
    expected = masses.sum() * np.diag(np.square([longitudinal, transverse, sagittal]))
    np.testing.assert_allclose(inertia, expected, rtol=0.0, atol=1e-11)


def test_the_file_is_derived_from_the_tables() -> None:
    assert table.Builder().build() == table.FILE.read_text(encoding="utf-8")


def test_table_adds_up() -> None:
    assert abs(table.TOTAL_MASS_SHARE - 1.0) < 1e-12
    # The same segment given between two pairs of landmarks must be the same body: de Leva's upper trunk from
    # suprasternale (170.7 mm, com 29.99 %) and from cervicale (242.1 mm).
    assert 242.1 * table.UPPER_TRUNK.com == pytest.approx(242.1 - 170.7 + 0.2999 * 170.7, abs=0.1)
    assert 242.1 * table.UPPER_TRUNK.radii[0] == pytest.approx(0.716 * 170.7, abs=0.1)


def test_only_sole_points_touch_only_the_floor(body) -> None:
    description, model, _ = body
    points = {name for _, _, name in description.sole_points()}
    touch = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    for i, j in itertools.combinations(range(model.ngeom), 2):
        names = {model.geom(i).name, model.geom(j).name}
        assert (touch[i, j] or touch[j, i]) == ("floor" in names and bool(names & points))
    assert all(model.geom(name).condim[0] == 3 for name in points)

"""The human: masses, proportions, symmetry, and that the description tells the truth about the model."""

import itertools
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from ampm.description import BodyDescription
from ampm.parameters import GRAVITY, BodyParameters, ContactParameters, RunParameters, SimulationParameters
from models import anthropometry as table
from models.__main__ import TARGET, default_xml
from models.human import build

SIZES = [(1.70, 60.0), (1.50, 45.0), (1.95, 110.0), (1.20, 25.0)]


class Standing:
    """A body in its neutral posture."""

    def __init__(self, height: float, mass: float) -> None:
        run = RunParameters()
        built = build(BodyParameters(height=height, mass=mass), run.contact, run.simulation)
        self.height, self.mass = height, mass
        self.description: BodyDescription = built.description
        self.model = built.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)


@pytest.fixture(scope="module", params=SIZES, ids=str)
def body(request: pytest.FixtureRequest) -> Standing:
    return Standing(*request.param)


@pytest.fixture(scope="module")
def default() -> Standing:
    return Standing(1.70, 60.0)


def test_committed_xml_is_what_the_builder_writes() -> None:
    assert TARGET.read_text(encoding="utf-8") == default_xml(), "run `python -m models`"


def test_import_needs_no_display() -> None:
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")
    environment = {name: value for name, value in os.environ.items() if name not in displays}
    code = "import validation.environment, os; assert 'MUJOCO_GL' not in os.environ"
    subprocess.run([sys.executable, "-W", "error", "-c", code], env=environment, check=True, timeout=60)


def test_split_foot_is_the_tables_foot(default: Standing) -> None:
    """Foot and toes together have the mass, centre of mass and inertia of the undivided foot."""
    leg, sole = default.description.left_leg, default.description.sole
    parts = [default.model.body(name).id for name in (leg.foot_segment, leg.toe_segment)]
    masses = default.model.body_mass[parts]
    coms = default.data.xipos[parts] - default.data.site(leg.sole_frame).xpos
    com = masses @ coms / masses.sum()
    inertia = np.zeros((3, 3))
    for part, mass, position in zip(parts, masses, coms, strict=True):
        axes = default.data.ximat[part].reshape(3, 3)
        arm = position - com
        inertia += axes @ np.diag(default.model.body_inertia[part]) @ axes.T
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    sagittal, transverse, longitudinal = (radius * sole.length for radius in table.FOOT.radii)
    assert masses.sum() == pytest.approx(table.FOOT.mass * default.mass)
    assert com[0] == pytest.approx(sole.heel_x + table.FOOT.com * sole.length)
    expected = masses.sum() * np.diag(np.square([longitudinal, transverse, sagittal]))
    np.testing.assert_allclose(inertia, expected, rtol=0.0, atol=1e-11)


def test_table_adds_up() -> None:
    assert abs(table.TOTAL_MASS_SHARE - 1.0) < 1e-12
    # The same segment given between two pairs of landmarks must be the same body: de Leva's upper trunk from
    # suprasternale (170.7 mm, com 29.99 %) and from cervicale (242.1 mm).
    assert 242.1 * table.UPPER_TRUNK.com == pytest.approx(242.1 - 170.7 + 0.2999 * 170.7, abs=0.1)
    assert 242.1 * table.UPPER_TRUNK.radii[0] == pytest.approx(0.716 * 170.7, abs=0.1)


def test_soles_lie_on_the_floor(body: Standing) -> None:
    sole = body.description.sole
    xs = {"heel": sole.heel_x, "ball": sole.ball_x, "tip": sole.tip_x}
    widths = {group: getattr(sole, f"{group}_half_width") for group in xs}
    for index, (foot, group, name) in enumerate(body.description.sole_points()):
        leg = body.description.legs[foot]
        frame = body.data.site(leg.sole_frame)
        edge = 1.0 if index % 2 == 0 else -1.0
        local = body.data.site(name).xpos - frame.xpos
        np.testing.assert_allclose(local, [xs[group], edge * widths[group], 0.0], rtol=0.0, atol=1e-10)
        assert body.data.site(name).xpos[2] == pytest.approx(0.0, abs=1e-10)
        segment = leg.toe_segment if group == "tip" else leg.foot_segment
        assert body.model.site(name).bodyid[0] == body.model.body(segment).id
        # The lowest point of the sphere of the same name is the site.
        centre, radius = body.data.geom(name).xpos, body.model.geom(name).size[0]
        np.testing.assert_allclose(centre - [0, 0, radius], body.data.site(name).xpos, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(frame.xmat, np.eye(3).ravel(), rtol=0.0, atol=1e-12)


def test_toe_axis_passes_through_the_ball_points(body: Standing) -> None:
    """Bending the toe must not move the ball points, nor the toe axis relative to the foot."""
    data = mujoco.MjData(body.model)
    leg = body.description.left_leg
    data.qpos[body.model.joint(leg.toe).qposadr[0]] = -0.5
    mujoco.mj_kinematics(body.model, data)
    axis = data.site("left_toe_axis").xpos
    for name in leg.sole_points[2:4]:
        np.testing.assert_allclose(data.site(name).xpos[[0, 2]], axis[[0, 2]], rtol=0.0, atol=1e-10)
    assert data.site(leg.sole_points[4]).xpos[2] > 0.02, "negative toe angles lift the tip"


def test_description_geometry(body: Standing) -> None:
    d, data = body.description, body.data
    for leg, sign in zip(d.legs, (1.0, -1.0), strict=True):
        hip, ankle = (data.xanchor[body.model.joint(name).id] for name in (leg.hip[0], leg.ankle[0]))
        np.testing.assert_allclose(hip, [0, sign * d.hip_half_width, d.hip_height], rtol=0.0, atol=1e-10)
        assert hip[2] - ankle[2] == pytest.approx(d.leg_length)
        sole = data.site(leg.sole_frame).xpos
        np.testing.assert_allclose(
            ankle - sole, [d.sole.ankle_x, 0.0, d.sole.ankle_height], rtol=0.0, atol=1e-10
        )
    assert (d.height, d.mass) == (body.height, body.mass)


def test_positive_directions(default: Standing) -> None:
    """Knee flexion is positive, hip flexion and elbow flexion are negative about +y."""
    d, model = default.description, default.model

    def moved(joint: str, angle: float, point: str) -> np.ndarray:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        before = data.body(point).xpos.copy()
        data.qpos[model.joint(joint).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        return data.body(point).xpos - before

    leg = d.left_leg
    assert moved(leg.knee, 0.5, leg.foot_segment)[0] < -0.1
    assert moved(leg.hip[0], -0.5, leg.foot_segment)[0] > 0.1
    assert moved(d.left_arm[3], -0.5, "left_hand")[0] > 0.1
    assert moved(d.waist[2], 0.3, d.trunk_segment)[0] > 0.03
    assert model.joint(leg.knee).range[0] == 0.0


def test_actuators_are_torque_motors_in_joint_order(body: Standing) -> None:
    model = body.model
    names, limits = zip(*body.description.torque_limits, strict=True)
    assert tuple(model.joint(i).name for i in range(1, model.njnt)) == names
    np.testing.assert_array_equal(model.actuator_trnid[:, 0], np.arange(1, model.njnt))
    np.testing.assert_array_equal(model.actuator_gear[:, 0], 1.0)
    for ends in (model.actuator_ctrlrange, model.actuator_forcerange):
        np.testing.assert_allclose(ends, np.outer(limits, [-1.0, 1.0]), rtol=1e-11)
    knee = dict(body.description.torque_limits)[body.description.left_leg.knee]
    assert knee == pytest.approx(table.JOINTS["knee_pitch"][2] * body.mass * GRAVITY * body.height)


def test_nothing_passive_disturbs_the_controllers_model(body: Standing) -> None:
    for name in ("dof_damping", "dof_armature", "dof_frictionloss", "jnt_stiffness"):
        assert not np.any(getattr(body.model, name)), name
    assert np.all(body.model.jnt_limited[1:])
    assert np.all(body.model.jnt_range[1:, 0] <= 0.0), "the neutral posture must be allowed"
    assert np.all(body.model.jnt_range[1:, 1] > 0.0)


def test_only_sole_points_touch_only_the_floor(body: Standing) -> None:
    points = {name for _, _, name in body.description.sole_points()}
    model = body.model
    touch = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    for i, j in itertools.combinations(range(model.ngeom), 2):
        names = {model.geom(i).name, model.geom(j).name}
        assert (touch[i, j] or touch[j, i]) == ("floor" in names and bool(names & points))
    assert all(model.geom(name).condim[0] == 3 for name in points)


def test_contact_and_solver_parameters_arrive_in_the_model() -> None:
    contact = ContactParameters(time_constant=0.02, friction=0.7, impratio=5.0, impedance_width=0.002)
    simulation = SimulationParameters(time_step=0.001, integrator="implicitfast")
    model = build(BodyParameters(), contact, simulation).compile()
    assert model.opt.timestep == 0.001
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.impratio == 5.0
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.gravity[2] == -9.81
    for name in ("floor", "left_heel_left", "right_tip_right"):
        geom = model.geom(name)
        assert geom.friction[0] == 0.7
        np.testing.assert_array_equal(geom.solref, [0.02, contact.damping_ratio])
        expected = [contact.impedance_min, contact.impedance_max, 0.002, 0.5, 2]
        np.testing.assert_allclose(geom.solimp, expected)


def test_mirror_map(body: Standing) -> None:
    pairs = {joint: (image, sign) for joint, image, sign in body.description.mirror}
    assert len(pairs) == 34
    limits = dict(body.description.torque_limits)
    for joint, (image, sign) in pairs.items():
        assert pairs[image] == (joint, sign)
        assert limits[image] == limits[joint]
        low, high = body.model.joint(joint).range
        np.testing.assert_allclose(np.sort([sign * low, sign * high]), body.model.joint(image).range)
    left, right = body.description.legs
    assert [pairs[name][0] for name in left.joints] == list(right.joints)


def test_size_scales(default: Standing) -> None:
    """Lengths go with stature, masses with mass, inertias with mass times stature squared."""
    other = Standing(1.70 * 1.1, 60.0 * 1.3)
    np.testing.assert_allclose(other.model.body_pos, 1.1 * default.model.body_pos, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(other.model.body_mass, 1.3 * default.model.body_mass, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(other.model.body_inertia, 1.3 * 1.21 * default.model.body_inertia, rtol=1e-9)

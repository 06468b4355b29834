"""The human: masses, proportions, symmetry, and that the description tells the truth about the model."""

import itertools
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from ampm.description import BodyDescription
from ampm.parameters import BodyParameters, ContactParameters, RunParameters, SimulationParameters
from models import anthropometry as table
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

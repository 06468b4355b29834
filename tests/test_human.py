"""The human: masses, proportions, symmetry, and that the description tells the truth about the model."""

import itertools
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from ampm.description import BodyDescription
from ampm.parameters import BodyParameters, RunParameters
from docs import human as table
from models.load import build_body


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

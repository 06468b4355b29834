"""Descriptions and models of bodies: shapes and meshes, models in memory, and what is refused."""

import re
import struct
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pytest

from ampm.parameters import BodyParameters, RunParameters
from models.load import build_body
from models.propose import propose
from models.scene import BodyModel
from models.source import body_path, compiled_source, read_body_file, source_path
from validation.show.rerun.body import mesh_of
from validation.trial.physics import firm_dampers

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
URDF, TOML = ((EXAMPLES / f"biped.{suffix}").read_text(encoding="utf-8") for suffix in ("urdf", "toml"))
UNBALANCED = URDF.replace('izz="0.134867"', 'izz="0.934867"')
INERTIA = '<inertial><origin xyz="0 0 0"/><mass value="{}"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'  # noqa: E501
HINGE = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="5"/></joint>'
)


def load(path: Path) -> BodyModel:
    return build_body(RunParameters(body=BodyParameters(source=str(path))))


def write(folder: Path, urdf: str = URDF, toml: str = TOML) -> Path:
    (folder / "biped.urdf").write_text(urdf, encoding="utf-8")
    (folder / "biped.toml").write_text(toml, encoding="utf-8")
    return folder / "biped.toml"


def with_toes(urdf: str) -> str:
    toes = "".join(
        f'<link name="{side}_toes">{INERTIA.format(0.1)}</link>'
        + HINGE.format(f"{side}_toe", f"{side}_foot", f"{side}_toes", "0.14 0 -0.07")
        for side in "lr"
    )
    return urdf.replace("</robot>", toes + "</robot>")


def with_neck(urdf: str, limit: str = "<limit") -> str:
    joint = HINGE.format("neck", "chest", "skull", "0 0 0.45")
    neck = f'<link name="skull">{INERTIA.format(1.0)}</link>{joint}'
    return urdf.replace("</robot>", neck.replace("<limit", limit) + "</robot>")


def read(urdf: str = URDF, toml: str = TOML, name: str = "biped.urdf") -> BodyModel:
    """The body of a model and its description."""
    with TemporaryDirectory() as folder:
        path = write(Path(folder), toml=toml)
        (Path(folder) / name).write_text(urdf, encoding="utf-8")
        return load(path)


def suite_model(element: str) -> str:
    """The suite's humanoid with an element of MJCF."""
    source = source_path(read_body_file(body_path("suite-humanoid")).source, EXAMPLES)
    return mujoco.MjSpec.from_file(str(source)).to_xml().replace("</mujoco>", f"{element}</mujoco>")


def with_passive(element: str) -> BodyModel:
    text = body_path("suite-humanoid").read_text(encoding="utf-8")
    source = read_body_file(body_path("suite-humanoid")).source
    return read(suite_model(element), text.replace(source, "model.xml"), "model.xml")


def placed(origin: str) -> str:
    """The URDF from another origin, or in axes that are turned."""
    joint = '<joint name="turn" type="fixed"><parent link="base"/><child link="pelvis"/>'
    return URDF.replace("</robot>", f'<link name="base"/>{joint}<origin {origin}/></joint></robot>')


def test_values_of_a_left_joint_hold_for_the_right_one_and_firm_dampers_are_found() -> None:
    left, right = URDF.split('<joint name="r_hip_yaw"')
    body = read(left + '<joint name="r_hip_yaw"' + right.replace('upper="2.4"', 'upper="0.4"'))
    assert body.findings.unlike == ("r_knee high 0.4, now 2.4",)
    assert body.xml == read().xml
    assert "add 'l_ankle_pitch|" in firm_dampers(read(toml=TOML + 'damping.".*" = 20').compile())


@pytest.mark.parametrize("origin", ['rpy="-1.570796327 0 0"', 'rpy="3.141592654 0 0"', 'xyz="0 0 2"'])
def test_a_model_is_turned_upright_wherever_its_root_is(origin: str) -> None:
    found, own = read(placed(origin)).description, read().description
    assert found.left_leg == own.left_leg
    assert (found.hip_height, found.com_over_hip) == pytest.approx((own.hip_height, own.com_over_hip))


def test_a_package_is_found_by_the_name_of_its_import(tmp_path: Path) -> None:
    """Pillow is imported as ``PIL``."""
    assert source_path("PIL:PIL/Image.py", tmp_path).parts[-2:] == ("PIL", "Image.py")


def test_contact_pairs_with_the_floor_of_another_file_are_left_out(tmp_path: Path) -> None:
    pair = '<contact><pair geom1="left_left_foot" geom2="floor_of_the_scene"/></contact>'
    (tmp_path / "model.xml").write_text(suite_model(pair), "utf-8")
    assert compiled_source(tmp_path / "model.xml")[0].npair == 0


def with_box_feet(pitch: float = 0.0, shape: str = 'box size="0.2 0.09 0.04"') -> str:
    place = f'<origin xyz="0.03 0 -0.05" rpy="0 {pitch} 3e-6"/>'
    box = f"<collision>{place}<geometry><{shape}/></geometry></collision>"
    return re.sub('<link name="._foot">', lambda link: link[0] + box, URDF)


@pytest.mark.parametrize("pitch", [0.0, 0.15])
def test_a_description_is_proposed_from_a_model(pitch: float, tmp_path: Path, ampm) -> None:
    urdf = with_neck(with_box_feet(pitch), '<mimic joint="waist_yaw"/><limit')
    (tmp_path / "biped.urdf").write_text(urdf, encoding="utf-8")
    path = tmp_path / "new.toml"
    assert ampm("body", "new", tmp_path / "biped.urdf", path).status == 0
    file = read_body_file(path)
    assert (file.source, file.root, file.trunk) == ("biped.urdf", "pelvis", "chest")
    assert (file.foot, file.knee) == (("l_foot", "r_foot"), ("l_knee", "r_knee"))
    assert [pattern.pattern for pattern in file.lock] == ["waist_yaw", "neck"]
    sole = file.sole
    assert sole.pitch == pytest.approx(pitch, abs=1e-3)
    sizes = [sole.front - sole.heel, sole.heel_half_width, sole.front_half_width]
    assert sizes == pytest.approx([0.2, 0.045, 0.045], abs=1e-3)
    model = (body := load(path)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = data.site("left_sole").xmat.reshape(3, 3)
    np.testing.assert_allclose(turn[:, 2], [np.sin(pitch), 0.0, np.cos(pitch)], atol=1e-3)
    # The sole's points are the corners of the box's lower side.
    foot, normal = data.body("l_foot").xpos, turn[:, 2]
    for name in body.description.left_leg.sole_points:
        assert (data.site(name).xpos - foot - [0.03, 0, -0.05]) @ normal == pytest.approx(-0.02, abs=1e-3)
    assert "File exists" in ampm("body", "new", tmp_path / "biped.urdf", path).err


def test_a_proposal_says_what_is_to_be_filled_in(tmp_path: Path, ampm) -> None:
    assert "Fill in [body.sole]" in ampm("body", "new", EXAMPLES / "biped.urdf", tmp_path / "new.toml").out
    assert "body.sole is missing" in ampm("body", "check", tmp_path / "new.toml").err
    one_arm = URDF.replace("</robot>", ARM.replace("0 1 0", "1 0 0") + "</robot>")
    two = one_arm.replace("</robot>", ARM.replace('"arm"', '"other"').replace("0 0.2", "0 -0.2") + "</robot>")
    small = re.sub('(?<=origin xyz=")[^"]+', lambda m: " ".join(str(float(n) / 5) for n in m[0].split()), two)
    for urdf, said in (
        (one_arm.replace('effort="10"', 'effort="0"'), "lack mass or a torque limit"),
        (one_arm, 'trunk = "chest"'),
        (one_arm, "]\n\n# The left foot"),  # no arm of a pair is spread
        (small, "\narm = 0.4\n"),
        (BACKWARD, "# As its knees bend, it walks along -x "),
        (with_toes(URDF), 'lock = [\n    "l_toe",\n    "r_toe",\n]'),
        (with_box_feet().replace('"0 0.0 3e-6"', '"0.15 0 0"'), "level along y"),
        (with_box_feet(0.0, 'cylinder radius="1" length="0.1"').replace("0 0.0", "1.57 0"), "level along"),
    ):
        (tmp_path / "biped.urdf").write_text(urdf, encoding="utf-8")
        assert said in propose(str(tmp_path / "biped.urdf"), tmp_path)


ARM = f'<link name="arm">{INERTIA.format(3.0)}</link>' + HINGE.format("arm", "chest", "arm", "0 0.2 0.4")
BACKWARD = URDF.replace('lower="0" upper="2.4"', 'lower="-2.4" upper="0"')


def test_keys_of_the_description_replace_what_the_model_has() -> None:
    """A range, as of a knee that bends forward, and inertia."""
    body = read(BACKWARD, TOML + 'range."._knee" = [0.0, 2.4]')
    np.testing.assert_allclose(body.compile().joint("r_knee").range, [0.0, 2.4])
    foot = read(toml=TOML + 'gyration.".*_foot" = 0.05').compile().body("l_foot")
    np.testing.assert_allclose(foot.inertia, foot.mass[0] * 0.05**2)
    balanced = read(UNBALANCED, TOML + "balance_inertia = true").compile().body("chest")
    np.testing.assert_allclose(balanced.inertia, (0.2562 + 0.181067 + 0.934867) / 3.0, rtol=1e-6)


def test_the_sole_is_measured_from_the_foot_that_is_named() -> None:
    """Also from one that is fixed to its segment."""
    fixed = "".join(
        f'<link name="{side}_sole_link"/><joint name="{side}_fix" type="fixed"><parent link="{side}_foot"/>'
        f'<child link="{side}_sole_link"/><origin xyz="0.02 {y} -0.05"/></joint>'
        for side, y in (("l", 0.01), ("r", -0.01))
    )
    toml = TOML.replace("_foot", "_sole_link").replace("bottom = -0.07", "bottom = -0.02")
    moved = read(URDF.replace("</robot>", fixed + "</robot>"), toml).compile()
    own = read().compile()
    for side, y in (("left", 0.01), ("right", -0.01)):
        gap = moved.site(f"{side}_sole").pos - own.site(f"{side}_sole").pos
        np.testing.assert_allclose(gap, [0.02, y, 0.0], rtol=0.0, atol=1e-12)


def test_toes_can_be_welded_names_of_ours_are_no_trouble_and_the_rest_is_the_head() -> None:
    toml = TOML.replace("knee =", 'lock = ["._toe"]\nknee =')
    urdf = with_toes(URDF).replace('"l_thigh"', '"imu"').replace('"waist_a"', '"waist_yaw"')
    body = read(with_neck(urdf), toml)
    assert body.description.mass == pytest.approx(41.8)
    assert body.compile().body("imu_segment").mass[0] == pytest.approx(4.0)
    assert body.description.head == ("neck",)


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
FACES = np.array([int(corner) for corner in "013032467475045051237276026064157173"]).reshape(12, 3)
"""A box: its corners, and the corners of its triangles."""


def write_mesh(path: Path, size: tuple[float, float, float]) -> None:
    """An STL file of a box about its origin, from -size to size [m]."""
    rows = [struct.pack("<12fH", 0, 0, 0, *(CORNERS * size)[face].ravel(), 0) for face in FACES]
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))


def test_meshes_become_hulls_in_the_model(tmp_path: Path) -> None:
    """The meshes are in a ROS package's folder above the URDF; what MuJoCo cannot read is dropped."""
    folder = tmp_path / "my_robot" / "urdf"
    (tmp_path / "my_robot" / "meshes").mkdir(parents=True)
    folder.mkdir()
    write_mesh(tmp_path / "my_robot" / "meshes" / "thigh.STL", (0.05, 0.06, 0.18))
    (tmp_path / "my_robot" / "meshes" / "shank.ply").write_text("ply", encoding="utf-8")
    urdf = URDF
    for side in "lr":
        for part in ("thigh.STL", "shank.ply", "missing.stl"):
            link = f'<link name="{side}_{part[:5]}">'
            shape = f'<mesh filename="package://my_robot/meshes/{part}"/>'
            visual = f'<visual><origin xyz="0 0 -0.18"/><geometry>{shape}</geometry></visual>'
            urdf = urdf.replace(link, link + visual)
    body = load(write(folder, urdf))
    model = body.compile()
    assert str(tmp_path) not in body.xml
    assert model.nmesh == 2
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)[0])
    corners = model.mesh_vert[:8] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    centre = data.body("l_thigh").xpos - np.array([0, 0, 0.18])
    np.testing.assert_allclose(np.abs(corners - centre), [[0.05, 0.06, 0.18]] * 8, atol=1e-4)
    shank = model.geom_type[model.geom_bodyid == model.body("l_shank").id]
    assert list(shank) == [mujoco.mjtGeom.mjGEOM_ELLIPSOID]


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimetre" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="box"><mesh>
<source id="s"><float_array id="a" count="24">{}</float_array>
<technique_common><accessor source="#a" count="8" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node><instance_geometry url="#box"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""
"""A box with y upwards, in centimetres, of eight points and twelve triangles."""


def test_text_stl_and_collada_have_the_points_of_the_same_box(tmp_path: Path) -> None:
    corners = (CORNERS + np.array([0.5, 0, 0])) * (0.05, 0.06, 0.18)
    rows = [
        "facet normal 0 0 1\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*corner) for corner in corners[face])
        + "endloop\nendfacet\n"
        for face in FACES
    ]
    (tmp_path / "box.stl").write_text(f"solid box\n{''.join(rows)}endsolid box\n", encoding="utf-8")
    upright = 100.0 * corners[:, [0, 2, 1]] * (1, 1, -1)  # x, z, -y
    numbers = [" ".join(map(str, values)) for values in (upright.ravel(), FACES.ravel())]
    (tmp_path / "box.dae").write_text(COLLADA.format(*numbers), encoding="utf-8")
    for name in ("box.stl", "box.dae"):
        shape = f'<mesh filename="{name}" scale="1 0.5 1"/>'
        link = '<link name="l_thigh">'
        urdf = URDF.replace(link, f"{link}<visual><geometry>{shape}</geometry></visual>")
        (tmp_path / "mesh.urdf").write_text(urdf, encoding="utf-8")
        model, _ = compiled_source(tmp_path / "mesh.urdf")
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        points = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
        points -= data.body("l_thigh").xpos
        for wanted in corners * (1.0, 0.5, 1.0):
            assert np.abs(points - wanted).max(axis=1).min() < 1e-6, (name, wanted)


def test_a_segment_without_a_shape_has_the_ellipsoid_of_its_inertia() -> None:
    model = read().compile()
    chest = model.body("chest")
    geom = model.geom(int(np.flatnonzero(model.geom_bodyid == chest.id)[0]))
    squares = geom.size**2
    moments = chest.mass[0] / 5.0 * (squares.sum() - squares)
    np.testing.assert_allclose(sorted(moments), sorted([0.2562, 0.181067, 0.134867]), rtol=1e-6)
    np.testing.assert_allclose(geom.pos, [0, 0, 0.2], rtol=0.0, atol=1e-12)


def test_hulls_are_in_the_recording(tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.stl", (0.1, 0.2, 0.3))
    spec = mujoco.MjSpec()
    spec.add_mesh(name="box", file=str(tmp_path / "box.stl"))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="box")
    drawn = mesh_of(spec.compile(), 0, (10, 20, 30, 40))
    assert drawn.vertex_positions is not None
    points = np.array(drawn.vertex_positions.as_arrow_array().to_pylist())
    assert points.shape == (36, 3)
    assert sorted(np.ptp(points, axis=0)) == pytest.approx([0.2, 0.4, 0.6])

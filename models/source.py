"""Description file of a body, and the compiled model of its source: MJCF or URDF, of a file or a package."""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Annotated, TypeVar

import coal
import mujoco
import numpy as np
from pydantic import Field

from ampm.exceptions import InputError
from ampm.parameters import HUMAN
from ampm.section import Real, Section, read_toml, unknown

T = TypeVar("T")
FOLDER = Path(__file__).with_name("bodies")
"""Description files of the bodies that are known by name."""
DRAWN = 1 << 30
"""``conaffinity`` of a mesh that is drawn and does not collide."""
_HULL_POINTS = 64  # most of a mesh's convex hull
_URDF_OPTIONS = """<mujoco>
  <compiler discardvisual="false" fusestatic="false" balanceinertia="false" strippath="false"
    inertiafromgeom="false"/>
</mujoco>"""
_MESHES = (".stl", ".obj", ".msh")  # that MuJoCo reads, STL only if it is binary
_CONVERTED = (".dae", ".stl")
_COLLADA_UNIT = re.compile(rb'<unit [^>]*meter="([^"]+)"')
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # of COLLADA, row vectors to z upwards
MASSLESS = 1e-13  # of a link: its mass, and a moment of its inertia, is less [kg, kg m^2]
_LARGEST = 1e4  # of a model's numbers, in SI units
_PASSIVE = ("dof_damping", "dof_frictionloss", "dof_armature", "jnt_stiffness")
_BOUND = 0.5 * MASSLESS  # written for less, as MuJoCo compiles no moving body without mass
_MATRIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # places in MJCF's fullinertia
Sides = Annotated[tuple[str, str], Field(strict=False)]  # names of left and right, also as a list
Patterns = Annotated[tuple[re.Pattern[str], ...], Field(strict=False)]
ByPattern = Mapping[re.Pattern[str], Annotated[Real, Field(ge=0)]]
Range = Annotated[tuple[Real, Real], Field(strict=False)]


class SoleSection(Section, section="body.sole"):
    """Outline of the left sole with all joints at 0: x forward, z up, from the foot's origin."""

    heel: Real = Field(description="x of the heel's edge [m]")
    front: Real = Field(description="x of the front edge [m]")
    bottom: Real = Field(description="z of the sole [m]")
    heel_half_width: Real = Field(description="half the distance of the heel's two points [m]", gt=0)
    front_half_width: Real = Field(description="half the distance of the front's two points [m]", gt=0)
    middle: Real = Field(0.0, description="y of the middle of the left sole [m]")
    reference: Real = Field(0.0, description="x of the reference point, from which the plan measures [m]")
    pitch: Real = Field(0.0, description="angle from the foot to its level sole, with all joints at 0 [rad]")


class BodyFile(Section, section="body"):
    """Contents of a description file."""

    source: str = Field(description="MJCF or URDF file, or PACKAGE:FILE of an installed package")
    root: str = Field(description="segment that moves freely")
    trunk: str = Field(description="segment whose pitch is the lean of the trunk")
    foot: Sides = Field(description="segments of the left and the right foot")
    knee: Sides = Field(description="joints of the left and the right knee")
    sole: SoleSection = Field(description="outline of a sole")
    rest: Mapping[str, Real] = Field({}, description="angles of trunk and arms at rest, where not 0 [rad]")
    lock: Patterns = Field((), description="joints that are welded, as regular expressions")
    balance_inertia: bool = Field(
        False, description="take the mean of the moments of a link where no body could have them"
    )
    gyration: ByPattern = Field(
        {}, description="radius of gyration about all axes, by regular expression of links [m]"
    )
    armature: ByPattern = Field({}, description="rotor inertia by regular expression of joints [kg m^2]")
    range: Mapping[re.Pattern[str], Range] = Field(
        {}, description="least and largest angle by regular expression of joints, for the left side [rad]"
    )
    effort: ByPattern = Field({}, description="largest torque by regular expression of joints [N m]")
    speed: ByPattern = Field({}, description="largest speed by regular expression of joints [rad/s]")
    damping: ByPattern = Field({}, description="damping by regular expression of joints [N m s/rad]")
    stiffness: ByPattern = Field({}, description="stiffness by regular expression of joints [N m/rad]")
    friction: ByPattern = Field({}, description="dry friction by regular expression of joints [N m]")


class _File(Section):
    body: BodyFile = Field(description="the only table, with its own tables such as [body.sole]")


def known_bodies() -> tuple[str, ...]:
    """Names of the bodies that are known."""
    return HUMAN, *sorted(path.stem for path in FOLDER.glob("*.toml"))


def body_path(source: str) -> Path:
    """Description file of a body, by name or path; raises InputError if there is none."""
    if source in known_bodies():
        return FOLDER / f"{source}.toml"
    path = Path(source)
    if path.suffix in (".urdf", ".xml"):
        raise InputError(
            f"{source!r} is a model; give its description, which 'ampm body new {source} FILE.toml' writes.",
            key="body.source",
            value=source,
        )
    if path.is_file():
        return path
    raise unknown(source, known_bodies(), "body or file", key="body.source", value=source)


def read_body_file(path: Path) -> BodyFile:
    """Read a description file; raises InputError if it is no TOML, or a key is unknown, missing or bad."""
    return _File(**read_toml(path)).body


def source_path(source: str, folder: Path) -> Path:
    """File of the source in a description, by its folder; InputError if there is no such package or file."""
    package, colon, name = source.partition(":")
    if not colon:
        path = folder / source
        if not path.is_file():
            raise InputError(f"there is no model {str(path)!r}; correct its name.")
        return path
    try:
        files = metadata.distribution(package).files or []
    except (metadata.PackageNotFoundError, ValueError):
        for installed in metadata.packages_distributions().get(package, ()):  # by the name of its import
            return source_path(f"{installed}:{name}", folder)
        # What to install is said of our own descriptions only: others may name anything.
        way_out = f"run pip install --no-deps {package}" if folder == FOLDER else "install what you trust"
        raise InputError(
            f"the body is read from the package {package!r}, which is not installed; {way_out}."
        ) from None
    for file in files:
        if f"/{file.as_posix()}".endswith(f"/{name}"):
            return Path(str(file.locate()))
    raise InputError(f"the package {package} has no file {name!r}; correct source in the body's description.")


def compiled_source(path: Path, *, balance: bool = False) -> tuple[mujoco.MjModel, dict[str, float]]:
    """The model of a file, and the speed limits [rad/s] that MuJoCo does not keep, by joint.

    The file is MJCF or URDF; ``balance`` is ``balance_inertia`` of :class:`BodyFile`. Raises InputError if it
    cannot be read or compiled.
    """
    speeds: dict[str, float] = {}
    try:
        text = path.read_text(encoding="utf-8")
        if "<robot" not in text and "<mujoco" not in text:
            raise ValueError("it is neither URDF nor MJCF, which are read")
        if "<robot" in text:
            tree = ET.fromstring(text)
            speeds = _readable_urdf(tree)
            spec = mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"))
        else:
            spec = mujoco.MjSpec.from_file(str(path))
            # Only soles collide, and pairs may name another file's floor; textures' files may be missing.
            for thing in [*spec.pairs, *spec.textures]:
                spec.delete(thing)
            for material in spec.materials:
                material.textures = [""] * len(material.textures)
        _find_meshes(spec, path)
        for mesh in spec.meshes:
            mesh.maxhullvert = _HULL_POINTS
            if mesh.file.lower().endswith(_CONVERTED):
                _read_mesh(mesh)
        for kind, things in (("link", spec.bodies[1:]), ("joint", spec.joints)):
            for number, thing in enumerate(things):
                thing.name = thing.name or f"{kind}_{number}"
        spec.compiler.balanceinertia |= balance
        _bound_inertia(spec)
        for geom in spec.geoms:
            if geom.meshname and not (geom.contype or geom.conaffinity):
                geom.conaffinity = DRAWN  # else MuJoCo makes no hull of it
        model = spec.compile()
        _check_numbers(model)
        return model, speeds
    except (OSError, ValueError, ET.ParseError, mujoco.FatalError) as error:
        what = " ".join(str(error).split())
        way_out = ", or add balance_inertia = true to the body's description" if "A + B >= C" in what else ""
        if "${" in what or (path.is_file() and b"<xacro:" in path.read_bytes()):
            way_out = ", or convert it from xacro to URDF"
        elif "free joint" in what:
            way_out = ", or remove the floating joint: the root is free without it"
        elif "mesh" in what:
            way_out = ", or take this mesh out of the model"
        raise InputError(f"the model {str(path)!r} cannot be compiled ({what}); mend it{way_out}.") from None


def _check_numbers(model: mujoco.MjModel) -> None:
    """Refuse a model without joints, or with a number that is not finite, by a ValueError that names it."""
    if not model.njnt:
        raise ValueError("it has no joints")
    for what, fields in (
        ("body", ("body_mass", "body_inertia", "body_pos", "body_quat", "body_ipos", "body_iquat")),
        ("joint", ("jnt_axis", "jnt_pos", "jnt_range", *_PASSIVE)),
    ):
        for name in fields:
            least = -_LARGEST if name.endswith(("pos", "quat", "axis", "range")) else 0.0
            values = getattr(model, name)
            wrong = ~((least <= values) & (values <= _LARGEST)).reshape(len(values), -1).all(axis=1)
            if wrong.any():
                row = int(wrong.argmax())
                thing = getattr(model, what)(int(model.dof_jntid[row]) if name.startswith("dof") else row)
                quantity = name.partition("_")[2]
                value = ", ".join(f"{number:g}" for number in np.ravel(getattr(thing, quantity)))
                fault = f"{quantity} of the {what} {thing.name!r} is {value}"
                raise ValueError(f"{fault} and must be a number of {least:g} to {_LARGEST:g} in SI units")


def _readable_urdf(tree: ET.Element) -> dict[str, float]:
    """Refuse what MuJoCo reads in another way, and say how it is to read the rest; speed limits.

    Raises ValueError if a name stands twice, not all links hang on one, or a mass or limit is negative or out
    of order.
    """
    for kind in ("link", "joint"):
        names = [element.get("name", "") for element in tree.findall(kind)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"names of a {kind} used twice: {', '.join(twice)}")
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    roots = [link.get("name", "") for link in tree.findall("link") if link.get("name") not in children]
    if len(roots) > 1:
        raise ValueError(f"links that hang on no joint: {', '.join(roots)}; keep one")
    for link in tree.findall("link"):
        for mass in link.iterfind("inertial/mass"):
            if not float(mass.get("value", 0.0)) >= 0.0:
                fault = f"mass of the link {link.get('name')!r} is {mass.get('value')} kg"
                raise ValueError(f"{fault} and must be 0 or more")
    speeds = {}
    for joint in tree.findall("joint"):
        for limit in joint.findall("limit"):
            value = {"lower": 0.0, "upper": 0.0, "effort": math.inf, "velocity": math.inf}
            value |= {name: float(text) for name, text in limit.items() if name in value}
            for name, least, rule in (
                ("lower", -math.inf, "a number"),
                ("upper", value["lower"], f"at least lower = {value['lower']:g}"),
                ("effort", 0.0, "0 or more"),
                ("velocity", 0.0, "0 or more"),
            ):
                if not value[name] >= least:
                    what = f"{name} = {value[name]:g} of the joint {joint.get('name')!r}"
                    raise ValueError(f"{what} must be {rule}")
            speeds[joint.get("name", "")] = value["velocity"]
    for old in tree.findall("mujoco"):
        tree.remove(old)
    tree.append(ET.fromstring(_URDF_OPTIONS))
    return speeds


def _find_meshes(spec: mujoco.MjSpec, path: Path) -> None:
    """Give meshes their files; drop those of other formats, and those that are missing in some packages."""
    folder = Path(spec.modelfiledir or path.parent, spec.meshdir or "")
    lost = set[str]()
    for mesh in [mesh for mesh in spec.meshes if mesh.file]:
        file = _mesh_file(mesh.file, folder, path)
        if file is not None and file.name.lower().endswith(_MESHES + _CONVERTED):
            mesh.file = str(file)
        else:
            lost.add(mesh.name or Path(mesh.file).stem)
            spec.delete(mesh)
    for geom in list(spec.geoms):
        if geom.meshname in lost:
            spec.delete(geom)


def _mesh_file(name: str, folder: Path, path: Path) -> Path | None:
    """File of a mesh, of a ROS package that of a folder above the URDF; None if there is none."""
    plain = name.removeprefix("file://")
    folders, names = [folder], [plain]
    if plain.startswith("package://"):
        package, _, rest = plain.removeprefix("package://").partition("/")
        folders, names = list(path.resolve().parents), [f"{package}/{rest}", rest]
    found = ((place / name).resolve() for place in folders for name in names)
    return next((file for file in found if file.is_file()), None)


def _read_mesh(mesh: mujoco.MjsMesh) -> None:
    """Read the points of a COLLADA file, or of an STL of text; MuJoCo reads the other formats."""
    file = Path(mesh.file)
    content = file.read_bytes()
    if file.suffix.lower() == ".stl" and not (content.startswith(b"solid") and b"vertex" in content):
        return
    try:
        points = coal.MeshLoader().load(str(file)).vertices()
    except ValueError:
        raise ValueError(f"the mesh {str(file)!r} cannot be read; convert it to a binary STL") from None
    if unit := _COLLADA_UNIT.search(content):
        points = points * float(unit[1])
    if b"<up_axis>Y_UP" in content:
        points = points @ _Y_UP
    mesh.uservert, mesh.file = points.ravel(), ""


def _bound_inertia(spec: mujoco.MjSpec) -> None:
    """Give links without mass or inertia nearly none, as MuJoCo compiles no moving one without.

    What moves without mass is refused later, when what is fixed to it is known.
    """
    spec.compiler.boundmass = max(spec.compiler.boundmass, _BOUND)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, _BOUND)
    for body in spec.bodies[1:]:
        full = np.array(body.fullinertia)
        if np.isfinite(full[0]) and np.linalg.eigvalsh(full[_MATRIX])[0] < _BOUND:
            body.fullinertia = full + _BOUND * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


def by_pattern(table: Mapping[re.Pattern[str], T], joint: str, default: T) -> T:
    """Value of the last pattern that matches a joint's whole name."""
    values = [value for pattern, value in table.items() if pattern.fullmatch(joint)]
    return values[-1] if values else default


def pattern_of(name: str) -> str:
    """The regular expression that matches this name alone."""
    return re.sub(r"[^\w./ -]", r"\\\g<0>", name)

"""Description file of a body, and the compiled model of its source: MJCF or URDF, of a file or a package."""

import ctypes
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import mujoco
import tomli_w
from pydantic import Field

from ampm.exceptions import InputError
from ampm.parameters import HUMAN
from ampm.section import Real, Section, read_toml, unknown

FOLDER = Path(__file__).with_name("bodies")
"""Description files of the bodies that are known by name."""
DRAWN = 1 << 30
"""``conaffinity`` of a mesh that is drawn and does not collide."""
_ALL_DIGITS = 17  # of a float64
_HULL_POINTS = 64  # most of a mesh's convex hull
_URDF_OPTIONS = """<mujoco>
  <compiler discardvisual="false" fusestatic="false" balanceinertia="false" strippath="false"/>
</mujoco>"""
_MESHES = (".stl", ".obj", ".msh")  # that MuJoCo reads
Names = Annotated[tuple[str, ...], Field(strict=False)]  # also a list
Angles = Mapping[str, Real]
Patterns = Annotated[tuple[re.Pattern[str], ...], Field(strict=False)]
ByPattern = Mapping[re.Pattern[str], Annotated[Real, Field(ge=0)]]


class SoleSection(Section, section="sole"):
    """Outline of the left sole in the neutral posture: x forward, z up, from the foot's origin."""

    heel: Real = Field(description="x of the heel's edge [m]")
    front: Real = Field(description="x of the front edge [m]")
    bottom: Real = Field(description="z of the sole [m]")
    heel_half_width: Real = Field(description="half the distance of the heel's two points [m]", gt=0)
    front_half_width: Real = Field(description="half the distance of the front's two points [m]", gt=0)
    middle: Real = Field(0.0, description="y of the middle of the left sole [m]")
    reference: Real = Field(0.0, description="x of the reference point, from which the plan measures [m]")


class BodyFile(Section, section="body"):
    """Contents of a description file."""

    source: str = Field(description="MJCF or URDF file, or PACKAGE:FILE of an installed package")
    root: str = Field(description="segment that moves freely")
    trunk: str = Field(description="segment whose pitch is the lean of the trunk")
    sides: Names = Field(description="words for left and right in names", min_length=2, max_length=2)
    foot: str = Field(description="segment of a foot, with {side} or {Side}")
    knee: str = Field(description="joint of a knee, with {side} or {Side}")
    sole: SoleSection = Field(description="outline of a sole")
    neutral: Angles = Field(
        {}, description="angles at which body and soles are upright and level, where not 0 [rad]"
    )
    rest: Angles = Field({}, description="angles of trunk and arms at rest, where not those of neutral [rad]")
    lock: Patterns = Field((), description="joints that are welded, as regular expressions")
    armature: ByPattern = Field({}, description="rotor inertia by regular expression of joints [kg m^2]")
    effort: ByPattern = Field({}, description="largest torque by regular expression of joints [N m]")
    speed: ByPattern = Field({}, description="largest speed by regular expression of joints [rad/s]")
    damping: ByPattern = Field({}, description="damping by regular expression of joints [N m s/rad]")
    stiffness: ByPattern = Field(
        {}, description="stiffness of a spring by regular expression of joints [N m/rad]"
    )
    friction: ByPattern = Field({}, description="dry friction by regular expression of joints [N m]")

    def sided(self, name: str) -> tuple[str, str]:
        """Left and right name of a pattern."""
        left, right = (
            name.replace("{side}", side).replace("{Side}", side.capitalize()) for side in self.sides
        )
        return left, right


class _File(Section):
    body: BodyFile = Field(description="the only table, with its own tables such as [body.sole]")


def known_bodies() -> tuple[str, ...]:
    """Names of the bodies that are known."""
    return HUMAN, *sorted(path.stem for path in FOLDER.glob("*.toml"))


def body_path(source: str) -> Path:
    """Description file of a body, by name or path.

    Raises:
        InputError: there is none.
    """
    if source in known_bodies():
        return FOLDER / f"{source}.toml"
    path = Path(source)
    if path.suffix in (".urdf", ".xml"):
        raise InputError(
            f"{source!r} is a model; give its description, a TOML file that names it as source.",
            key="body.source",
            value=source,
        )
    if path.is_file():
        return path
    raise unknown(source, known_bodies(), "body or file", key="body.source", value=source)


def read_body_file(path: Path) -> BodyFile:
    """Read a description file.

    Raises:
        InputError: it is no TOML, or a key is unknown, missing or bad.
    """
    return _File(**read_toml(path)).body


def write_body(path: Path, source: mujoco.MjSpec | str, **description: Any) -> Path:
    """Write a description file, of a model file or of a model in memory.

    Args:
        path: of the file, which may be given as ``body.source``; its folder exists.
        source: as in the file; an ``MjSpec`` is written beside it as MJCF, with its meshes where they are.
        description: further keys of :class:`BodyFile`; ``sole`` as a table.

    Returns:
        The path.

    Raises:
        InputError: a key is unknown, missing or bad, or the model cannot be compiled.
    """
    path = Path(path)
    if isinstance(source, mujoco.MjSpec):
        spec, source = source.copy(), f"{path.stem}.xml"
        for mesh in spec.meshes:
            mesh.file = str(_mesh_file(spec, mesh).resolve()) if mesh.file else ""
        spec.meshdir = ""
        try:
            spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise _refusal(spec.modelname, error) from None
        path.with_name(source).write_text(_exact_xml(spec), encoding="utf-8")
    BodyFile(source=source, **description)
    path.write_text(tomli_w.dumps({"body": {"source": source, **description}}), encoding="utf-8")
    return path


def source_path(source: str, folder: Path) -> Path:
    """File of a source.

    Args:
        source: of a description file.
        folder: of that file.

    Raises:
        InputError: there is no such package or file.
    """
    package, colon, name = source.partition(":")
    if not colon:
        path = folder / source
        if not path.is_file():
            raise InputError(f"there is no file {str(path)!r}; correct source in the body's description.")
        return path
    try:
        files = metadata.distribution(package).files or []
    except metadata.PackageNotFoundError:
        raise InputError(
            f"the body is read from the package {package}, which is not installed; "
            f"run pip install --no-deps {package}."
        ) from None
    for file in files:
        if file.as_posix().endswith(f"/{name}"):
            return Path(str(file.locate()))
    raise InputError(f"the package {package} has no file {name!r}; correct source in the body's description.")


def compiled_source(path: Path) -> tuple[mujoco.MjModel, dict[str, float]]:
    """The model of a file, and the speed limits [rad/s] that MuJoCo does not keep, by joint.

    Raises:
        InputError: it cannot be read or compiled.
    """
    speeds: dict[str, float] = {}
    try:
        text = path.read_text(encoding="utf-8")
        if "<robot" in text:
            tree = ET.fromstring(text)
            speeds = _readable_urdf(tree, path)
            spec = mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"))
        else:
            spec = mujoco.MjSpec.from_file(str(path))
            _drop_missing_meshes(spec)
            _drop_textures(spec)
        for mesh in spec.meshes:
            mesh.maxhullvert = _HULL_POINTS
        for geom in spec.geoms:
            if geom.meshname and not (geom.contype or geom.conaffinity):
                geom.conaffinity = DRAWN  # else MuJoCo makes no hull of it
        return spec.compile(), speeds
    except (OSError, ValueError, ET.ParseError, mujoco.FatalError) as error:
        raise _refusal(str(path), error) from None


def _refusal(model: str, error: Exception) -> InputError:
    return InputError(f"the model {model!r} cannot be compiled ({' '.join(str(error).split())}); correct it.")


def _readable_urdf(tree: ET.Element, path: Path) -> dict[str, float]:
    """Find the meshes, drop those that MuJoCo cannot read, say how it is to read the rest; speed limits."""
    for link in tree.iter("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            mesh = element.find("geometry/mesh")
            if mesh is None:
                continue
            file = _mesh_path(mesh.get("filename", ""), path)
            if file is None or file.suffix.lower() not in _MESHES:
                link.remove(element)
            else:
                mesh.set("filename", str(file))
    for kind in ("link", "joint"):
        names = [element.get("name", "") for element in tree.findall(kind)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"names of a {kind} used twice: {', '.join(twice)}")
    for old in tree.findall("mujoco"):
        tree.remove(old)
    tree.append(ET.fromstring(_URDF_OPTIONS))
    return {
        joint.get("name", ""): float(limit.get("velocity", "inf"))
        for joint in tree.iter("joint")
        for limit in joint.findall("limit")
    }


def _mesh_path(name: str, path: Path) -> Path | None:
    """File of a mesh of a URDF: of a ROS package, that of a folder above the URDF; None if there is none."""
    plain = name.removeprefix("file://")
    if not plain.startswith("package://"):
        file = path.parent / plain
        return file.resolve() if file.is_file() else None
    package, _, rest = plain.removeprefix("package://").partition("/")
    for folder in path.resolve().parents:
        for file in (folder / package / rest, folder / rest):
            if file.is_file():
                return file
    return None


def _drop_missing_meshes(spec: mujoco.MjSpec) -> None:
    """Drop meshes whose files are not there: some packages have models without them."""
    missing = [mesh for mesh in spec.meshes if mesh.file and not _mesh_file(spec, mesh).is_file()]
    names = {mesh.name or Path(mesh.file).stem for mesh in missing}
    for geom in list(spec.geoms):
        if geom.meshname in names:
            spec.delete(geom)
    for mesh in missing:
        spec.delete(mesh)


def _mesh_file(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> Path:
    return Path(spec.modelfiledir or ".", spec.meshdir or "", mesh.file)


def _drop_textures(spec: mujoco.MjSpec) -> None:
    """Drop textures: to generate them takes most of the time to compile, and no body shows them."""
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)


def _exact_xml(spec: mujoco.MjSpec) -> str:
    """MJCF of a compiled spec with all digits; MuJoCo writes six unless its library is told otherwise."""
    library = ctypes.CDLL(mujoco._functions.__file__)
    digits = library._mjPRIVATE__get_xml_precision()
    library._mjPRIVATE__set_xml_precision(_ALL_DIGITS)
    try:
        return str(spec.to_xml())
    finally:
        library._mjPRIVATE__set_xml_precision(digits)


def by_pattern(table: ByPattern, joint: str, default: float) -> float:
    """Value of the last pattern that matches a joint's whole name."""
    values = [value for pattern, value in table.items() if pattern.fullmatch(joint)]
    return values[-1] if values else default

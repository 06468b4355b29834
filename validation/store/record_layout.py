"""Where the numbers of a record lie on disk: which array is which columns of which Parquet file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

FEET = ("left", "right")
XYZ = ("x", "y", "z")
_ROOT_Q = ("root_x", "root_y", "root_z", "root_qw", "root_qx", "root_qy", "root_qz")
_ROOT_V = ("root_x", "root_y", "root_z", "root_wx", "root_wy", "root_wz")

JOINTS_FILE = "joints.parquet"
CONTACTS_FILE = "contacts.parquet"
STATES_FILE = "states.parquet"
TICKS_FILE = "ticks.parquet"
RECORD_FILES = (JOINTS_FILE, CONTACTS_FILE, STATES_FILE, TICKS_FILE)


@dataclass(frozen=True)
class RecordBlock:
    """One array of the record and where its scalars lie on disk."""

    field: str
    file: str
    rows: int
    tail: tuple[int, ...]
    columns: tuple[str, ...]


def record_blocks(header: Mapping[str, Any]) -> Iterator[RecordBlock]:
    """Every array of a record whose header this is."""
    k, ticks, nq, nv = header["steps"], header["ticks"], header["nq"], header["nv"]
    joints, points = header["joint_names"], header["point_names"]

    def vector(prefix: str, names: tuple[str, ...] | list[str]) -> tuple[str, ...]:
        return tuple(f"{prefix}_{name}" for name in names)

    def per_point(prefix: str) -> tuple[str, ...]:
        return tuple(f"{point}_{prefix}_{axis}" for point in points for axis in XYZ)

    q_names = _coordinate_names(nq, _ROOT_Q, joints)
    v_names = _coordinate_names(nv, _ROOT_V, joints)
    yield RecordBlock("time", JOINTS_FILE, k + 1, (), ("time",))
    yield RecordBlock("q", JOINTS_FILE, k + 1, (nq,), vector("q", q_names))
    yield RecordBlock("qd", JOINTS_FILE, k + 1, (nv,), vector("qd", v_names))
    yield RecordBlock("torque", JOINTS_FILE, k, (len(joints),), vector("torque", joints))
    yield RecordBlock("warmstart", JOINTS_FILE, k, (nv,), vector("warmstart", v_names))

    count = len(points)
    yield RecordBlock("time", CONTACTS_FILE, k + 1, (), ("time",))
    yield RecordBlock("point_force", CONTACTS_FILE, k, (count, 3), per_point("force"))
    yield RecordBlock("point_position", CONTACTS_FILE, k, (count, 3), per_point("position"))
    yield RecordBlock(
        "point_penetration", CONTACTS_FILE, k, (count,), tuple(f"{point}_penetration" for point in points)
    )
    yield RecordBlock("point_velocity", CONTACTS_FILE, k, (count, 3), per_point("velocity"))
    yield RecordBlock("command_point_force", CONTACTS_FILE, k, (count, 3), per_point("command_force"))

    yield RecordBlock("time", STATES_FILE, k + 1, (), ("time",))
    yield RecordBlock("com", STATES_FILE, k + 1, (3,), vector("com", XYZ))
    yield RecordBlock("angular_momentum", STATES_FILE, k + 1, (3,), vector("angular_momentum", XYZ))
    feet = tuple(f"{foot}_foot_{axis}" for foot in FEET for axis in XYZ)
    yield RecordBlock("foot_position", STATES_FILE, k + 1, (2, 3), feet)
    turned = tuple(f"{foot}_foot_{axis}" for foot in FEET for axis in ("qw", "qx", "qy", "qz"))
    yield RecordBlock("foot_rotation", STATES_FILE, k + 1, (2, 4), turned)
    yield RecordBlock("command_com", STATES_FILE, k, (3,), vector("command_com", XYZ))
    yield RecordBlock("command_zmp", STATES_FILE, k, (2,), vector("command_zmp", XYZ[:2]))
    yield RecordBlock("command_force", STATES_FILE, k, (3,), vector("command_force", XYZ))
    yield RecordBlock(
        "command_angular_momentum", STATES_FILE, k, (3,), vector("command_angular_momentum", XYZ)
    )
    for name, width in header["sensors"].items():
        columns = tuple(f"sensor_{name}_{index}" for index in range(width))
        yield RecordBlock(f"sensor:{name}", STATES_FILE, k + 1, (width,), columns)

    yield RecordBlock("tick_time", TICKS_FILE, ticks, (), ("time",))
    for name in ("qp_status", "qp_residual", "qp_iterations", "qp_time"):
        yield RecordBlock(name, TICKS_FILE, ticks, (), (name,))


def _coordinate_names(count: int, root: tuple[str, ...], joints: list[str]) -> list[str]:
    """Names of coordinates: a free root and the hinges, or plain numbers for any other body."""
    if count == len(root) + len(joints):
        return [*root, *joints]
    return [str(index) for index in range(count)]

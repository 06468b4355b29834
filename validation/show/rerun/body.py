"""The body in a recording: one entity for each segment, with its shapes."""

from typing import Any

import mujoco
import numpy as np
import rerun as rr

from ampm.geometry import Array
from validation.show.walker import drawn_geoms

_GEOM = mujoco.mjtGeom


def segment_entity(model: mujoco.MjModel, body: int) -> str:
    """Name of the entity of a segment."""
    return f"world/body/{rr.escape_entity_path_part(model.body(body).name or str(body))}"


def segment_poses(model: mujoco.MjModel, q: Array) -> tuple[Array, Array]:
    """Where the segments are, by forward kinematics of configurations, shape (N, nq).

    Positions have shape (N, nbody, 3) [m], and quaternions x, y, z, w (N, nbody, 4).
    """
    data = mujoco.MjData(model)
    position = np.empty((len(q), model.nbody, 3))
    quaternion = np.empty((len(q), model.nbody, 4))
    for row, qpos in enumerate(q):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        position[row], quaternion[row] = data.xpos, np.roll(data.xquat, -1, axis=1)
    return position, quaternion


def segment_shapes(model: mujoco.MjModel) -> dict[str, list[Any]]:
    """Entity of every shape to its place in its segment, and the shape.

    The millimetre spheres of the soles are left out: contact points are drawn at the contact.
    """
    found = {}
    for geom in drawn_geoms(model).tolist():
        entity = f"{segment_entity(model, model.geom_bodyid[geom])}/{geom}"
        turn = rr.Quaternion(xyzw=np.roll(model.geom_quat[geom], -1))
        place = rr.Transform3D(translation=model.geom_pos[geom], quaternion=turn)
        found[entity] = [place, _shape(model, geom)]
    return found


def _shape(model: mujoco.MjModel, geom: int) -> Any:
    """A shape in its own axes; lightened for a dark background; transparent, to show force and COM inside."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    red, green, blue = (round(255 * (0.7 * float(part) + 0.3)) for part in model.geom_rgba[geom, :3])
    color = (red, green, blue, 90)
    if kind == _GEOM.mjGEOM_MESH:
        return mesh_of(model, int(model.geom_dataid[geom]), color)
    solid: dict[str, Any] = {"colors": [color], "fill_mode": rr.components.FillMode.Solid}
    if kind == _GEOM.mjGEOM_CAPSULE:  # Rerun's begins at the centre of its lower hemisphere
        return rr.Capsules3D(lengths=2 * size[1], radii=size[0], translations=[(0, 0, -size[1])], **solid)
    if kind == _GEOM.mjGEOM_CYLINDER:
        return rr.Cylinders3D(lengths=2 * size[1], radii=size[0], **solid)
    if kind == _GEOM.mjGEOM_BOX:
        return rr.Boxes3D(half_sizes=[size], **solid)
    half = size if kind == _GEOM.mjGEOM_ELLIPSOID else np.full(3, size[0])
    return rr.Ellipsoids3D(half_sizes=[half], **solid)


def mesh_of(model: mujoco.MjModel, mesh: int, color: tuple[int, int, int, int]) -> rr.Mesh3D:
    """A mesh in its geom's axes [m], flat shaded."""
    first, faces = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    points = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    corners = model.mesh_face[faces : faces + int(model.mesh_facenum[mesh])]
    triangles = points[corners]  # (n, 3, 3): corners of their own, so that each has its face's normal
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return rr.Mesh3D(
        vertex_positions=triangles.reshape(-1, 3),
        vertex_normals=np.repeat(normal, 3, axis=0),
        triangle_indices=np.arange(3 * len(triangles)).reshape(-1, 3),
        albedo_factor=color,
    )

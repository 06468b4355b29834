"""Meshes of a model for a recording."""

import mujoco
import numpy as np
import rerun as rr


def mesh_of(model: mujoco.MjModel, mesh: int, color: tuple[int, int, int, int]) -> rr.Mesh3D:
    """A mesh in its geom's axes [m], flat shaded.

    Args:
        model: compiled model.
        mesh: its number.
        color: red, green, blue, opacity.
    """
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

"""Meshes with fewer triangles, for the eye."""

from __future__ import annotations

import numpy as np

from rpl_data.types import Mesh


def simplified(mesh: Mesh, *, most_triangles: int) -> Mesh:
    """The mesh with no more triangles than that, its shape kept by quadric error (Garland, Heckbert 1997)."""
    if len(mesh.triangles) <= most_triangles:
        return mesh
    import open3d as o3d

    legacy = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    if mesh.colors is not None:
        legacy.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255.0)
    small = legacy.simplify_quadric_decimation(most_triangles)
    colors = np.clip(np.asarray(small.vertex_colors) * 255, 0, 255).round().astype(np.uint8)
    return Mesh(
        np.asarray(small.vertices).copy(),
        np.asarray(small.triangles).astype(np.int64),
        colors if small.has_vertex_colors() else None,
    )

"""A mesh with colours per vertex -> fewer triangles with a texture, which viewers and estimators load."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rpl_data.meshes import simplified
from rpl_data.types import DataError, Mesh

TEXTURED_TRIANGLES = 4_000
"""Cutting a surface into charts takes time that grows faster than its triangles."""

TEXTURE_PX = 1024
GREY = 160


def save_textured(mesh: Mesh, files: Sequence[Path]) -> None:
    """Unwrap a mesh, and paint each texel in the colour that the full mesh has there; grey without colours.

    Charts by Open3D's `compute_uvatlas` (Zhou et al., "Iso-charts", SGP 2004). Colours are taken from the
    nearest vertices of the full mesh, so that fewer triangles do not blur them.

    Args:
        mesh: the mesh, metres.
        files: `.glb`, or `.obj`, which gets its `.mtl` and `.png` beside it; their folder must be there.

    Raises:
        DataError: the surface cannot be cut into charts.
    """
    import open3d as o3d

    few = with_two_triangles_per_edge(simplified(mesh, most_triangles=TEXTURED_TRIANGLES))
    triangles = o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor(few.vertices.astype(np.float32)), o3d.core.Tensor(few.triangles.astype(np.int32))
    )
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        triangles.compute_vertex_normals()
        try:
            triangles.compute_uvatlas(size=TEXTURE_PX, gutter=2.0, max_stretch=0.3)
        except RuntimeError as error:
            raise DataError(
                f"{files[0].stem}: its surface cannot be cut into charts for a texture "
                f"({str(error).splitlines()[-1].strip()}); crop the mesh to the object, or leave this format "
                "out of `export`"
            ) from error
        baked = triangles.bake_vertex_attr_textures(TEXTURE_PX, {"positions"}, margin=2, fill=np.nan)
        image = _painted(baked["positions"].numpy(), mesh)
        triangles.material.material_name = "defaultLit"
        triangles.material.texture_maps["albedo"] = o3d.t.geometry.Image(o3d.core.Tensor(image))
        for file in files:
            o3d.t.io.write_triangle_mesh(str(file), triangles)


def with_two_triangles_per_edge(mesh: Mesh) -> Mesh:
    """Detach the triangles at edges that more than two share, which charts cannot have: they get own corners.

    Nothing moves, and no triangle is lost.
    """
    sides = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, edge, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    loose = (count[edge.ravel()] > 2).reshape(-1, 3).any(axis=1)
    if not loose.any():
        return mesh
    corners = mesh.triangles[loose].ravel()
    triangles = mesh.triangles.copy()
    triangles[loose] = len(mesh.vertices) + np.arange(len(corners)).reshape(-1, 3)
    colors = None if mesh.colors is None else np.concatenate([mesh.colors, mesh.colors[corners]])
    return Mesh(np.concatenate([mesh.vertices, mesh.vertices[corners]]), triangles, colors)


def _painted(places: np.ndarray, mesh: Mesh) -> UInt8[np.ndarray, "side side 3"]:
    """Colours of the full mesh at the places of all texels; grey where a texel belongs to no triangle."""
    from scipy.spatial import cKDTree

    image = np.full(places.shape, GREY, np.uint8)
    used = np.isfinite(places).all(axis=2)
    if mesh.colors is not None and used.any():
        distance, nearest = cKDTree(mesh.vertices).query(places[used], k=3)
        weight = 1 / np.maximum(distance, 1e-9)
        mixed = (mesh.colors[nearest] * weight[..., None]).sum(axis=1) / weight.sum(axis=1)[:, None]
        image[used] = mixed.round().astype(np.uint8)
    return image

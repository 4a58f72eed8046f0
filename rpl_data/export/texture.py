"""A mesh with colours per vertex -> fewer triangles with a texture, which viewers and estimators load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rpl_data.meshes import simplified
from rpl_data.types import DataError, Mesh

TEXTURED_TRIANGLES = 4_000
"""Cutting a surface into charts takes time that grows faster than its triangles."""

TEXTURE_PX = 1024
GREY = 160
APART_M = 1e-6


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

    few = manifold(simplified(mesh, most_triangles=TEXTURED_TRIANGLES))
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


def manifold(mesh: Mesh) -> Mesh:
    """The triangles, cut apart wherever they do not form a surface: what is unwrapped must be one.

    Triangles stay joined across an edge that exactly two of them share, in opposite directions. Around a
    vertex, each group of triangles joined in this way gets a vertex of its own, moved by `APART_M` towards
    the middle of its group: Open3D joins vertices that lie in one place again.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, once = np.unique(np.sort(mesh.triangles, axis=1), axis=0, return_index=True)  # no flap of two sides
    mesh = replace(mesh, triangles=mesh.triangles[np.sort(once)])
    # A corner is a triangle's use of a vertex; edge k of a triangle leads from its corner k to the next one.
    corners = np.arange(mesh.triangles.size).reshape(-1, 3)
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    edge_corners = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    forwards = ends[:, 0] < ends[:, 1]
    _, edge, uses = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True)
    up = np.bincount(edge[forwards], minlength=len(uses))
    shared = np.flatnonzero((uses == 2) & (up == 1))
    first, second = np.full(len(uses), -1), np.full(len(uses), -1)
    first[edge[forwards]], second[edge[~forwards]] = np.flatnonzero(forwards), np.flatnonzero(~forwards)
    one, other = edge_corners[first[shared]].ravel(), edge_corners[second[shared]][:, ::-1].ravel()
    links = coo_matrix((np.ones(len(one)), (one, other)), shape=(corners.size, corners.size))
    count, vertex_of_corner = connected_components(links, directed=False)
    vertex = np.zeros(count, dtype=np.int64)
    vertex[vertex_of_corner] = mesh.triangles.ravel()
    middles = np.zeros((count, 3))
    np.add.at(middles, vertex_of_corner, np.repeat(mesh.vertices[mesh.triangles].mean(axis=1), 3, axis=0))
    inwards = middles / np.bincount(vertex_of_corner)[:, None] - mesh.vertices[vertex]
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    split = np.bincount(vertex)[vertex] > 1
    return replace(
        mesh,
        vertices=mesh.vertices[vertex] + APART_M * inwards * split[:, None],
        triangles=vertex_of_corner.reshape(-1, 3).astype(mesh.triangles.dtype),
        colors=None if mesh.colors is None else mesh.colors[vertex],
    )


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

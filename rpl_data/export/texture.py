"""A mesh with colours per vertex -> fewer triangles with a texture, which viewers and estimators load."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rpl_data.meshes import simplified
from rpl_data.types import Mesh

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
    """
    import open3d as o3d

    few = simplified(mesh, most_triangles=TEXTURED_TRIANGLES)
    triangles = o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor(few.vertices.astype(np.float32)), o3d.core.Tensor(few.triangles.astype(np.int32))
    )
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        triangles.compute_vertex_normals()
        triangles.compute_uvatlas(size=TEXTURE_PX, gutter=2.0, max_stretch=0.3)
        baked = triangles.bake_vertex_attr_textures(TEXTURE_PX, {"positions"}, margin=2, fill=np.nan)
        image = _painted(baked["positions"].numpy(), mesh)
        triangles.material.material_name = "defaultLit"
        triangles.material.texture_maps["albedo"] = o3d.t.geometry.Image(o3d.core.Tensor(image))
        for file in files:
            o3d.t.io.write_triangle_mesh(str(file), triangles)


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

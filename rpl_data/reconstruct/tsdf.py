"""A truncated signed distance field (TSDF): depth images in, a surface out. Open3D does the work."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.types import ColorImage, DepthImage, Intrinsics, Mesh

BLOCK_VOXELS = 8  # 8^3 blocks cost half of Open3D's default 16^3 here: fewer voxels far from the surface
TRUNCATION_VOXELS = 2.0
"""Truncation distance of the TSDF, in voxels. The two sides of a wall thinner than this share voxels, so it
comes out too thick."""


def empty_grid(voxel_m: float, *, colored: bool) -> Any:
    """A grid of voxels without depth yet."""
    import open3d as o3d

    names, dtypes, channels = ["tsdf", "weight"], [o3d.core.float32] * 2, [(1,), (1,)]
    if colored:
        names, dtypes, channels = [*names, "color"], [*dtypes, o3d.core.float32], [*channels, (3,)]
    # The tensor grid: Open3D 0.20's legacy ScalableTSDFVolume returns an empty mesh without a word.
    return o3d.t.geometry.VoxelBlockGrid(
        attr_names=tuple(names),
        attr_dtypes=tuple(dtypes),
        attr_channels=tuple(channels),
        voxel_size=voxel_m,
        block_resolution=BLOCK_VOXELS,
        block_count=4000,
        device=o3d.core.Device("CPU:0"),
    )


def integrate(
    grid: Any,
    depth_m: DepthImage,
    color: ColorImage | None,
    view: Intrinsics,
    camera_from_scene: Float64[np.ndarray, "4 4"],
) -> None:
    """Add one depth image to the grid."""
    import open3d as o3d

    # Open3D truncates projected positions to a pixel; with our pixel centres at whole numbers the
    # nearest pixel is floor(u + 0.5), hence the half pixel on the principal point.
    matrix = view.matrix
    matrix[:2, 2] += 0.5
    intrinsic, extrinsic = o3d.core.Tensor(matrix), o3d.core.Tensor(camera_from_scene)
    depth = o3d.t.geometry.Image(np.ascontiguousarray(depth_m, dtype=np.float32))
    limit_m = float(depth_m.max()) + 0.01
    blocks = grid.compute_unique_block_coordinates(
        depth, intrinsic, extrinsic, 1.0, limit_m, trunc_voxel_multiplier=TRUNCATION_VOXELS
    )
    if color is None:
        grid.integrate(blocks, depth, intrinsic, extrinsic, 1.0, limit_m, TRUNCATION_VOXELS)
    else:
        # Open3D takes float colours from 0 to 1, and gives back the same.
        image = o3d.t.geometry.Image(np.ascontiguousarray(color, dtype=np.float32) / 255.0)
        grid.integrate(blocks, depth, image, intrinsic, extrinsic, 1.0, limit_m, TRUNCATION_VOXELS)


def extract(grid: Any, *, weight_threshold: float) -> Mesh:
    """The surface, of the voxels that so many images at least have seen."""
    extracted = grid.extract_triangle_mesh(weight_threshold=weight_threshold)
    vertices = extracted.vertex.positions.numpy().astype(np.float64)
    triangles = extracted.triangle.indices.numpy().astype(np.int64)
    colors = None
    if "colors" in extracted.vertex:
        scaled = extracted.vertex.colors.numpy()  # 0..1
        colors = np.clip(np.round(scaled * 255), 0, 255).astype(np.uint8)
    return Mesh(vertices, triangles, colors)

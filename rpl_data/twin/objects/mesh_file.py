"""Objects of a twin from mesh files (OBJ, PLY or GLB), with landmarks that a person might choose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.twin.objects.landmarks import landmark_points
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.surfaces import Surface
from rpl_data.types import ColorImage, DataError

GREY = (150, 150, 150)
BLOCK_PX = 3
"""Side of the piece of texture that each triangle with coloured vertices gets."""


def object_of_file(
    name: str, path: Path, landmarks: int | Sequence[Sequence[float]], *, gloss: float
) -> TwinObject:
    """Load the mesh of a file (metres), with landmarks chosen (a count) or given (points in its frame).

    Raises:
        DataError: no such file, no triangles, apparently not in metres, or too few landmarks.
    """
    surface = read_surface(path, gloss=gloss)
    if isinstance(landmarks, int):
        if landmarks < 3:
            raise DataError(f"twin object {name}: ask for at least 3 landmarks, not {landmarks}")
        points = landmark_points(surface, landmarks)
    else:
        points = np.array(landmarks, dtype=float).reshape(-1, 3)
    return assembled(name, surface, {str(number): point.tolist() for number, point in enumerate(points)})


def read_surface(path: Path, *, gloss: float) -> Surface:
    """Read the triangles of a file with its texture, or else its vertex colours, or else grey.

    Raises:
        DataError: no such file, no triangles, or a size that no hand-held thing has in metres.
    """
    import open3d as o3d

    if not path.is_file():
        raise DataError(
            f"there is no mesh file {path}; check `mesh:` in the recipe, or the folder given by --root"
        )
    mesh = o3d.t.io.read_triangle_mesh(str(path))
    if "indices" not in mesh.triangle or not len(mesh.triangle.indices):
        raise DataError(f"{path} holds no triangles; expected a mesh, not a point cloud")
    mesh.compute_vertex_normals()
    vertices = mesh.vertex.positions.numpy().astype(float)
    triangles = mesh.triangle.indices.numpy().astype(np.int64)
    size_m = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if not 0.01 < size_m < 2:
        raise DataError(f"{path} is {size_m:.3g} m across; a twin's object is in metres, 0.01 to 2 m")
    corner_uv, texture = _texture_of(mesh, triangles)
    normals = mesh.vertex.normals.numpy().astype(np.float32)[triangles]
    shine = np.full(len(triangles), gloss, np.float32)
    return Surface(vertices, triangles, corner_uv, normals, texture, shine)


def _texture_of(mesh: Any, triangles: np.ndarray) -> tuple[np.ndarray, ColorImage]:
    """Return the texture, and the position of every triangle corner in it (v down)."""
    if "texture_uvs" in mesh.triangle and mesh.has_valid_material():
        maps = mesh.material.texture_maps
        if "albedo" in maps and maps["albedo"].rows:
            texture = np.ascontiguousarray(maps["albedo"].as_tensor().numpy()[..., :3])
            uv = mesh.triangle.texture_uvs.numpy().astype(np.float32)
            return np.stack([uv[..., 0], 1 - uv[..., 1]], axis=-1) % np.float32(1.0), texture
    colors = np.full((len(mesh.vertex.positions), 3), GREY, np.uint8)
    if "colors" in mesh.vertex:
        stored = mesh.vertex.colors.numpy()
        whole = np.issubdtype(stored.dtype, np.integer)
        colors = (stored if whole else np.round(255 * stored)).clip(0, 255).astype(np.uint8)[:, :3]
    return _blocks(colors[triangles])


def _blocks(corner_colors: np.ndarray) -> tuple[np.ndarray, ColorImage]:
    """Make a texture in which every triangle has a small square with its corners' colours, blended."""
    across = int(np.ceil(np.sqrt(len(corner_colors))))
    step = np.arange(BLOCK_PX) / (BLOCK_PX - 1)
    a, b, c = (corner_colors[:, i, None, None].astype(float) for i in range(3))
    blended = a + step[None, None, :, None] * (b - a) + step[None, :, None, None] * (c - a)
    cells = np.zeros((across * across, BLOCK_PX, BLOCK_PX, 3), np.uint8)
    cells[: len(blended)] = blended.clip(0, 255).round().astype(np.uint8)
    texture = cells.reshape(across, across, BLOCK_PX, BLOCK_PX, 3).swapaxes(1, 2)
    number = np.arange(len(corner_colors))
    corner = np.stack([number % across, number // across], -1)[:, None] * BLOCK_PX + 0.5
    far = BLOCK_PX - 1
    uv = (corner + np.array([[0, 0], [far, 0], [0, far]])) / (across * BLOCK_PX)
    return uv.astype(np.float32), texture.reshape(across * BLOCK_PX, across * BLOCK_PX, 3)

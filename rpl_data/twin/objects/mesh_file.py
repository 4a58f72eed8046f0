"""Anybody's textured mesh as an object of a twin: OBJ, PLY or GLB, and landmarks a person might choose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from rpl_data.raycast import RayScene
from rpl_data.twin.objects.model import TwinObject, assembled
from rpl_data.twin.surfaces import Surface
from rpl_data.types import ColorImage, DataError

GREY = (150, 150, 150)
NEIGHBOURHOOD = 0.05
"""Radius in which a corner or edge is looked for, as a share of the mesh's diagonal."""
BLOCK_PX = 3
"""Side of the piece of texture that a triangle with coloured vertices gets."""


def object_of_file(
    name: str, path: Path, landmarks: int | Sequence[Sequence[float]], *, gloss: float
) -> TwinObject:
    """The mesh of a file, metres, with landmarks chosen (a count) or given (points in the file's frame).

    Raises:
        DataError: no such file, no triangles, not metres by the look of it, or too few landmarks.
    """
    surface = read_surface(path, gloss=gloss)
    if isinstance(landmarks, int):
        if landmarks < 3:
            raise DataError(f"twin object {name}: ask for at least 3 landmarks, not {landmarks}")
        points = corner_points(surface, landmarks)
    else:
        points = np.array(landmarks, dtype=float).reshape(-1, 3)
    return assembled(name, surface, {str(number): point.tolist() for number, point in enumerate(points)})


def read_surface(path: Path, *, gloss: float) -> Surface:
    """Triangles of a file with its texture, or with its vertices' colours, or grey.

    Raises:
        DataError: no such file, no triangles, or a size no hand-held thing has in metres.
    """
    import open3d as o3d

    if not path.is_file():
        raise DataError(
            f"there is no mesh {path}; check `mesh:` in the recipe, or the folder given by --root"
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
    """Position of every corner in the texture, v down, and the texture."""
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
    """A texture in which every triangle has a small square that holds its corners' colours, blended."""
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


# Landmarks ----------------------------------------------------------------------------------------


def corner_points(surface: Surface, count: int) -> Float64[np.ndarray, "count 3"]:
    """Vertices a person would click: on corners and edges, open to view, well spread.

    A vertex is a corner or an edge when normals around it point many ways (the second and third
    eigenvalue of their scatter, as in normal voting: Medioni, Lee & Tang, 2000). The sharpest that stand
    out to the eye are kept; of those the farthest-point order takes the first `count`.
    """
    vertices = np.unique(surface.vertices[np.unique(surface.triangles)].round(6), axis=0)
    radius_m = NEIGHBOURHOOD * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    sharpness = _sharpness(surface, vertices, radius_m)
    peaks = _peaks(vertices, sharpness, radius_m)
    peaks = peaks[_exposure(surface, vertices[peaks]) > 0.35]
    sharp = peaks[: max(4 * count, 12)]
    if len(sharp) < count:
        raise DataError(f"the mesh shows only {len(sharp)} corners or edges; ask for fewer than {count}")
    return _far_and_sharp(vertices[sharp], sharpness[sharp], count)


def _sharpness(
    surface: Surface, points: Float64[np.ndarray, "n 3"], radius_m: float
) -> Float64[np.ndarray, " n"]:
    """How many ways the surface faces around each point: 0 = flat, 1 = every way alike."""
    a, b, c = (surface.vertices[surface.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)  # as long as the triangle is large
    scatter = (
        normals[:, :, None] * normals[:, None] / (np.linalg.norm(normals, axis=1) + 1e-15)[:, None, None]
    )
    near = cKDTree((a + b + c) / 3).query_ball_point(points, radius_m)
    total = np.stack([scatter[rows].sum(axis=0) if rows else np.eye(3) * 1e-15 for rows in near])
    values = np.linalg.eigvalsh(total)
    sharpness: Float64[np.ndarray, " n"] = (values[:, 1] + 2 * values[:, 0]) / values.sum(axis=1)
    return sharpness


def _peaks(
    points: Float64[np.ndarray, "n 3"], sharpness: Float64[np.ndarray, " n"], radius_m: float
) -> np.ndarray:
    """Numbers of points sharper than any within the radius, the sharpest first."""
    tree, order = cKDTree(points), np.argsort(-sharpness)
    free, kept = np.ones(len(points), dtype=bool), []
    for number in order:
        if free[number]:
            kept.append(number)
            free[tree.query_ball_point(points[number], radius_m)] = False
    return np.array(kept)


def _exposure(surface: Surface, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """The share of all directions from which each point is seen."""
    rays = RayScene([surface.mesh], threads=1)
    turn, rise = np.arange(200) * np.pi * (3 - np.sqrt(5)), 1 - (np.arange(200) + 0.5) / 100
    out = np.stack([np.cos(turn) * np.sqrt(1 - rise**2), np.sin(turn) * np.sqrt(1 - rise**2), rise], -1)
    start = points[:, None] + 1e-3 * out[None]
    beams = np.concatenate([start, np.broadcast_to(out, start.shape)], axis=-1).reshape(-1, 6)
    blocked = rays.occluded(beams.astype(np.float32), far=10.0)
    seen: Float64[np.ndarray, " n"] = 1 - blocked.reshape(len(points), -1).mean(axis=1)
    return seen


def _far_and_sharp(
    points: Float64[np.ndarray, "n 3"], sharpness: Float64[np.ndarray, " n"], count: int
) -> Float64[np.ndarray, "count 3"]:
    """Each next point is far from those before it; of equally far ones the sharper is taken."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1) * sharpness))]
    while len(chosen) < count:
        apart = np.linalg.norm(points[:, None] - points[chosen][None], axis=-1).min(axis=1)
        chosen.append(int(np.argmax(apart * np.sqrt(sharpness))))
    return points[chosen]

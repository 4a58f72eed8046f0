"""Textured triangle surfaces, and the few shapes everything in a twin is put together from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, Int64

from rpl_data.geometry import Transform, transform
from rpl_data.types import ColorImage, Mesh

Grid = Float64[np.ndarray, "rows columns 3"]
UvRect = tuple[float, float, float, float]
"""u0, v0, u1, v1: a part of a texture, 0 to 1, v down."""
WHOLE: UvRect = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Surface:
    """Textured triangles, counter-clockwise from outside; metres.

    Attributes:
        corner_uv: position of every triangle corner in the texture, 0 to 1, v down.
        corner_normals: unit shading normal of every triangle corner.
        texture: sRGB.
        gloss: strength of the highlight, 0 (paper) to 1 (enamel).
    """

    vertices: Float64[np.ndarray, "n 3"]
    triangles: Int64[np.ndarray, "m 3"]
    corner_uv: Float32[np.ndarray, "m 3 2"]
    corner_normals: Float32[np.ndarray, "m 3 3"]
    texture: ColorImage
    gloss: float = 0.0

    def moved(self, a_from_b: Transform) -> Surface:
        """This surface, given in frame b, in frame a."""
        normals = (self.corner_normals @ a_from_b[:3, :3].T).astype(np.float32)
        return replace(self, vertices=transform(a_from_b, self.vertices), corner_normals=normals)

    @property
    def mesh(self) -> Mesh:
        """The triangles with the texture's colour at every vertex."""
        height, width = self.texture.shape[:2]
        uv = np.zeros((len(self.vertices), 2))
        uv[self.triangles.ravel()] = self.corner_uv.reshape(-1, 2)
        column = np.clip(uv[:, 0] * width, 0, width - 1).astype(int)
        row = np.clip(uv[:, 1] * height, 0, height - 1).astype(int)
        return Mesh(self.vertices, self.triangles, self.texture[row, column])


def patch(grid: Grid, uv_rect: UvRect = WHOLE) -> Surface:
    """A grid of points as a smooth surface; seen from outside rows go down and columns to the right.

    The texture is still blank: `joined` gives all patches of a thing theirs.
    """
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate(
        [np.stack([a, c, d], -1).reshape(-1, 3), np.stack([a, d, b], -1).reshape(-1, 3)]
    )
    v, u = np.meshgrid(
        np.linspace(uv_rect[1], uv_rect[3], rows), np.linspace(uv_rect[0], uv_rect[2], columns), indexing="ij"
    )
    uv = np.stack([u, v], -1).reshape(-1, 2)
    points = grid.reshape(-1, 3)
    flat = _triangle_normals(points, triangles)
    keep = np.linalg.norm(flat, axis=1) > 1e-12  # at a pole every second triangle is a line
    triangles, flat = triangles[keep], flat[keep]
    normals = _unit(_grid_normals(grid).reshape(-1, 3)[triangles])
    flat = _unit(flat)
    broken = np.einsum("mkc,mc->mk", normals, flat) < 0.3  # the same poles
    normals[broken] = np.broadcast_to(flat[:, None], normals.shape)[broken]
    blank = np.full((1, 1, 3), 128, np.uint8)
    return Surface(points, triangles, uv[triangles].astype(np.float32), normals.astype(np.float32), blank)


def joined(parts: Sequence[Surface], texture: ColorImage, *, gloss: float = 0.0) -> Surface:
    """Several surfaces as one, with one texture."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets, strict=False)]),
        np.concatenate([part.corner_uv for part in parts]),
        np.concatenate([part.corner_normals for part in parts]),
        texture,
        gloss,
    )


def quad(corners: Sequence[Sequence[float]], uv_rect: UvRect = WHOLE, *, cells: int = 8) -> Surface:
    """A flat patch; corners top left, top right, bottom left, bottom right seen from outside."""
    top_left, top_right, bottom_left, bottom_right = (np.asarray(corner, dtype=float) for corner in corners)
    t = np.linspace(0, 1, cells + 1)
    top = top_left + t[:, None] * (top_right - top_left)
    bottom = bottom_left + t[:, None] * (bottom_right - bottom_left)
    return patch(top[None] + t[:, None, None] * (bottom - top)[None], uv_rect)


def box(size_m: Sequence[float], uv_rects: Sequence[UvRect], *, cells: int = 8) -> list[Surface]:
    """The faces -y (front), +y (back), -x (left), +x (right), +z (top), -z (bottom) of a centred box."""
    x, y, z = (side / 2 for side in size_m)
    corners = [
        [(-x, -y, z), (x, -y, z), (-x, -y, -z), (x, -y, -z)],
        [(x, y, z), (-x, y, z), (x, y, -z), (-x, y, -z)],
        [(-x, y, z), (-x, -y, z), (-x, y, -z), (-x, -y, -z)],
        [(x, -y, z), (x, y, z), (x, -y, -z), (x, y, -z)],
        [(-x, y, z), (x, y, z), (-x, -y, z), (x, -y, z)],
        [(-x, -y, -z), (x, -y, -z), (-x, y, -z), (x, y, -z)],
    ]
    return [quad(face, rect, cells=cells) for face, rect in zip(corners, uv_rects, strict=True)]


def lathe_grid(profile_rz_m: Sequence[Sequence[float]], *, columns: int = 64) -> Grid:
    """The profile (radius, z; from the top down the outside) turned about z; columns start at +x."""
    radius, z = np.asarray(profile_rz_m, dtype=float).T
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    xy = radius[:, None, None] * ring[None]
    return np.concatenate([xy, np.broadcast_to(z[:, None, None], (len(z), columns + 1, 1))], -1)


def tube_grid(path_xz_m: Sequence[Sequence[float]], radii_m: Sequence[float], *, columns: int = 32) -> Grid:
    """Rings around a path in the plane y = 0, from its end (top row) to its start."""
    path = np.asarray(path_xz_m, dtype=float)[::-1]
    radii = np.asarray(radii_m, dtype=float)[::-1]
    along = _unit(np.gradient(path, axis=0))
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    across = np.stack([-along[:, 1], along[:, 0]], -1)  # in the plane, at right angles to the path
    grid = np.zeros((len(path), columns + 1, 3))
    grid[..., 0] = path[:, :1] + radii[:, None] * across[:, :1] * np.cos(angle)
    grid[..., 2] = path[:, 1:] + radii[:, None] * across[:, 1:] * np.cos(angle)
    grid[..., 1] = radii[:, None] * np.sin(angle)
    outward = grid[0] - [path[0, 0], 0.0, path[0, 1]]
    inside_out = np.sum(_grid_normals(grid)[0] * outward) < 0
    return grid[:, ::-1] if inside_out else grid


def _grid_normals(grid: Grid) -> Grid:
    normals: Grid = np.cross(np.gradient(grid, axis=1), -np.gradient(grid, axis=0))
    return normals


def _triangle_normals(
    points: Float64[np.ndarray, "n 3"], triangles: Int64[np.ndarray, "m 3"]
) -> Float64[np.ndarray, "m 3"]:
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    normals: Float64[np.ndarray, "m 3"] = np.cross(b - a, c - a)
    return normals


def _unit(vectors: np.ndarray) -> np.ndarray:
    unit: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15)
    return unit

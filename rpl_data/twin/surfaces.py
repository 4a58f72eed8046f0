"""Textured triangle surfaces, and the few shapes that everything in a twin is built from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.interpolate import PchipInterpolator

from rpl_data.geometry import Transform, transform
from rpl_data.types import ColorImage, Mesh

Grid = Float64[np.ndarray, "_ _ 3"]
UvRect = tuple[float, float, float, float]
"""u0, v0, u1, v1: a part of a texture, 0 to 1, v down."""
WHOLE: UvRect = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Surface:
    """Textured triangles, counter-clockwise seen from outside; metres.

    Attributes:
        corner_uv: position of every triangle corner in the texture, 0 to 1, v down.
        corner_normals: unit shading normal of every triangle corner.
        texture: sRGB image.
        gloss: strength of the highlight on every triangle, 0 (paper) to 1 (enamel, polished metal).
    """

    vertices: Float64[np.ndarray, "n 3"]
    triangles: Int64[np.ndarray, "m 3"]
    corner_uv: Float32[np.ndarray, "m 3 2"]
    corner_normals: Float32[np.ndarray, "m 3 3"]
    texture: ColorImage
    gloss: Float32[np.ndarray, " m"]

    def moved(self, a_from_b: Transform) -> Surface:
        """Transform this surface from frame b to frame a."""
        normals = (self.corner_normals @ a_from_b[:3, :3].T).astype(np.float32)
        return replace(self, vertices=transform(a_from_b, self.vertices), corner_normals=normals)

    @property
    def mesh(self) -> Mesh:
        """The triangles, with the texture's colour at every vertex."""
        height, width = self.texture.shape[:2]
        uv = np.zeros((len(self.vertices), 2))
        uv[self.triangles.ravel()] = self.corner_uv.reshape(-1, 2)
        column = np.clip(uv[:, 0] * width, 0, width - 1).astype(int)
        row = np.clip(uv[:, 1] * height, 0, height - 1).astype(int)
        return Mesh(self.vertices, self.triangles, self.texture[row, column])


def patch(grid: Grid, uv_rect: UvRect = WHOLE, *, gloss: float = 0.0) -> Surface:
    """Make a smooth surface from a grid of points; seen from outside, rows go down, columns to the right.

    The texture is still blank: `joined` gives all patches of a thing their texture.
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
    keep = np.linalg.norm(flat, axis=1) > 1e-12  # at a pole, every second triangle is a line
    triangles, flat = triangles[keep], flat[keep]
    normals = _unit(_grid_normals(grid).reshape(-1, 3)[triangles])
    flat = _unit(flat)
    broken = np.einsum("mkc,mc->mk", normals, flat) < 0.3  # at the same poles
    normals[broken] = np.broadcast_to(flat[:, None], normals.shape)[broken]
    blank = np.full((1, 1, 3), 128, np.uint8)
    shine = np.full(len(triangles), gloss, np.float32)
    return Surface(
        points, triangles, uv[triangles].astype(np.float32), normals.astype(np.float32), blank, shine
    )


def joined(parts: Sequence[Surface], texture: ColorImage) -> Surface:
    """Join several surfaces into one with one texture; each keeps its gloss."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets, strict=False)]),
        np.concatenate([part.corner_uv for part in parts]),
        np.concatenate([part.corner_normals for part in parts]),
        texture,
        np.concatenate([part.gloss for part in parts]),
    )


def quad(
    corners: Sequence[Sequence[float]], uv_rect: UvRect = WHOLE, *, cells: int = 8, gloss: float = 0.0
) -> Surface:
    """Make a flat patch; corners in the order top left, top right, bottom left, bottom right from outside."""
    top_left, top_right, bottom_left, bottom_right = (np.asarray(corner, dtype=float) for corner in corners)
    t = np.linspace(0, 1, cells + 1)
    top = top_left + t[:, None] * (top_right - top_left)
    bottom = bottom_left + t[:, None] * (bottom_right - bottom_left)
    return patch(top[None] + t[:, None, None] * (bottom - top)[None], uv_rect, gloss=gloss)


def box(
    size_m: Sequence[float],
    uv_rects: Sequence[UvRect],
    *,
    centre_m: Sequence[float] = (0.0, 0.0, 0.0),
    cells: int = 8,
    gloss: float = 0.0,
) -> list[Surface]:
    """Make a box of six faces: -y (front), +y (back), -x (left), +x (right), +z (top), -z (bottom)."""
    x, y, z = (side / 2 for side in size_m)
    corners = [
        [(-x, -y, z), (x, -y, z), (-x, -y, -z), (x, -y, -z)],
        [(x, y, z), (-x, y, z), (x, y, -z), (-x, y, -z)],
        [(-x, y, z), (-x, -y, z), (-x, y, -z), (-x, -y, -z)],
        [(x, -y, z), (x, y, z), (x, -y, -z), (x, y, -z)],
        [(-x, y, z), (x, y, z), (-x, -y, z), (x, -y, z)],
        [(-x, -y, -z), (x, -y, -z), (-x, y, -z), (x, y, -z)],
    ]
    placed = [(np.array(face) + np.asarray(centre_m)).tolist() for face in corners]
    return [quad(face, rect, cells=cells, gloss=gloss) for face, rect in zip(placed, uv_rects, strict=True)]


def lathe_grid(profile_rz_m: Sequence[Sequence[float]], *, columns: int = 64) -> Grid:
    """Turn a profile (radius, z; from the top down the outside) about z; columns start at +x."""
    radius, z = np.asarray(profile_rz_m, dtype=float).T
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    xy = radius[:, None, None] * ring[None]
    return np.concatenate([xy, np.broadcast_to(z[:, None, None], (len(z), columns + 1, 1))], -1)


def loft_grid(
    sections: Sequence[Sequence[float]],
    *,
    roundness: float = 2.0,
    columns: int = 64,
) -> Grid:
    """Stretch a skin over superellipses (z, centre x, centre y, half x, half y), from top to bottom.

    Columns start at +x.

    Args:
        roundness: exponent of the superellipse: 2 = ellipse, 6 = a box with rounded edges.
    """
    z, centre_x, centre_y, half_x, half_y = np.asarray(sections, dtype=float).T
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    cos, sin = (np.sign(f) * np.abs(f) ** (2 / roundness) for f in (np.cos(angle), np.sin(angle)))
    grid = np.empty((len(z), columns + 1, 3))
    grid[..., 0] = centre_x[:, None] + half_x[:, None] * cos
    grid[..., 1] = centre_y[:, None] + half_y[:, None] * sin
    grid[..., 2] = z[:, None]
    return grid


def smooth_path(points_m: Sequence[Sequence[float]], count: int) -> list[list[float]]:
    """Points, evenly spaced, of a smooth curve through the given ones (monotone cubics, no overshoot)."""
    points = np.asarray(points_m, dtype=float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    path: list[list[float]] = PchipInterpolator(along, points)(np.linspace(0, along[-1], count)).tolist()
    return path


def tube_grid(path_xz_m: Sequence[Sequence[float]], radii_m: Sequence[float], *, columns: int = 32) -> Grid:
    """Make rings around a path in the plane y = 0, from its end (top row) to its start."""
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
    right = np.gradient(grid, axis=1)
    if grid.shape[1] > 3 and np.allclose(grid[:, 0], grid[:, -1]):  # closed: avoid a seam in the shading
        right[:, 0] = right[:, -1] = (grid[:, 1] - grid[:, -2]) / 2
    normals: Grid = np.cross(right, -np.gradient(grid, axis=0))
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

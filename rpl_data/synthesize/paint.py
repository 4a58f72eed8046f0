"""Colour a mesh from images of known pose, and fit the light of their scenes.

Each point takes the colours of the images that show it best, divided by the light that its scene throws on
surfaces that face as it does. Colours and lights are fitted in turn: given the lights, a point's colour is a
weighted mean; given the colours, a scene's light is the solution of linear equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64
from scipy.spatial import cKDTree

from rpl_data.geometry import Pixels, Points, Transform, invert, transform
from rpl_data.raycast import PixelTable, RayScene, depth_along_m
from rpl_data.synthesize.light import BRIGHTEST, DARKEST, TERMS, Coefficients, harmonics
from rpl_data.synthesize.normals import steady_normals
from rpl_data.synthesize.painted import PaintedMesh, steps_for, texel_positions
from rpl_data.types import ColorImage, Mesh

LEAST_COSINE = 0.25
"""An image does not colour what it sees at a smaller cosine of incidence: 75 degrees off the normal."""
FAVOUR = 6.0
"""Power of (cosine / distance) by which an image counts: some two or three dominate at each point, for the
mean of many is blurred by the errors of their poses."""
BEHIND_M = 0.003
"""A point this far behind the surface that an image shows is hidden there."""
RIM_PX = 3
"""Pixels inside the outline that colour nothing: background shines through them."""
MOST_DISAGREEING = 15.0
"""Grey levels by which images of a carved object may differ from its colours, in the median over its texels;
above, they show what lies behind it. The objects of `datasets/training_twin.yaml` are at 5 to 7."""
LEAST_PAINTED = 0.5
"""Share of a triangle's texels that images must colour for it to count as seen."""
NEIGHBOUR_M = 0.01
"""A texel that no image shows takes the colour of one within this distance, else that of the mesh."""
ROUNDS = 6
"""Times that colours and lights are fitted in turn."""
FITTED_EVERY = 8
"""Lights are fitted to one in so many texels."""
RIDGE = 0.003
"""Weight by which a light is pulled to even light, per unit of data: its terms are not told apart where few
normals are seen."""


@dataclass(frozen=True)
class Photo:
    """An image of the object.

    Attributes:
        scene: what shares one light.
        scene_from_camera: of the image.
        visible: True where the object is seen.
    """

    scene: str
    camera: PixelTable
    scene_from_camera: Transform
    camera_from_object: Transform
    color: ColorImage
    visible: Bool[np.ndarray, "height width"]


@dataclass(frozen=True)
class _Sight:
    """The texels that one image shows: their rows, colours, weights, and normals in the scene frame."""

    scene: str
    rows: Int64[np.ndarray, " k"]
    colors: Float32[np.ndarray, "k 3"]
    weights: Float32[np.ndarray, " k"]
    terms: Float32[np.ndarray, "k 9"]


def paint(
    mesh: Mesh, seen: Bool[np.ndarray, " m"] | None, photos: Iterable[Photo]
) -> tuple[PaintedMesh, dict[str, Coefficients]]:
    """Colour the texels of a mesh; also returns the light of each scene.

    Where no image shows a texel, its colour is a guess, and its triangle is not `seen`.

    Args:
        mesh: object frame.
        seen: for each triangle, whether depth images saw it; None for a carved mesh, which they never saw.
            What two images of that one colour counts as seen, if they agree on its colours.
        photos: read one at a time.
    """
    steps = steps_for(mesh)
    points = texel_positions(mesh, steps)
    normals = texel_positions(Mesh(steady_normals(mesh), mesh.triangles), steps)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    rays = RayScene([mesh], threads=1)
    sights = [sight for photo in photos if (sight := _sight(rays, mesh, points, normals, photo)) is not None]
    colors, lights = _fitted(sights, len(points))
    painted = np.isfinite(colors[:, 0])
    _fill(colors, painted, points, mesh, steps)
    texels = colors.round().clip(0, 255).astype(np.uint8).reshape(len(mesh.triangles), -1, 3)
    if seen is None:
        painted = _agreed(sights, colors, lights)
    share = painted.reshape(len(mesh.triangles), -1).mean(axis=1)
    known = share >= LEAST_PAINTED if seen is None else seen & (share >= LEAST_PAINTED)
    return PaintedMesh(mesh.vertices, mesh.triangles, texels, known), lights


# Colours and lights -------------------------------------------------------------------------------


def _fitted(sights: Sequence[_Sight], count: int) -> tuple[np.ndarray, dict[str, Coefficients]]:
    """Colours of all texels, NaN where no image shows them, and the light of each scene."""
    even = np.zeros((TERMS, 3))
    even[0] = 1
    lights = dict.fromkeys((sight.scene for sight in sights), even)
    few = [_thinned(sight) for sight in sights]
    for _ in range(ROUNDS if len(lights) > 1 else 0):
        colors = _colors(few, lights, count)
        lights = {scene: _light([s for s in few if s.scene == scene], colors) for scene in lights}
        mean = np.mean([one[0] for one in lights.values()], axis=0)
        lights = {scene: one / mean for scene, one in lights.items()}
    return _colors(sights, lights, count), lights


def _thinned(sight: _Sight) -> _Sight:
    """Some of the texels, the same ones of all images: enough to fit lights by."""
    kept = sight.rows % FITTED_EVERY == 0
    return _Sight(sight.scene, sight.rows[kept], sight.colors[kept], sight.weights[kept], sight.terms[kept])


def _factor(sight: _Sight, light: Coefficients) -> Float32[np.ndarray, "k 3"]:
    factor: Float32[np.ndarray, "k 3"] = (sight.terms @ light.astype(np.float32)).clip(DARKEST, BRIGHTEST)
    return factor


def _colors(sights: Sequence[_Sight], lights: Mapping[str, Coefficients], count: int) -> np.ndarray:
    """The colours that explain the images best, given the lights."""
    total, weight = np.zeros((count, 3)), np.zeros((count, 3))
    for sight in sights:
        factor = _factor(sight, lights[sight.scene])
        total[sight.rows] += sight.weights[:, None] * factor * sight.colors
        weight[sight.rows] += sight.weights[:, None] * factor**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / weight


def _light(sights: Sequence[_Sight], colors: np.ndarray) -> Coefficients:
    """The light that explains a scene's images best, given the colours."""
    normal, right = np.zeros((3, TERMS, TERMS)), np.zeros((TERMS, 3))
    data = 0.0
    for sight in sights:
        known = colors[sight.rows]
        weight = sight.weights / max(float(sight.weights.max()), 1e-9)
        for channel in range(3):
            by_color = sight.terms * (known[:, channel : channel + 1] / 255)
            normal[channel] += (by_color * weight[:, None]).T @ by_color
            right[:, channel] += by_color.T @ (weight * sight.colors[:, channel] / 255)
        data += float((weight[:, None] * (known / 255) ** 2).sum()) / 3
    even = np.zeros(TERMS)
    even[0] = 1
    ridge = RIDGE * data * np.eye(TERMS)
    solved = [np.linalg.solve(normal[c] + ridge, right[:, c] + ridge @ even) for c in range(3)]
    return np.column_stack(solved)


def _agreed(
    sights: Sequence[_Sight], colors: np.ndarray, lights: Mapping[str, Coefficients]
) -> Bool[np.ndarray, " n"]:
    """The texels that two images or more show; none where they disagree by more than `MOST_DISAGREEING`."""
    total, weight, looks = np.zeros(len(colors)), np.zeros(len(colors)), np.zeros(len(colors), np.int64)
    for sight in sights:
        off = sight.colors - _factor(sight, lights[sight.scene]) * colors[sight.rows]
        total[sight.rows] += sight.weights * (off**2).mean(axis=1)
        weight[sight.rows] += sight.weights
        looks[sight.rows] += 1
    shown = looks > 1
    if not shown.any() or np.sqrt(np.median(total[shown] / weight[shown])) > MOST_DISAGREEING:
        return np.zeros_like(shown)
    return shown


def _fill(
    colors: np.ndarray, painted: Bool[np.ndarray, " n"], points: Points, mesh: Mesh, steps: int
) -> None:
    """Give texels that no image shows the colours of their neighbours, else those of the mesh."""
    lacking = np.flatnonzero(~painted)
    if not len(lacking):
        return
    own = np.full((len(mesh.vertices), 3), 128.0) if mesh.colors is None else mesh.colors.astype(float)
    colors[lacking] = texel_positions(Mesh(own, mesh.triangles), steps)[lacking]
    if painted.any():
        distance, nearest = cKDTree(points[painted]).query(points[lacking], distance_upper_bound=NEIGHBOUR_M)
        near = np.isfinite(distance)
        colors[lacking[near]] = colors[painted][nearest[near]]


# What an image shows ------------------------------------------------------------------------------


def _sight(rays: RayScene, mesh: Mesh, points: Points, normals: Points, photo: Photo) -> _Sight | None:
    """The texels that an image shows; None where it shows none."""
    pose = photo.camera_from_object
    window = photo.camera.window(transform(pose, mesh.vertices))
    if window is None:
        return None
    towards = invert(pose)[:3, 3] - points
    distance = np.linalg.norm(towards, axis=1)
    cosine = np.einsum("nd,nd->n", towards, normals) / distance
    rows = np.flatnonzero(cosine > LEAST_COSINE)
    in_camera = transform(pose, points[rows])
    uv = photo.camera.project(in_camera)
    shown = _within(uv, window)
    rows, uv, z_m = rows[shown], uv[shown], in_camera[shown, 2]
    depth_m = depth_along_m(rays, photo.camera.directions[window], pose)
    column, row = (np.rint(uv).astype(int) - [window[1].start, window[0].start]).T
    solid = cv2.erode(photo.visible[window].astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8))
    nearest_m = np.where(depth_m > 0, depth_m, np.inf)[row, column]
    shown = (solid[row, column] > 0) & (z_m < nearest_m + BEHIND_M / cosine[rows])
    rows, uv = rows[shown], uv[shown]
    if not len(rows):
        return None
    turned = normals[rows] @ (photo.scene_from_camera[:3, :3] @ pose[:3, :3]).T
    weights = ((cosine[rows] / distance[rows]) ** FAVOUR).astype(np.float32)
    return _Sight(photo.scene, rows, _sampled(photo.color, uv), weights, harmonics(turned))


def _within(uv: Pixels, window: tuple[slice, slice]) -> Bool[np.ndarray, " n"]:
    rows, columns = window
    u, v = np.nan_to_num(uv, nan=-1.0).T
    found: Bool[np.ndarray, " n"] = (
        (u >= columns.start) & (u <= columns.stop - 1) & (v >= rows.start) & (v <= rows.stop - 1)
    )
    return found


MOST_SAMPLED = 30_000
"""OpenCV's remap takes maps of fewer than 32,768 rows."""


def _sampled(image: ColorImage, uv: Pixels) -> Float32[np.ndarray, "n 3"]:
    """Colours at positions between pixels."""
    parts = [
        cv2.remap(
            image, part[:, None, 0], part[:, None, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        for part in np.array_split(uv.astype(np.float32), -(-len(uv) // MOST_SAMPLED))
    ]
    return np.concatenate(parts)[:, 0].astype(np.float32)

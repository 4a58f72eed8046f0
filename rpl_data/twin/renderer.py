"""Exact images of a scene of a twin: colour, depth, which thing every pixel shows.

Rays by `rpl_data.raycast`, shading in numpy: texture, a lamp with a soft shadow, light from the room,
a highlight. Colour is anti-aliased where surfaces end; depth and masks are those of the pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from rpl_data.geometry import Transform, invert, project, transform
from rpl_data.raycast import Hits, RayScene, pixel_rays, rays_in_object
from rpl_data.twin.scene import TwinScene
from rpl_data.types import ColorImage, DepthImage, Intrinsics

GAMMA = 2.2
TO_LINEAR = (np.arange(256, dtype=np.float32) / 255) ** np.float32(GAMMA)
FROM_LINEAR = np.round(255 * (np.arange(4096) / 4095) ** (1 / GAMMA)).astype(np.uint8)
SKIN_M = 5e-4
"""Shadow rays start this far above the surface, so that it does not shadow itself."""


@dataclass(frozen=True)
class Rendered:
    """What the camera would see if it were perfect.

    Attributes:
        depth_m: along the optical axis; 0 where there is nothing.
        thing: number of the surface in `TwinScene.surfaces`; -1 = nothing. The objects come first.
        cos_incidence: cosine of the angle between the ray and the surface's normal; 0 = grazing.
        albedo: share of the light the surface throws back, mean of the colours; linear, 0 to 1.
        shininess: 0 (paper) to 1 (polished metal).
    """

    color: ColorImage
    depth_m: DepthImage
    thing: Int64[np.ndarray, "height width"]
    cos_incidence: Float32[np.ndarray, "height width"]
    albedo: Float32[np.ndarray, "height width"]
    shininess: Float32[np.ndarray, "height width"]


@dataclass(frozen=True)
class _Shaded:
    """Colour (linear light) and geometry of some rays."""

    linear: Float32[np.ndarray, "n 3"]
    hits: Hits
    cos_incidence: Float32[np.ndarray, " n"]
    albedo: Float32[np.ndarray, " n"]
    shininess: Float32[np.ndarray, " n"]


class Renderer:
    """A scene prepared for rays; the camera changes from call to call."""

    def __init__(self, scene: TwinScene, intrinsics: Intrinsics) -> None:
        self.intrinsics = intrinsics
        self._surfaces = scene.surfaces
        self._light = scene.light
        self._rays = RayScene([surface.mesh for surface in scene.surfaces])
        self._alone = [RayScene([surface.mesh]) for surface in scene.surfaces[: len(scene.table_from_object)]]
        self._linear_textures = [TO_LINEAR[surface.texture] for surface in scene.surfaces]
        size = {"width": intrinsics.width, "height": intrinsics.height}
        self._directions = pixel_rays(intrinsics, left_px=0, top_px=0, **size)

    def render(self, table_from_camera: Transform, *, rng: np.random.Generator) -> Rendered:
        """The image from there; `rng` only places the samples of shadow and anti-aliasing."""
        shape = self._directions.shape[:2]
        shaded = self._shade(self._directions, table_from_camera, rng, shape)
        thing = shaded.hits.mesh_id.reshape(shape)
        depth_m = np.where(np.isfinite(shaded.hits.t), shaded.hits.t, np.float32(0)).reshape(shape)
        linear = shaded.linear.reshape(*shape, 3)
        edges = _edges(thing, shaded.hits.normals.reshape(*shape, 3), depth_m)
        self._smooth(linear, edges, table_from_camera, rng)
        color = FROM_LINEAR[(linear * 4095).clip(0, 4095).astype(np.int32)]
        return Rendered(
            color,
            depth_m.astype(np.float32),
            thing,
            shaded.cos_incidence.reshape(shape),
            shaded.albedo.reshape(shape),
            shaded.shininess.reshape(shape),
        )

    def full_mask(self, object_number: int, table_from_camera: Transform) -> Bool[np.ndarray, "height width"]:
        """Pixels whose centre ray meets the object when nothing else is there."""
        mask = np.zeros(self._directions.shape[:2], dtype=bool)
        vertices = transform(invert(table_from_camera), self._surfaces[object_number].vertices)
        uv = project(self.intrinsics, vertices)
        if not np.isfinite(uv).any():
            return mask
        left, top = np.floor(np.nanmin(uv, axis=0) - 1).clip(0).astype(int)
        right, bottom = np.ceil(np.nanmax(uv, axis=0) + 2).clip(0).astype(int)
        part = self._directions[top:bottom, left:right]
        if part.size:
            t = self._alone[object_number].cast_t(rays_in_object(part, invert(table_from_camera)))
            mask[top:bottom, left:right] = np.isfinite(t).reshape(part.shape[:2])
        return mask

    def sees(
        self, points_table: Float64[np.ndarray, "n 3"], table_from_camera: Transform, *, tolerance_m: float
    ) -> Bool[np.ndarray, " n"]:
        """Which points nothing hides: no surface is more than `tolerance_m` in front of them."""
        origin = table_from_camera[:3, 3]
        to_point = points_table - origin
        length = np.linalg.norm(to_point, axis=1, keepdims=True)
        # Stretched so that every ray has come to within the tolerance of its point at t = 1.
        rays = np.hstack([np.broadcast_to(origin, to_point.shape), to_point * (1 - tolerance_m / length)])
        return ~self._rays.occluded(rays.astype(np.float32), far=1.0)

    # Shading --------------------------------------------------------------------------------------

    def _shade(
        self,
        directions_camera: Float64[np.ndarray, "*shape 3"],
        table_from_camera: Transform,
        rng: np.random.Generator,
        image_shape: tuple[int, int] | None,
    ) -> _Shaded:
        """Light along rays; `image_shape` where they are a whole image (shadows are then smoothed)."""
        rays = rays_in_object(directions_camera, invert(table_from_camera))
        hits = self._rays.cast(rays)
        albedo, normals, gloss = self._surface_at(hits)
        view = -rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
        points = rays[:, :3] + np.where(np.isfinite(hits.t), hits.t, 0)[:, None] * rays[:, 3:]
        cos_incidence = np.abs(np.einsum("nk,nk->n", hits.normals, view))
        lit, highlight = self._lamp(points, hits, normals, view, rng, image_shape)
        sky = self._light.ambient * (0.75 + 0.25 * normals[:, 2])
        color = self._light.color.astype(np.float32)
        linear = albedo * (sky[:, None] + lit[:, None] * color) + (gloss * highlight)[:, None] * color
        return _Shaded(
            linear.astype(np.float32), hits, cos_incidence.astype(np.float32), albedo.mean(axis=1), gloss
        )

    def _surface_at(
        self, hits: Hits
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
        """Albedo, shading normal and gloss where rays met surfaces."""
        albedo = np.zeros((len(hits.t), 3), np.float32)
        normals = np.zeros((len(hits.t), 3), np.float32)
        normals[:, 2] = 1
        gloss = np.zeros(len(hits.t), np.float32)
        for number, surface in enumerate(self._surfaces):
            here = np.flatnonzero(hits.mesh_id == number)
            if len(here):
                weights = np.column_stack([1 - hits.uv[here].sum(axis=1), hits.uv[here]])
                corners = hits.triangle_id[here]
                uv = np.einsum("nc,nck->nk", weights, surface.corner_uv[corners])
                albedo[here] = _sample(self._linear_textures[number], uv)
                smooth = np.einsum("nc,nck->nk", weights, surface.corner_normals[corners])
                normals[here] = smooth / np.linalg.norm(smooth, axis=1, keepdims=True)
                gloss[here] = surface.gloss[corners]
        return albedo, normals, gloss

    def _lamp(
        self,
        points: Float32[np.ndarray, "n 3"],
        hits: Hits,
        normals: Float32[np.ndarray, "n 3"],
        view: Float32[np.ndarray, "n 3"],
        rng: np.random.Generator,
        image_shape: tuple[int, int] | None,
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Diffuse light and highlight (Blinn, SIGGRAPH 1977) of the lamp, shadow included."""
        light = self._light
        to_lamp = light.position_m.astype(np.float32) - points
        distance = np.linalg.norm(to_lamp, axis=1)
        to_lamp /= distance[:, None]
        facing = np.einsum("nk,nk->n", normals, to_lamp).clip(0)
        facing[hits.mesh_id < 0] = 0
        reference_m = np.float32(np.linalg.norm(light.position_m))
        falloff = np.float32(light.strength) * np.square(reference_m / distance)
        shadow = self._shadow(points, hits, facing > 0, rng)
        if image_shape is not None:
            shadow = _smoothed_shadow(
                shadow.reshape(image_shape), np.where(facing > 0, hits.mesh_id, -1).reshape(image_shape)
            )
        half = to_lamp + view
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        shine = np.einsum("nk,nk->n", normals, half).clip(0)
        for _ in range(5):  # to the 32nd power
            shine = shine * shine
        return facing * falloff * shadow, shine * falloff * shadow * (facing > 0)

    def _shadow(
        self,
        points: Float32[np.ndarray, "n 3"],
        hits: Hits,
        turned: Bool[np.ndarray, " n"],
        rng: np.random.Generator,
    ) -> Float32[np.ndarray, " n"]:
        """1 where one random point of the lamp is seen, 0 where not."""
        shadow = np.zeros(len(points), np.float32)
        where = np.flatnonzero(turned)
        offset = rng.standard_normal((len(where), 3), dtype=np.float32)
        offset *= np.float32(self._light.radius_m) / np.linalg.norm(offset, axis=1, keepdims=True)
        lamp = self._light.position_m.astype(np.float32) + offset
        start = points[where] + np.float32(SKIN_M) * hits.normals[where]
        shadow[where] = ~self._rays.occluded(np.hstack([start, lamp - start]), far=1.0)
        return shadow

    def _smooth(
        self,
        linear: Float32[np.ndarray, "height width 3"],
        edges: Bool[np.ndarray, "height width"],
        table_from_camera: Transform,
        rng: np.random.Generator,
    ) -> None:
        """Replace the colour of edge pixels by the mean over four rays through each, in place."""
        rows, columns = np.nonzero(edges)
        if not len(rows):
            return
        total = np.zeros((len(rows), 3), np.float32)
        for du, dv in ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)):
            directions = self._directions[rows, columns].copy()
            directions[:, 0] += du / self.intrinsics.fx
            directions[:, 1] += dv / self.intrinsics.fy
            total += self._shade(directions, table_from_camera, rng, None).linear.clip(0, 1)
        linear[rows, columns] = total / 4


def _sample(
    texture: Float32[np.ndarray, "h w 3"], uv: Float32[np.ndarray, "n 2"]
) -> Float32[np.ndarray, "n 3"]:
    """The texture at positions, bilinear."""
    height, width = texture.shape[:2]
    x = (uv[:, 0] * width - 0.5).clip(0, width - 1).astype(np.float32)
    y = (uv[:, 1] * height - 0.5).clip(0, height - 1).astype(np.float32)
    rows = -(-len(x) // 1024)  # cv2.remap wants an image, no side of it over 32,767
    x, y = (np.resize(axis, (rows, 1024)) for axis in (x, y))
    picked = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    sampled: Float32[np.ndarray, "n 3"] = picked.reshape(-1, 3)[: len(uv)]
    return sampled


def _smoothed_shadow(
    shadow: Float32[np.ndarray, "height width"],
    group: Int64[np.ndarray, "height width"],
    *,
    width_px: int = 7,
) -> Float32[np.ndarray, " n"]:
    """The mean of the samples around each pixel, over pixels of the same group only."""
    smooth = np.zeros_like(shadow)
    for number in np.unique(group[group >= 0]):
        rows, columns = np.nonzero(group == number)
        part = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        mask = (group[part] == number).astype(np.float32)
        total = cv2.blur(shadow[part] * mask, (width_px, width_px))
        weight = cv2.blur(mask, (width_px, width_px))
        np.divide(total, weight, out=smooth[part], where=mask > 0)
    return smooth.ravel()


def _edges(
    thing: Int64[np.ndarray, "height width"],
    normals: Float32[np.ndarray, "height width 3"],
    depth_m: Float32[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Pixels beside another surface, another face or another distance; both sides of the edge."""
    edges = np.zeros(thing.shape, dtype=bool)
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        bend = np.einsum("hwk,hwk->hw", normals[here], normals[there]) < 0.9
        step = np.abs(depth_m[here] - depth_m[there]) > 0.02 * depth_m[here] + 0.005
        change = (thing[here] != thing[there]) | bend | step
        edges[here] |= change
        edges[there] |= change
    return edges

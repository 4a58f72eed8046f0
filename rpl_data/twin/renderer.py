"""Render exact images of a scene of a twin: colour, depth, and which surface each pixel shows.

Rays are cast by `rpl_data.raycast`, shading is done in numpy. Colour is anti-aliased where surfaces end;
depth and masks are those of the pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from rpl_data.geometry import Transform, invert, project, transform
from rpl_data.raycast import Hits, RayScene, pixel_rays, rays_in_object
from rpl_data.twin.edges import CORNERS, find_edges, of_neighbours
from rpl_data.twin.light import TO_LINEAR, shaded, to_srgb
from rpl_data.twin.picture import Picture
from rpl_data.twin.scene import TwinScene
from rpl_data.twin.shadows import tile_means, tiled
from rpl_data.types import ColorImage, DepthImage, Intrinsics

SKIN_M = 5e-4
"""Shadow rays start this far above the surface, so that it does not shadow itself."""
NEAR_M = 0.2
"""Things nearer than this block the light of the room."""


@dataclass(frozen=True)
class Rendered:
    """The image that a perfect camera would record.

    Attributes:
        depth_m: depth along the optical axis; 0 where there is nothing.
        thing: number of the surface in `TwinScene.surfaces`; -1 = nothing. Objects come first.
        cos_incidence: cosine of the angle between the ray and the surface's normal; 0 = grazing.
        albedo: share of the light that the surface reflects, mean of the colours; linear, 0 to 1.
        shininess: 0 (paper) to 1 (polished metal).
    """

    color: ColorImage
    depth_m: DepthImage
    thing: Int64[np.ndarray, "height width"]
    cos_incidence: Float32[np.ndarray, "height width"]
    albedo: Float32[np.ndarray, "height width"]
    shininess: Float32[np.ndarray, "height width"]


@dataclass(frozen=True)
class _RayHits:
    """The surface points that some rays met, before lighting.

    Attributes:
        view: unit vectors to the camera.
    """

    hits: Hits
    points: Float32[np.ndarray, "n 3"]
    view: Float32[np.ndarray, "n 3"]
    albedo: Float32[np.ndarray, "n 3"]
    normals: Float32[np.ndarray, "n 3"]
    gloss: Float32[np.ndarray, " n"]
    cos_incidence: Float32[np.ndarray, " n"]


class Renderer:
    """A scene prepared for ray casting; the camera is given with each call."""

    def __init__(self, scene: TwinScene, intrinsics: Intrinsics) -> None:
        self.intrinsics = intrinsics
        self._surfaces = scene.surfaces
        self._light = scene.light
        self._rays = RayScene([surface.mesh for surface in scene.surfaces], threads=1)
        objects = scene.surfaces[: len(scene.table_from_object)]
        self._alone = [RayScene([surface.mesh], threads=1) for surface in objects]
        self._pictures = [Picture.of(surface) for surface in scene.surfaces]
        size = {"width": intrinsics.width, "height": intrinsics.height}
        directions = pixel_rays(intrinsics, left_px=0, top_px=0, **size)
        self._directions = directions.astype(np.float32)

    def render(self, table_from_camera: Transform) -> Rendered:
        """Render the image of a camera at this pose."""
        shape = self._directions.shape[:2]
        seen = self._look(self._directions, table_from_camera)
        unhidden = self._unhidden(seen, shape)
        linear = self._shaded(seen, unhidden.reshape(-1, 2)).reshape(*shape, 3)
        thing = seen.hits.mesh_id.reshape(shape)
        depth_m = np.where(np.isfinite(seen.hits.t), seen.hits.t, np.float32(0)).reshape(shape)
        edges = find_edges(thing, seen.hits.normals.reshape(*shape, 3), depth_m)
        self._smooth_edges(linear, edges, thing, unhidden, table_from_camera)
        return Rendered(
            to_srgb(linear),
            depth_m.astype(np.float32),
            thing,
            seen.cos_incidence.reshape(shape),
            seen.albedo.mean(axis=1).reshape(shape),
            seen.gloss.reshape(shape),
        )

    def full_mask(self, object_number: int, table_from_camera: Transform) -> Bool[np.ndarray, "height width"]:
        """Pixels whose centre ray would meet the object if nothing else were there."""
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
        """Which points are not hidden: no surface is more than `tolerance_m` in front of them."""
        origin = table_from_camera[:3, 3]
        to_point = points_table - origin
        length = np.linalg.norm(to_point, axis=1, keepdims=True)
        # Rays are stretched so that each is within the tolerance of its point at t = 1.
        rays = np.hstack([np.broadcast_to(origin, to_point.shape), to_point * (1 - tolerance_m / length)])
        return ~self._rays.occluded(rays.astype(np.float32), far=1.0)

    # What rays meet ---------------------------------------------------------------------------------

    def _look(
        self, directions_camera: Float32[np.ndarray, "*shape 3"], table_from_camera: Transform
    ) -> _RayHits:
        rays = rays_in_object(directions_camera, invert(table_from_camera))
        hits = self._rays.cast(rays)
        distance = np.where(np.isfinite(hits.t), hits.t, np.float32(0))
        points = rays[:, :3] + distance[:, None] * rays[:, 3:]
        view = rays[:, 3:] * (-1 / np.sqrt(np.einsum("nk,nk->n", rays[:, 3:], rays[:, 3:])))[:, None]
        cos = np.abs(np.einsum("nk,nk->n", hits.normals, view))
        footprint_m = distance / np.float32(self.intrinsics.fx) / np.sqrt(cos.clip(0.05))
        return _RayHits(hits, points, view, *self._materials(hits, footprint_m), cos)

    def _materials(
        self, hits: Hits, footprint_m: Float32[np.ndarray, " n"]
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
        """Albedo, shading normal and gloss where rays met surfaces."""
        albedo = np.zeros((len(hits.t), 3), np.float32)
        normals = np.zeros((len(hits.t), 3), np.float32)
        normals[:, 2] = 1
        gloss = np.zeros(len(hits.t), np.float32)
        order = np.argsort(hits.mesh_id.astype(np.int16), kind="stable")  # surface by surface
        bounds = np.searchsorted(hits.mesh_id[order], np.arange(len(self._surfaces) + 1))
        for number, surface in enumerate(self._surfaces):
            here = order[bounds[number] : bounds[number + 1]]
            if len(here):
                weights = np.column_stack([1 - hits.uv[here].sum(axis=1), hits.uv[here]])
                corners = hits.triangle_id[here]
                uv = np.einsum("nc,nck->nk", weights, surface.corner_uv[corners])
                picture = self._pictures[number]
                albedo[here] = TO_LINEAR[picture.at(uv, footprint_m[here] * picture.texels_per_m[corners])]
                smooth = np.einsum("nc,nck->nk", weights, surface.corner_normals[corners])
                normals[here] = smooth / np.linalg.norm(smooth, axis=1, keepdims=True)
                gloss[here] = surface.gloss[corners]
        return albedo, normals, gloss

    def _shaded(self, seen: _RayHits, unhidden: Float32[np.ndarray, "n 2"]) -> Float32[np.ndarray, "n 3"]:
        return shaded(
            self._light,
            albedo=seen.albedo,
            gloss=seen.gloss,
            points=seen.points,
            normals=seen.normals,
            view=seen.view,
            lamp_seen=unhidden[:, 0],
            room_seen=unhidden[:, 1],
        )

    # Shadows ----------------------------------------------------------------------------------------

    def _unhidden(self, seen: _RayHits, shape: tuple[int, int]) -> Float32[np.ndarray, "height width 2"]:
        """Share of the lamp and of the room that each pixel sees.

        Pixels alternate as on a chessboard: one tests the lamp, the next the room.
        """
        sample, asks_lamp = tiled(shape)
        hits, met = seen.hits, seen.hits.mesh_id >= 0
        outward = hits.normals * np.sign(np.einsum("nk,nk->n", hits.normals, seen.view))[:, None]
        start = seen.points + np.float32(SKIN_M) * outward
        reach = np.float32(NEAR_M) * (outward + sample)  # Lambert's cosine
        lamp = self._light.position_m.astype(np.float32) + np.float32(self._light.radius_m) * sample
        reach[asks_lamp] = (lamp - start)[asks_lamp]
        free = np.zeros(len(met), np.float32)
        free[met] = ~self._rays.occluded(np.hstack([start, reach])[met], far=1.0)
        asked = np.column_stack([asks_lamp, ~asks_lamp]).astype(np.float32)
        return tile_means(free, asked, hits.mesh_id.reshape(shape))

    # Edges ------------------------------------------------------------------------------------------

    def _smooth_edges(
        self,
        linear: Float32[np.ndarray, "height width 3"],
        edges: Bool[np.ndarray, "height width"],
        thing: Int64[np.ndarray, "height width"],
        unhidden: Float32[np.ndarray, "height width 2"],
        table_from_camera: Transform,
    ) -> None:
        """Replace the colour of edge pixels in `linear` by the mean over four rays through each."""
        rows, columns = np.nonzero(edges)
        if not len(rows):
            return
        offsets = np.array(CORNERS, np.float32) / [self.intrinsics.fx, self.intrinsics.fy]
        directions = np.repeat(self._directions[rows, columns][None], len(CORNERS), axis=0)
        directions[..., :2] += offsets[:, None].astype(np.float32)
        seen = self._look(directions, table_from_camera)
        near = np.stack(
            [
                of_neighbours(thing, unhidden, rows, columns, part)
                for part in seen.hits.mesh_id.reshape(len(CORNERS), -1)
            ]
        )
        light = self._shaded(seen, near.reshape(-1, 2)).clip(0, 1)
        linear[rows, columns] = light.reshape(len(CORNERS), -1, 3).mean(axis=0)

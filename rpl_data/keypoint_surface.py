"""Whether a keypoint is seen: the surface around it, of which a share must face the camera unhidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.directions import spread_directions
from rpl_data.geometry import Points, Transform, invert
from rpl_data.raycast import RayScene

AROUND_M = 0.004
"""A keypoint is judged by the surface within this distance of it, since clicks and meshes are off by
millimetres. Where the mesh is farther off, it lacks the part that the keypoint is on."""

DIRECTIONS = 40
"""Points of that surface tested per keypoint."""

ENTERED_M = 0.005
"""A ray may hit the mesh up to this far in front of a surface point that still counts as seen."""

LEAST_SEEN_SHARE = 0.05
OF_ONE_FACE = 0.125
"""A keypoint is seen when this part of one of the faces that meet there is seen, and at least that share
of all the surface around it. At a corner two of three faces may turn away; on a round object the surface
around a keypoint is one face, of which a rim is still seen when the keypoint has turned away."""


@dataclass(frozen=True)
class KeypointSurface:
    """Points on the surface of an object around each of its keypoints, in the object frame.

    Attributes:
        points, normals: the points, and their unit normals, which point out of the object. Where the mesh
            lacks the keypoint's part, the keypoint itself, and a normal of 0.
        keypoint: number of the keypoint that each point belongs to.
        least: for every keypoint, the share of its points that must be seen.
    """

    points: Points
    normals: Points
    keypoint: Int64[np.ndarray, " n"]
    least: Float64[np.ndarray, " k"]

    @staticmethod
    def around(rays: RayScene, points_object: Float64[np.ndarray, "k 3"]) -> KeypointSurface:
        """Project a small sphere around each known keypoint onto the mesh."""
        known = np.flatnonzero(np.isfinite(points_object).all(axis=1))
        keypoints = points_object[known]
        lacking = np.linalg.norm(rays.closest(keypoints).points - keypoints, axis=1) > AROUND_M
        closest = rays.closest((keypoints[:, None] + AROUND_M * spread_directions(DIRECTIONS)).reshape(-1, 3))
        points = closest.points.reshape(-1, DIRECTIONS, 3)
        normals = closest.normals.reshape(-1, DIRECTIONS, 3).astype(np.float64)
        points[lacking], normals[lacking] = keypoints[lacking, None], 0.0
        # Of m faces at right angles to one another the mean normal has the squared length 1 / m.
        one_face = (normals.mean(axis=1) ** 2).sum(axis=1)
        least = np.full(len(points_object), LEAST_SEEN_SHARE)
        least[known] = np.maximum(LEAST_SEEN_SHARE, OF_ONE_FACE * one_face)
        return KeypointSurface(
            points.reshape(-1, 3), normals.reshape(-1, 3), np.repeat(known, DIRECTIONS), least
        )

    def faces(self, rays: RayScene, camera_from_object: Transform) -> Bool[np.ndarray, " k"]:
        """Find the keypoints that the object itself does not hide: the surface around them is seen."""
        eye = invert(camera_from_object)[:3, 3]
        towards = self.points - eye
        # The others need no ray: they turn away.
        turned_here = np.flatnonzero(np.einsum("nd,nd->n", self.normals, towards) <= 0)
        towards = towards[turned_here]
        far_m = np.sqrt(np.einsum("nd,nd->n", towards, towards))
        ray = np.empty((len(towards), 6), np.float32)
        ray[:, :3], ray[:, 3:] = eye, towards / far_m[:, None]
        seen = turned_here[rays.cast_t(ray) >= far_m - ENTERED_M]
        count = np.bincount(self.keypoint[seen], minlength=len(self.least))
        return np.asarray(count >= self.least * DIRECTIONS)

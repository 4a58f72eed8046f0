"""One object of a scene in one frame, as if nothing hid it: its depth, mask and projected keypoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import Pixels, Points, Transform, inside_image, invert, transform
from rpl_data.keypoint_surface import KeypointSurface
from rpl_data.label.masks import MaskPatch, cleaned
from rpl_data.label.occlusion import FAR_M, DepthPatch
from rpl_data.label.splat import splat
from rpl_data.raycast import PixelTable, RayScene, depth_along_m
from rpl_data.types import KeypointModel, Mesh, PointCloud, Trajectory, Window

MARGIN_PX = 3
"""Margin around the projected region, for filters that look at neighbouring pixels."""

Draw = Callable[[PixelTable, Window, Transform], tuple[DepthPatch, MaskPatch]]
"""Draws an object, given `camera_from_object`, in a window of the image: its depth (FAR_M where it is not)
and its mask."""


@dataclass(frozen=True)
class SceneObject:
    """An object and its pose in one scene.

    Attributes:
        model: the sparse model.
        covariance: One 3x3 covariance per keypoint, in m^2, in the object frame. It is that of the
            keypoint's position in the scene (shape and pose together); NaN where never clicked.
        mesh: the dense model, in the object frame.
        dots: its points; where they are given, the mask is made of them, as in the paper, not of the mesh.
        strayed_m: how far the camera's poses stray within the scene, standard deviation per axis, besides
            that covariance.
        path: the camera's poses in the object's own frame, where the object is moved in the scene; then
            `scene_from_object` is the identity. None where it stands still.
        instance: which of several instances of the object in the scene it is, as `InstanceLabel.instance`.
    """

    model: KeypointModel
    covariance: Float64[np.ndarray, "k 3 3"]
    mesh: Mesh
    scene_from_object: Transform
    dots: PointCloud | None = None
    strayed_m: float = 0.0
    instance: str = ""
    path: Trajectory | None = None

    def camera_from_object(self, trajectory: Trajectory, frame: int) -> Transform:
        """Its pose in a frame, by the camera's path in the scene, or by its own; DataError without a pose."""
        if self.path is not None:
            return invert(self.path.at(frame))
        by_path: Transform = invert(trajectory.at(frame)) @ self.scene_from_object
        return by_path

    @property
    def key(self) -> tuple[str, str]:
        """Name of the object and of the instance, which no other body of the scene shares."""
        return self.model.name, self.instance


@dataclass(frozen=True)
class Body:
    """An object prepared for drawing.

    Attributes:
        draw: how its depth and mask are drawn.
        rays: its mesh.
        hull: vertices of its convex hull, in the object frame.
        around: its surface around the keypoints.
    """

    item: SceneObject
    draw: Draw
    rays: RayScene
    hull: Points
    around: KeypointSurface

    @staticmethod
    def of(item: SceneObject) -> Body:
        """Prepare an object."""
        from scipy.spatial import ConvexHull

        rays = RayScene([item.mesh], threads=1)
        corners = ConvexHull(item.mesh.vertices, qhull_options="QJ").vertices  # QJ: flat meshes too
        around = KeypointSurface.around(rays, item.model.points_object)
        draw = cast(item.mesh, rays) if item.dots is None else splat(item.dots.points)
        return Body(item, draw, rays, item.mesh.vertices[corners], around)


def cast(mesh: Mesh, rays: RayScene) -> Draw:
    """Draw a mesh: its triangles one by one or, where the lens bends their edges, by ray casting."""
    from rpl_data.label.compiled_raster import DrawnMesh, drawn_depth_m

    drawn = DrawnMesh.of(mesh)

    def draw(
        camera: PixelTable, window: Window, camera_from_object: Transform
    ) -> tuple[DepthPatch, MaskPatch]:
        depth_m = None
        if not camera.intrinsics.distortion:
            depth_m = drawn_depth_m(drawn, camera.intrinsics, camera_from_object, window, nothing_m=FAR_M)
        if depth_m is None:
            depth_m = depth_along_m(rays, camera.directions[window], camera_from_object)
            depth_m[depth_m == 0] = FAR_M
        # Pin-holes of a fused mesh are closed; the hole of a handle is wider and stays.
        return depth_m, cleaned(depth_m < FAR_M, "close", size_px=3)

    return draw


@dataclass(frozen=True)
class ObjectAlone:
    """One object rendered without occluders, in the window of the image that holds it.

    Attributes:
        window: rows and columns of the image.
        depth_m: depth of the mesh in the window; FAR_M where the mesh is not.
        mask: pixels of the window that the object covers.
    """

    body: Body
    camera_from_object: Transform
    keypoints_px: Pixels
    window: Window
    depth_m: DepthPatch
    mask: MaskPatch


def object_alone(camera: PixelTable, body: Body, camera_from_object: Transform) -> ObjectAlone | None:
    """Render one object without occluders; None when it covers no pixel.

    Its depth, mask and projected keypoints are computed in the window of the image that holds it.
    """
    keypoints_px = camera.project(transform(camera_from_object, body.item.model.points_object))
    window = _window(camera, transform(camera_from_object, body.hull), keypoints_px)
    if window is None:
        return None
    depth_m, mask = body.draw(camera, window, camera_from_object)
    if not mask.any():
        return None
    return ObjectAlone(body, camera_from_object, keypoints_px, window, depth_m, mask)


def _window(
    camera: PixelTable, hull_camera: Points, keypoints_px: Float64[np.ndarray, "k 2"]
) -> Window | None:
    """Part of the image that holds the object, its keypoints and a margin; None when out of view."""
    window = camera.window(hull_camera)
    if window is None:
        return None
    shown = np.rint(keypoints_px[inside_image(camera.intrinsics, keypoints_px)]).astype(int)
    height, width = camera.intrinsics.height, camera.intrinsics.width
    return _widened(window[0], shown[:, 1], height), _widened(window[1], shown[:, 0], width)


def _widened(span: slice, numbers: Int64[np.ndarray, " n"], size: int) -> slice:
    """The span extended to those numbers and by the margin, limited to 0..size."""
    low = min(span.start, numbers.min(initial=size)) - MARGIN_PX
    high = max(span.stop, numbers.max(initial=-1) + 1) + MARGIN_PX
    return slice(max(int(low), 0), min(int(high), size))

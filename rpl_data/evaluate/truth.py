"""Make a truth workspace from true poses: projected keypoints and ray-cast silhouettes.

The poses come as JSON: `points_<object>` (one row per keypoint, metres, object frame; null where unknown),
`keypoints_<object>` (their names, by which they are matched; numbers from 0 where it is left out) and
`camera_from_<object>`: {scene: [one 4x4 matrix per frame, by `Frame.index`]}, with null for a frame whose
pose is unknown; further instances of the object in a scene are under `<scene>/2` and so on, as in clicks.
`mesh_<object>`: {file, metres_per_unit} is its mesh in the object frame, with the file relative to the JSON;
an object without one is assumed to be the bounding box of its points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from rpl_data.files import read_json
from rpl_data.geometry import (
    Pixels,
    Transform,
    box_around,
    inside_image,
    project,
    transform,
)
from rpl_data.label.instance import square_around
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.types import (
    DataError,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    Mesh,
    Rle,
    Scene,
    Solution,
)
from rpl_data.types.instances import instance_of, places_in, scene_of
from rpl_data.workspace.workspace import Workspace

HIDDEN_BEHIND_M = 0.004
"""A keypoint this far behind the surface is hidden; less is due to the mesh's inaccuracy."""


@dataclass(frozen=True)
class TrueObject:
    """An object with its true poses.

    Attributes:
        camera_from_object: poses by place (`types.instances`) and `Frame.index`.
    """

    model: KeypointModel
    mesh: Mesh
    camera_from_object: Mapping[tuple[str, int], Transform]


def truth_from_poses(workspace: Workspace, truth: Workspace, poses: Path) -> None:
    """Write models, meshes and labels of those scenes of `workspace` whose truth `poses` has.

    Raises:
        DataError: the file has no object, a matrix is not 4x4, or none of its scenes is in the workspace.
    """
    content = read_json(poses)
    objects = true_objects(content, source=str(poses), meshes=_meshes(content, poses))
    scenes = {scene_of(place) for one in objects for place, _ in one.camera_from_object}
    known = [name for name in workspace.video_names() if name in scenes]
    if not known:
        raise DataError(
            f"{poses} has poses for the scenes {sorted(scenes)}; the workspace has "
            f"{workspace.video_names()}; give them the same names"
        )
    for one in objects:
        count = len(one.model.keypoints)
        nowhere: Mapping[str, Transform] = {}
        truth.save_solution(Solution(one.model, np.zeros((count, 3, 3)), nowhere))
        save_mesh(truth.mesh_file(one.model.name), one.mesh)
    for name in known:
        truth.save_labels(name, true_labels(workspace.load_scene(name), objects))


def true_objects(
    content: Mapping[str, Any], *, source: str, meshes: Mapping[str, Mesh]
) -> tuple[TrueObject, ...]:
    """Read the objects of the JSON, in its order; keypoints without names are named by their number."""
    names = [key.removeprefix("points_") for key in content if key.startswith("points_")]
    if not names:
        raise DataError(f"{source} has no points_<object>; it has {', '.join(content) or 'nothing'}")
    objects = []
    for name in names:
        points = np.array(content[f"points_{name}"], dtype=float)
        keypoints = tuple(map(str, content.get(f"keypoints_{name}", range(len(points)))))
        if len(set(keypoints)) != len(points):
            raise DataError(
                f"{source}: keypoints_{name} should give {len(points)} different names, one per row of "
                f"points_{name}, found {', '.join(keypoints)}"
            )
        model = KeypointModel(name, keypoints, points)
        poses = {
            (scene, frame): _matrix(values, f"{source}: camera_from_{name}, scene {scene}, frame {frame}")
            for scene, rows in content.get(f"camera_from_{name}", {}).items()
            for frame, values in enumerate(rows)
            if values is not None
        }
        objects.append(TrueObject(model, meshes.get(name) or box_mesh(points), poses))
    return tuple(objects)


def _meshes(content: Mapping[str, Any], source: Path) -> dict[str, Mesh]:
    """Load the meshes that the JSON names, by object, in metres."""
    meshes = {}
    for key, entry in content.items():
        if key.startswith("mesh_"):
            mesh = load_mesh(source.parent / entry["file"])
            vertices = mesh.vertices * float(entry.get("metres_per_unit", 1.0))
            meshes[key.removeprefix("mesh_")] = replace(mesh, vertices=vertices)
    return meshes


def _matrix(values: Any, where: str) -> Transform:
    matrix = np.array(values, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise DataError(f"{where}: expected a 4x4 matrix of finite numbers, got shape {matrix.shape}")
    return matrix


def box_mesh(points: Float64[np.ndarray, "n 3"]) -> Mesh:
    """Make the twelve triangles of the points' bounding box, counter-clockwise seen from outside."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    corners = np.array([[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(corners, np.array(triangles, dtype=np.int64))


def true_labels(scene: Scene, objects: tuple[TrueObject, ...]) -> Iterator[FrameLabel]:
    """Make labels of every frame whose truth is known; an object is hidden only by itself."""
    shown = [
        (one, RayScene([one.mesh]), places_in(scene.name, {place for place, _ in one.camera_from_object}))
        for one in objects
    ]
    for frame in scene.frames:
        found = [
            (one, caster, one.camera_from_object[place, frame.index], instance_of(place))
            for one, caster, places in shown
            for place in places
            if (place, frame.index) in one.camera_from_object
        ]
        if found:
            instances = (true_instance(scene.intrinsics, *each) for each in found)
            seen = tuple(instance for instance in instances if instance is not None)
            yield FrameLabel(scene.name, frame.index, frame.timestamp_s, seen)


def true_instance(
    intrinsics: Intrinsics,
    one: TrueObject,
    caster: RayScene,
    camera_from_object: Transform,
    instance: str = "",
) -> InstanceLabel | None:
    """Make the label of one object at its true pose; None when it is not in the image."""
    points_camera = transform(camera_from_object, one.model.points_object)
    pixels = project(intrinsics, points_camera)
    surface = project(intrinsics, transform(camera_from_object, one.mesh.vertices))
    depth_m = _depth_image_m(intrinsics, caster, camera_from_object, surface)
    silhouette = depth_m > 0
    if not silhouette.any():
        return None
    rows, columns = np.nonzero(silhouette)
    box = box_around(np.column_stack([columns, rows]).astype(float))
    mask = _encode(silhouette)
    visibility = _visibility(intrinsics, depth_m, pixels, points_camera[:, 2])
    return InstanceLabel(
        object=one.model.name,
        camera_from_object=camera_from_object,
        keypoints_px=pixels,
        visibility=visibility,
        sigma_px=np.where(visibility > 0, 0.0, np.nan),
        square_box=square_around(pixels, box),
        box=box,
        box_full=box,
        mask=mask,
        mask_full=mask,
        visib_fract=1.0,
        truncated=not bool(inside_image(intrinsics, surface).all()),
        quality=1.0,
        instance=instance,
    )


def _depth_image_m(
    intrinsics: Intrinsics, caster: RayScene, camera_from_object: Transform, surface_px: Pixels
) -> Float32[np.ndarray, "height width"]:
    """Render the depth of the whole image; rays are cast only where the projected vertices reach."""
    width, height = intrinsics.width, intrinsics.height
    depth_m = np.zeros((height, width), dtype=np.float32)
    left, top, right, bottom = 0, 0, width, height
    if np.isfinite(surface_px).all():  # a vertex behind the camera has no pixel: cast everywhere
        low, high = np.floor(surface_px.min(axis=0)), np.ceil(surface_px.max(axis=0)) + 1
        left, top = (int(n) for n in np.clip(low, 0, [width, height]))
        right, bottom = (int(n) for n in np.clip(high, 0, [width, height]))
    if right > left and bottom > top:
        depth_m[top:bottom, left:right] = render_depth_m(
            caster,
            intrinsics,
            camera_from_object,
            left_px=left,
            top_px=top,
            width=right - left,
            height=bottom - top,
        )
    return depth_m


def _visibility(
    intrinsics: Intrinsics,
    depth_m: Float32[np.ndarray, "height width"],
    pixels: Pixels,
    keypoint_depth_m: Float64[np.ndarray, " k"],
) -> Int64[np.ndarray, " k"]:
    """COCO's v: seen unless every pixel around the keypoint shows a surface nearer than it."""
    inside = inside_image(intrinsics, pixels)
    visibility = np.where(inside, 2, 0).astype(np.int64)
    for k in np.flatnonzero(inside):
        u, v = np.round(pixels[k]).astype(int)
        around = depth_m[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
        if ((around > 0) & (around < keypoint_depth_m[k] - HIDDEN_BEHIND_M)).all():
            visibility[k] = 1
    return visibility


def _encode(mask: Bool[np.ndarray, "height width"]) -> Rle:
    from pycocotools import mask as coco_mask

    encoded = coco_mask.encode(np.asfortranarray(mask, dtype=np.uint8))
    return Rle(size=[int(n) for n in encoded["size"]], counts=encoded["counts"].decode("ascii"))

"""The frame that an object is exported in: the workspace's own, or a canonical one the recipe asks for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Points, Transform, invert, rigid, transform
from rpl_data.meshes import save_mesh
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.recipe import FrameChoice
from rpl_data.pipeline.supports import support_plane
from rpl_data.pipeline.symmetry import frame_change
from rpl_data.types import DataError, FrameLabel, KeypointModel
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace

ALIKE_DEG = 15.0
"""Scenes whose support planes differ by less show the object on the same side."""
SURFACE_M = 0.005
"""Points of a scene's surface are thinned to this distance before its support plane is sought."""


def export_frame(context: Context, name: str) -> Transform | None:
    """`frame_from_object` of an object for the exports; None where they use the object frame itself.

    Raises:
        DataError: the object lacks what its frame is made of: a mesh, a support plane, three keypoints.
    """
    choice: FrameChoice = context.recipe.export.frame
    if choice == "keypoints":
        return None
    model = context.workspace.load_placed(name).model
    if not isinstance(choice, str):
        return frame_of_keypoints(model, choice)
    axes = np.eye(3) if choice == "box" else _upright_axes(context, name)
    return boxed_frame(context.workspace.mesh(name).vertices, axes)


def boxed_frame(points_object: Points, axes: Float64[np.ndarray, "3 3"]) -> Transform:
    """Origin at the centre of the box around the points along these axes (rows, object frame)."""
    along = points_object @ axes.T
    return rigid(axes, -(along.min(axis=0) + along.max(axis=0)) / 2)


def frame_of_keypoints(model: KeypointModel, names: tuple[str, str, str]) -> Transform:
    """Origin at the first keypoint, x to the second, the third in the plane of x and y on the side of y.

    Raises:
        DataError: a keypoint is unknown or was never clicked, or the three lie on a line.
    """
    rows = []
    for name in names:
        if name not in model.keypoints or not model.known[model.keypoints.index(name)]:
            raise DataError(
                f"export: frame: object {model.name} has no keypoint {name!r} with a position; it has "
                f"{', '.join(np.array(model.keypoints)[model.known])}"
            )
        rows.append(model.points_object[model.keypoints.index(name)])
    origin, toward, aside = rows
    z = np.cross(toward - origin, aside - origin)
    if np.linalg.norm(z) < 1e-3 * np.linalg.norm(toward - origin):
        raise DataError(f"export: frame: keypoints {', '.join(names)} of {model.name} lie on a line")
    x, z = (vector / np.linalg.norm(vector) for vector in (toward - origin, z))
    axes = np.stack([x, np.cross(z, x), z])
    return rigid(axes, -axes @ origin)


def _upright_axes(context: Context, name: str) -> Float64[np.ndarray, "3 3"]:
    """Axes as rows: z up from the support planes, x along the longest extent across it."""
    up = common_direction(np.array(_support_normals(context, name)).reshape(-1, 3))
    if up is None:
        raise DataError(
            f"export: frame: up: no scene shows a plane that object {name} stands on; write `frame: box`, or "
            "three keypoints"
        )
    points = context.workspace.mesh(name).vertices
    across = points - np.outer(points @ up, up)
    x = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)[2][0]
    x -= up * (x @ up)
    x *= np.sign(x[np.abs(x).argmax()]) / np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _support_normals(context: Context, name: str) -> list[Float64[np.ndarray, "3"]]:
    """Upward normals of the planes that an object stands on, in the object frame, one per scene."""
    workspace, normals = context.workspace, []
    for place, pose in workspace.load_placed(name).scene_from_object.items():
        plane = support_plane(workspace, scene_of(place), voxel_m=SURFACE_M)
        if plane is not None:
            normals.append(pose[:3, :3].T @ plane.normal)
    return normals


def common_direction(normals: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"] | None:
    """Mean of the largest group of directions that agree within `ALIKE_DEG`; None without any.

    An object may lie on another side in some scenes; the side it shows most often is taken for its foot.
    """
    if not len(normals):
        return None
    alike = normals @ normals.T > np.cos(np.radians(ALIKE_DEG))
    mean = normals[alike[alike.sum(axis=1).argmax()]].mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def moved_model(model: KeypointModel, frame: Transform | None) -> KeypointModel:
    """Express keypoints in another frame."""
    return model if frame is None else replace(model, points_object=transform(frame, model.points_object))


def moved_label(label: FrameLabel, frames: dict[str, Transform]) -> FrameLabel:
    """Express the poses of a frame's labels in these frames; where they appear in the image stays."""
    return replace(
        label,
        instances=tuple(
            replace(one, camera_from_object=one.camera_from_object @ invert(frames[one.object]))
            if one.object in frames
            else one
            for one in label.instances
        ),
    )


def frames_for(context: Context, labels: Workspace) -> dict[str, Transform]:
    """`frame_from_object` of each object whose exports use another frame than `labels` is in.

    The truth has an object frame of its own; its export uses the same canonical frame as the labels'.
    """
    found = {}
    for name in context.object_names:
        frame = export_frame(context, name)
        if frame is not None and labels != context.workspace:
            own, other = context.workspace.load_placed(name).model, labels.load_placed(name).model
            frame = frame @ frame_change(own, other)
        if frame is not None:
            found[name] = frame
    return found


def exported_mesh(workspace: Workspace, labels: Workspace, name: str, frame: Transform | None) -> Path:
    """The mesh of an object in the frame of its exports, written into `workspace` where that is not its own.

    `labels` may be a truth that somebody else keeps; nothing is written there.
    """
    if frame is None:
        return labels.mesh_file(name)
    mesh = labels.mesh(name)
    moved = replace(mesh, vertices=transform(frame, mesh.vertices))
    save_mesh(workspace.exported_mesh_file(name), moved)
    return workspace.exported_mesh_file(name)

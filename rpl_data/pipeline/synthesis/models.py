"""Dense models of the training scenes alone, and the tables of these scenes.

The workspace's own models are made of all scenes; those here never read a file of any other scene.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from rpl_data.formats.datasets.coco import CocoObject
from rpl_data.geometry import transform
from rpl_data.meshes import load_mesh
from rpl_data.pipeline.context import Context, crop_of
from rpl_data.pipeline.register import object_named
from rpl_data.pipeline.stages.segment import depth_views, given_mesh
from rpl_data.pipeline.supports import support_plane
from rpl_data.synthesize.body import SAME_MODEL_M
from rpl_data.types import DataError, Mesh
from rpl_data.types.instances import places_in, scene_of
from rpl_data.workspace.workspace import Workspace

SURFACE_M = 0.01
"""Voxels to which a surface is thinned to find its table."""


def training_mesh(
    context: Context, item: CocoObject, videos: tuple[str, ...]
) -> tuple[Mesh, Bool[np.ndarray, " m"] | None]:
    """The dense model of an object in the export's frame, and which of its triangles depth images saw.

    None in their place for a carved model: its shape is that of its outlines.

    Args:
        videos: recordings that it is made of; there is something in them by `can_be_made`.

    Raises:
        DataError: the workspace was solved anew after the export.
    """
    from rpl_data.segment.segment import segment_object

    workspace, name = context.workspace, item.model.name
    solution = workspace.load_placed(name)
    _refuse_other_model(item, workspace)
    given = given_mesh(workspace, name)
    if given is not None:
        return _in_export_frame(given, item), np.ones(len(given.triangles), bool)
    places = training_places(context, name, videos)
    only = replace(solution, scene_from_object={place: solution.scene_from_object[place] for place in places})
    dense = segment_object(
        {place: load_mesh(_surface(workspace, place)) for place in places},
        only,
        voxel_m=context.recipe.reconstruct.voxel_m,
        crop_m=crop_of(workspace, object_named(context, name)),
        depth_views=[view for place in places for view in depth_views(workspace, place, only)],
    )
    return _in_export_frame(dense.mesh, item), None if dense.carved else dense.seen


def can_be_made(context: Context, name: str, videos: tuple[str, ...]) -> bool:
    """Whether an object stands still in one of these recordings, or its mesh was given."""
    return given_mesh(context.workspace, name) is not None or bool(training_places(context, name, videos))


def training_places(context: Context, name: str, videos: tuple[str, ...]) -> list[str]:
    """Where the object stands still in these recordings."""
    parts = context.workspace.parts()
    poses = context.workspace.load_placed(name).scene_from_object
    scenes = [scene for scene in context.placed_scenes() if parts.video_of(scene) in videos]
    places = [place for scene in scenes for place in places_in(scene, poses)]
    return [place for place in context.still_places(places) if _surface(context.workspace, place).exists()]


def _surface(workspace: Workspace, place: str) -> Path:
    return workspace.surface_file(scene_of(place))


def _in_export_frame(mesh: Mesh, item: CocoObject) -> Mesh:
    return mesh if item.frame is None else replace(mesh, vertices=transform(item.frame, mesh.vertices))


def _refuse_other_model(item: CocoObject, workspace: Workspace) -> None:
    """DataError where the workspace was solved anew after the export."""
    own = workspace.load_placed(item.model.name).model.points_object
    moved = own if item.frame is None else transform(item.frame, own)
    exported = item.model.points_object
    if moved.shape != exported.shape or not np.allclose(moved, exported, atol=SAME_MODEL_M, equal_nan=True):
        raise DataError(
            f"object {item.model.name}: its keypoints are not those of the export any more; run "
            f"`rpl export --workspace {workspace.root}` again"
        )


def scene_table(workspace: Workspace, scene: str) -> tuple[np.ndarray, float] | None:
    """What a scene's things stand on: the plane's upward normal and offset, scene frame; None = unknown."""
    plane = support_plane(workspace, scene, voxel_m=SURFACE_M)
    return None if plane is None else (plane.normal, plane.offset_m)

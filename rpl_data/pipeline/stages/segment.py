"""Stage `segment`: make the dense model of each object from the surfaces of its scenes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rpl_data.meshes import load_mesh, oriented_points, save_cloud, save_mesh
from rpl_data.pipeline.context import Context, crop_of, known_points, model_key, step
from rpl_data.pipeline.given_masks import mask_options, object_masks
from rpl_data.pipeline.ledger import Advance, Outcome, Step, stamps
from rpl_data.pipeline.placements import standing
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.types import DataError, Mesh, Solution, posed_frames, spread_evenly
from rpl_data.types.instances import places_in, scene_of
from rpl_data.workspace.workspace import Workspace

VIEWS_PER_SCENE = 8
"""Depth images per scene that show where space is free."""
MASKS_PER_SCENE = 12
"""Given masks per scene that vote on the surface."""
MOST_FALSE_AREA = 0.03
"""Share of a mesh's area in free space above which the user is warned."""
VERSION = 5
"""Increase it when the stage writes something else for the same input: its steps then run again."""

if TYPE_CHECKING:
    from rpl_data.segment.free_space import DepthView
    from rpl_data.segment.mask_votes import MaskView
    from rpl_data.segment.segment import DenseModel


def segment_steps(context: Context) -> list[Step]:
    """Plan the steps that make the dense models, one per object."""
    return [_segment_step(context, item) for item in context.objects]


def _segment_step(context: Context, item: ObjectRecipe) -> Step:
    workspace, parts, method = context.workspace, context.workspace.parts(), context.recipe.segment.method
    scene_from_object = workspace.load_solution(item.name).scene_from_object
    # What was registered follows the model, and never changes it: a wrong place would spoil it.
    outside = standing(workspace, item.name)
    places = [
        place
        for scene in context.still_places(context.placed_scenes())
        for place in places_in(scene, scene_from_object)
        if place not in outside
    ]
    scenes = list(dict.fromkeys(map(scene_of, places)))
    given = given_mesh(workspace, item.name)
    mask_choice, mask_files = mask_options(context, sorted({parts.video_of(scene) for scene in scenes}))
    run = (
        partial(_segmented, context, item, places, by_masks=bool(mask_choice))
        if given is None
        else lambda advance: _keep_given(workspace, item.name, given)
    )
    return step(
        "segment",
        item.name,
        run,
        version=VERSION,
        options={"voxel_m": context.recipe.reconstruct.voxel_m, "crop": crop_of(workspace, item)}
        | ({} if method == "convex" else {"method": method})
        | mask_choice,
        sources=mask_files if given is None else stamps(workspace.given_mesh_file(item.name)),
        after=[context.placed_by(item.name), *(f"surface/{name}" for name in scenes)],
        outputs=[workspace.mesh_file(item.name), workspace.cloud_file(item.name)],
    )


def _segmented(
    context: Context, item: ObjectRecipe, places: Sequence[str], advance: Advance, *, by_masks: bool
) -> Outcome:
    """Make the dense model of an object from its surface at these places, and keep it.

    Raises:
        DataError: there are no places, or no surface is found at the keypoints.
    """
    from rpl_data.segment import METHODS
    from rpl_data.segment.segment import segment_object

    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m
    if not places:
        raise DataError(
            f"object {item.name} was only filmed while it was moved, and single frames make no dense "
            "model: film it standing still, from all sides, in one more scene, and click it there"
        )
    solution = workspace.load_placed(item.name)
    surfaces = {place: load_mesh(workspace.surface_file(scene_of(place))) for place in places}
    views = [view for name in places for view in depth_views(workspace, name, solution)]
    method = context.recipe.segment.method
    segment = METHODS[method]
    if by_masks and method == "convex":
        masks = [view for name in places for view in mask_views(context, name, solution)]
        segment = partial(segment_object, mask_views=masks)
    dense = segment(surfaces, solution, voxel_m=voxel_m, crop_m=crop_of(workspace, item), depth_views=views)
    save_mesh(workspace.mesh_file(item.name), dense.mesh, seen=dense.seen)
    save_cloud(workspace.cloud_file(item.name), dense.cloud)
    lines = [*dense.warnings, *mesh_remarks(dense)]
    if by_masks and method != "convex":
        lines.append("given masks are not used by `segment: {method: smooth}`, which is the paper's")
    return Outcome(
        messages=tuple(f"{item.name}: {line}" for line in lines),
        details={
            "model": model_key(solution.model),
            "triangles": len(dense.mesh.triangles),
            "points": len(dense.cloud.points),
            "unseen_triangles": int((~dense.seen).sum()),
            "open_edges": dense.open_edges,
            "false_area": None if np.isnan(dense.free_share) else round(dense.free_share, 4),
        },
    )


def depth_views(workspace: Workspace, place: str, solution: Solution) -> list[DepthView]:
    """Read some depth images of a scene, spread over its steady frames, as views of an object."""
    from rpl_data.reconstruct.fused_frames import steady_frames
    from rpl_data.segment.free_space import view_of

    scene = workspace.load_scene(scene_of(place))
    trajectory, read = workspace.load_trajectory(scene), workspace.depth_reader(scene)
    pose = solution.scene_from_object[place]
    steady = steady_frames(scene, trajectory, centre_scene=pose[:3, 3])
    frames = [frame for frame in scene.frames if frame.index in steady and frame.depth is not None]
    return [
        view_of(place, scene.intrinsics, trajectory.at(frame.index), pose, read(frame))
        for frame in spread_evenly(frames, VIEWS_PER_SCENE)
    ]


def mask_views(context: Context, scene_name: str, solution: Solution) -> list[MaskView]:
    """Read some given masks of an object in a scene, with the depth images of their frames."""
    from rpl_data.segment.free_space import view_of
    from rpl_data.segment.mask_votes import MaskView

    workspace = context.workspace
    given = object_masks(context, workspace.parts().video_of(scene_name))
    name = solution.model.name
    if given is None or name not in given.keys:
        return []
    if len(places_in(scene_of(scene_name), solution.scene_from_object)) > 1:
        return []  # which of several instances a mask is of is not known
    scene = workspace.load_scene(scene_of(scene_name))
    trajectory, read = workspace.load_trajectory(scene), workspace.depth_reader(scene)
    pose = solution.scene_from_object[scene_name]
    posed = posed_frames(scene, trajectory, with_depth=True)
    frames = [frame for frame in posed if frame.index in given.masks.readers]
    found = []
    for frame in spread_evenly(frames, MASKS_PER_SCENE):
        mask = given.mask(name, frame.index, scene)
        view = view_of(scene_name, scene.intrinsics, trajectory.at(frame.index), pose, read(frame))
        if mask is not None:
            found.append(MaskView(frame.index, view, mask))
    return found


def mesh_remarks(dense: DenseModel) -> list[str]:
    """Lines that warn the user of faults of a mesh."""
    lines = []
    if dense.free_share > MOST_FALSE_AREA:
        lines.append(
            f"{dense.free_share:.0%} of the area of its mesh lies in space that the cameras saw through, so "
            "it is too large there; check the clicks and the trajectories, or crop the mesh"
        )
    if dense.open_edges:
        lines.append(f"its mesh is not watertight: {dense.open_edges} edges do not have two triangles each")
    return lines


def given_mesh(workspace: Workspace, object_name: str) -> Mesh | None:
    """The user's own mesh of an object with known keypoints, in the object frame; None where there is none.

    A mesh without known keypoints only serves to pick them; its pose in the object frame is not known yet.
    """
    annotation, path = workspace.load_annotation(object_name), workspace.given_mesh_file(object_name)
    if annotation.known_points is None or not path.exists():
        return None
    mesh = load_mesh(path)
    return Mesh(mesh.vertices - np.nanmean(known_points(annotation), axis=0), mesh.triangles, mesh.colors)


def _keep_given(workspace: Workspace, object_name: str, mesh: Mesh) -> Outcome:
    """Use the given mesh as the dense model, without segmentation."""
    cloud = oriented_points(mesh)
    save_mesh(workspace.mesh_file(object_name), mesh)
    save_cloud(workspace.cloud_file(object_name), cloud)
    message = f"{object_name}: its dense model is the given mesh"
    model = workspace.load_placed(object_name).model
    details = {"model": model_key(model), "triangles": len(mesh.triangles), "points": len(cloud.points)}
    return Outcome(messages=(message,), details=details)

"""Depth near the objects -> surfaces of the scenes and dense models of the objects."""

from __future__ import annotations

import numpy as np

from rpl_data.meshes import load_mesh, oriented_points, save_cloud, save_mesh
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step, stamps
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.pipeline.stages.solve import known_points
from rpl_data.types import Mesh
from rpl_data.workspace.workspace import Workspace

VERSION = 2
"""Raised when the stage writes something else for the same input; its steps then run again."""

Box3 = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner, metres."""


def segment_steps(context: Context) -> list[Step]:
    """Surfaces of the scenes -> the dense model, an object."""
    return [_segment_step(context, item) for item in context.objects]


def _segment_step(context: Context, item: ObjectRecipe) -> Step:
    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m
    places = workspace.load_solution(item.name).scene_from_object
    scenes = [name for name in context.placed_scenes() if name in places]
    crop, given = crop_of(workspace, item), given_mesh(workspace, item.name)

    def run(advance: Advance) -> Outcome:
        if given is not None:
            return _keep_given(workspace, item.name, given)
        from rpl_data.segment.segment import segment_object

        surfaces = {name: load_mesh(workspace.surface_file(name)) for name in scenes}
        dense = segment_object(surfaces, workspace.load_placed(item.name), voxel_m=voxel_m, crop_m=crop)
        save_mesh(workspace.mesh_file(item.name), dense.mesh)
        save_cloud(workspace.cloud_file(item.name), dense.cloud)
        return Outcome(
            messages=tuple(f"{item.name}: {line}" for line in dense.warnings),
            details={"triangles": len(dense.mesh.triangles), "points": len(dense.cloud.points)},
        )

    return step(
        "segment",
        item.name,
        run,
        version=VERSION,
        options={"voxel_m": voxel_m, "crop": crop},
        sources={} if given is None else stamps(workspace.given_mesh_file(item.name)),
        after=[context.placed_by(item.name), *(f"surface/{name}" for name in scenes)],
        outputs=[workspace.mesh_file(item.name), workspace.cloud_file(item.name)],
    )


def given_mesh(workspace: Workspace, object_name: str) -> Mesh | None:
    """The mesh a person has of an object with known keypoints, object frame; None where there is none.

    A mesh without known keypoints is only there to pick them on, and has no place in the object frame yet.
    """
    annotation, path = workspace.load_annotation(object_name), workspace.given_mesh_file(object_name)
    if annotation.known_points is None or not path.exists():
        return None
    mesh = load_mesh(path)
    return Mesh(mesh.vertices - np.nanmean(known_points(annotation), axis=0), mesh.triangles, mesh.colors)


def _keep_given(workspace: Workspace, object_name: str, mesh: Mesh) -> Outcome:
    """The given mesh is the dense model: nothing has to be segmented."""
    cloud = oriented_points(mesh)
    save_mesh(workspace.mesh_file(object_name), mesh)
    save_cloud(workspace.cloud_file(object_name), cloud)
    message = f"{object_name}: its dense model is the given mesh"
    details = {"triangles": len(mesh.triangles), "points": len(cloud.points)}
    return Outcome(messages=(message,), details=details)


def crop_of(workspace: Workspace, item: ObjectRecipe) -> Box3 | None:
    """The box the dense model is cut to: that of the annotation page, else the recipe's; object frame."""
    drawn = workspace.load_annotation(item.name).crop_m
    if drawn is not None or item.crop is None:
        return drawn
    return item.crop.low_m, item.crop.high_m

"""Stage `surface`: fuse the depth near the objects into a surface, for each scene."""

from __future__ import annotations

from rpl_data.geometry import Sphere, sphere_around, transform
from rpl_data.images import read_color
from rpl_data.meshes import in_order, joined_meshes, save_mesh
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.reconstruct.spheres import joined_spheres
from rpl_data.types import Solution, posed_frames
from rpl_data.types.instances import places_in

VERSION = 3
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def surface_steps(context: Context) -> list[Step]:
    """Plan the steps that fuse the depth near the objects, one per scene in which they stand still."""
    return [_surface_step(context, scene) for scene in context.still_places(context.placed_scenes())]


def _surface_step(context: Context, name: str) -> Step:
    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m

    def run(advance: Advance) -> Outcome:
        from rpl_data.reconstruct.surface import fuse_surfaces

        scene = workspace.load_scene(name)
        trajectory = workspace.load_trajectory(scene)
        frames = posed_frames(scene, trajectory, with_depth=True)
        standing = context.solutions_in(name)
        spheres = joined_spheres([sphere for item in standing for sphere in spheres_of(item, name)])
        meshes = fuse_surfaces(
            scene,
            trajectory,
            frames,
            workspace.depth_reader(scene),
            spheres=spheres,
            voxel_m=voxel_m,
            colors=read_color,
            advance=advance,
        )
        save_mesh(workspace.surface_file(name), in_order(joined_meshes(meshes)))
        return Outcome(len(frames))

    before = [f"solve/{item.model.name}" for item in context.solutions_in(name)]
    output = workspace.surface_file(name)
    return step(
        "surface",
        name,
        run,
        version=VERSION,
        options={"voxel_m": voxel_m} | context.frames_of(name),
        after=[*context.poses_of(name), *before],
        outputs=[output],
    )


def spheres_of(solution: Solution, scene: str) -> list[Sphere]:
    """Spheres around an object's keypoints in which the surface of a scene is fused, in the scene frame.

    There is one per instance of the object in the scene.
    """
    known = solution.model.points_object[solution.model.known]
    return [
        sphere_around(transform(solution.scene_from_object[place], known))
        for place in places_in(scene, solution.scene_from_object)
    ]

"""What the things of a scene stand on, as its fused surface shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rpl_data.meshes import load_mesh, oriented_points, thinned
from rpl_data.workspace.workspace import Workspace

if TYPE_CHECKING:
    from rpl_data.segment.region_growing import Plane


def support_plane(workspace: Workspace, scene: str, *, voxel_m: float) -> Plane | None:
    """The plane that the things of a scene stand on, normal upwards, scene frame; None where it is not known.

    Args:
        voxel_m: to which the surface is thinned before the plane is sought.
    """
    from rpl_data.place.things import things_on_support

    file = workspace.surface_file(scene)
    if not file.exists():
        return None
    surface = thinned(oriented_points(load_mesh(file)), voxel_m=voxel_m)
    trajectory = workspace.load_trajectory(workspace.load_scene(scene))
    things = things_on_support(surface, trajectory.scene_from_camera[:, :3, 3])
    return None if things is None else things.plane

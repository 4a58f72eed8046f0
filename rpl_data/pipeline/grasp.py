"""Compute grasp frames of the objects from two clicks on the annotation page."""

from __future__ import annotations

from rpl_data.clicks.grasp import grasp_frame
from rpl_data.clicks.log import GraspClicks
from rpl_data.geometry import Transform, invert
from rpl_data.types import DataError, Solution
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace


def object_from_grasp(workspace: Workspace, clicks: GraspClicks, solution: Solution) -> Transform:
    """Compute the grasp frame, in the object frame, from two clicks.

    Raises:
        DataError: the object has no pose in that scene, or there is no depth at the clicks.
    """
    if clicks.scene not in solution.scene_from_object:
        raise DataError(
            f"the grasp of {solution.model.name} was marked in scene {clicks.scene}, where the object has "
            "no pose; mark it in another scene, or click more keypoints there"
        )
    scene = workspace.load_scene(scene_of(clicks.scene))
    camera_from_grasp = grasp_frame(
        scene.intrinsics,
        workspace.depth_reader(scene)(scene.frame(clicks.frame)),
        (clicks.u_px, clicks.v_px),
        (clicks.toward_u_px, clicks.toward_v_px),
    )
    scene_from_camera = workspace.load_trajectory(scene).at(clicks.frame)
    object_from_scene = invert(solution.scene_from_object[clicks.scene])
    grasp: Transform = object_from_scene @ scene_from_camera @ camera_from_grasp
    return grasp


def save_grasps(workspace: Workspace, names: list[str]) -> dict[str, Transform]:
    """Write the grasp frame of every object that has one, and delete those that were removed."""
    found = {}
    for name in names:
        clicks = workspace.load_annotation(name).grasp
        grasp = None if clicks is None else object_from_grasp(workspace, clicks, workspace.load_placed(name))
        workspace.save_grasp(name, grasp)
        if grasp is not None:
            found[name] = grasp
    return found

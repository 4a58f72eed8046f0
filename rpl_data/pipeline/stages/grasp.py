"""Grasp frames of the objects, from the two clicks of the annotation page."""

from __future__ import annotations

from rpl_data.clicks.grasp import grasp_frame
from rpl_data.clicks.log import GraspClicks
from rpl_data.geometry import Transform, invert
from rpl_data.types import DataError, Solution
from rpl_data.workspace.workspace import Workspace


def object_from_grasp(workspace: Workspace, clicks: GraspClicks, solution: Solution) -> Transform:
    """The grasp frame of two clicks in the object frame.

    Raises:
        DataError: the object has no place in that scene, or there is no depth at the clicks.
    """
    if clicks.scene not in solution.scene_from_object:
        raise DataError(
            f"the grasp of {solution.model.name} was marked in scene {clicks.scene}, where the object has "
            "no place; mark it in another scene, or click more keypoints there"
        )
    scene = workspace.load_scene(clicks.scene)
    camera_from_grasp = grasp_frame(
        scene.intrinsics,
        workspace.depth_reader(scene)(scene.frame(clicks.frame)),
        (clicks.u_px, clicks.v_px),
        (clicks.toward_u_px, clicks.toward_v_px),
    )
    scene_from_camera = workspace.load_trajectory(scene).at(clicks.frame)
    object_from_scene = invert(solution.scene_from_object[clicks.scene])
    placed: Transform = object_from_scene @ scene_from_camera @ camera_from_grasp
    return placed


def save_grasps(workspace: Workspace, names: list[str]) -> dict[str, Transform]:
    """Write the grasp frame of every object that has one; those that have none any more are deleted."""
    found = {}
    for name in names:
        clicks = workspace.load_annotation(name).grasp
        placed = (
            None if clicks is None else object_from_grasp(workspace, clicks, workspace.load_solution(name))
        )
        workspace.save_grasp(name, placed)
        if placed is not None:
            found[name] = placed
    return found

"""Find a known object in one more scene without clicks (`rpl register --auto`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.geometry import Transform
from rpl_data.images import read_color
from rpl_data.pipeline.carved import is_carved
from rpl_data.pipeline.context import Context, path_key
from rpl_data.pipeline.ledger import Advance, Step
from rpl_data.pipeline.lifted_clicks import observe
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.pipeline.register import (
    Found,
    adding_step,
    dense_model,
    expected_error,
    object_named,
    refuse_changed,
)
from rpl_data.pipeline.stages.solve import trajectory_sigmas_m
from rpl_data.place.decide import Decision, click_to_ask, decide, off_px
from rpl_data.place.looked_at import LookedAt, looked_at
from rpl_data.place.place import candidates_in
from rpl_data.place.verify import Candidate
from rpl_data.solve.expected import covariance_by_pose
from rpl_data.types import (
    ClickResidual,
    DataError,
    Observation,
    Placement,
    PointCloud,
    Solution,
    UnsureError,
    posed_frames,
)
from rpl_data.types.instances import instance_of
from rpl_data.workspace.workspace import Workspace


def find_step(
    context: Context,
    object_name: str,
    scene: str,
    advance: Advance,
    *,
    proposed: Sequence[Transform] = (),
) -> Step:
    """Find a known object in one more scene; where one click is there, it must agree.

    The placement is on the disk when this returns; see `register_step`.

    Args:
        proposed: poses `scene_from_object` that are looked at beside those that shape proposes.

    Raises:
        UnsureError: it was not found, or not surely; the message names a click that would help.
        DataError: the object is not known, or has no dense model yet.
    """
    item, workspace = object_named(context, object_name), context.workspace
    if instance_of(scene):
        raise DataError(
            f"{item.name} in scene {scene}: one instance per scene is found without clicks; place the others "
            "by clicks on three of their keypoints"
        )
    refuse_changed(context, item, scene)
    solution = workspace.load_placed(object_name)
    model = dense_model(context, item, solution)
    if model is None or model.colors is None:
        raise _without_colors(workspace, object_name, scene)
    clicks = [o for o in _clicks(context, item, scene) if solution.model.known[o.click.keypoint]]
    there = _looked_at(context, scene, advance)
    candidates = candidates_in(
        model,
        there.surface,
        there.cameras,
        there.views,
        off_clicks_px=lambda pose: max((off_px(pose, solution.model, one) for one in clicks), default=0.0),
        proposed=proposed,
        advance=advance,
    )
    decision = decide(candidates, clicked=bool(clicks))
    if not decision.sure or decision.chosen is None:
        raise _asking(context, item, scene, model, solution, decision, candidates)
    found = _placed(context, item, scene, solution, clicks, decision.chosen, decision.words)
    return adding_step(context, item, scene, found)


def _without_colors(workspace: Workspace, object_name: str, scene: str) -> DataError:
    """Why an object without a coloured dense model is not looked for."""
    if is_carved(workspace, object_name):
        return UnsureError(
            f"object {object_name} is not looked for in scene {scene}: hardly any depth is measured on it, "
            "so its dense model has no colours by which it could be found; place it by clicks on three "
            "of its keypoints"
        )
    return DataError(
        f"object {object_name} has no coloured dense model of its present solution, by which it could be "
        f"found; run `rpl build` on {workspace.root} first"
    )


def _clicks(context: Context, item: ObjectRecipe, scene: str) -> list[Observation]:
    """The clicks on the object in the scene; mostly none."""
    clicked = context.workspace.load_annotation(item.name).clicks
    if not any(click.scene == scene for click in clicked):
        return []
    return observe(context.workspace, item.name, scene=scene)


def _looked_at(context: Context, scene: str, advance: Advance) -> LookedAt:
    workspace = context.workspace
    recorded = workspace.load_scene(scene)
    trajectory = workspace.load_trajectory(recorded)
    frames = posed_frames(recorded, trajectory, with_depth=True)
    if not frames:
        raise DataError(f"scene {scene} has no frame with a pose and a depth image; click the object there")
    return looked_at(
        recorded, trajectory, frames, workspace.depth_reader(recorded), read_color, advance=advance
    )


def _asking(
    context: Context,
    item: ObjectRecipe,
    scene: str,
    model: PointCloud,
    solution: Solution,
    decision: Decision,
    candidates: Sequence[Candidate],
) -> UnsureError:
    """Why the object is not placed, and what to do."""
    recorded = context.workspace.load_scene(scene)
    trajectory = context.workspace.load_trajectory(recorded)
    ask = click_to_ask(candidates, solution.model, model, recorded.intrinsics, trajectory)
    said = f"{item.name} was not placed in scene {scene}: {decision.words}"
    if ask is None:
        return UnsureError(f"{said}; if it is there, place it by clicks on three of its keypoints")
    return UnsureError(
        f"{said}; if it is there, click keypoint {solution.model.keypoints[ask.keypoint]} in frame "
        f"{ask.frame}, and try again",
        frame=ask.frame,
        keypoint=ask.keypoint,
    )


def _placed(
    context: Context,
    item: ObjectRecipe,
    scene: str,
    solution: Solution,
    clicks: Sequence[Observation],
    chosen: Candidate,
    words: str,
) -> Found:
    """The placement of a candidate, with the covariance that its surface and the model's shape give it."""
    pose, points = chosen.scene_from_object, solution.model.points_object
    strayed_m = trajectory_sigmas_m(context.workspace, [scene]).get(scene, 0.0)
    covariance = covariance_by_pose(np.linalg.inv(chosen.normal), pose, points, solution.covariance)
    residuals = tuple(
        ClickResidual(one.click, off_px(pose, solution.model, one), None, None, "none") for one in clicks
    )
    checked = f"colours and free space: {words}"
    placement = Placement(
        scene_from_object=pose,
        points_object=points,
        covariance_in_scene=covariance + strayed_m**2 * np.eye(3),
        residuals=residuals,
        how="automatic",
        checked=checked,
        path_key=path_key(context.workspace.load_trajectory(context.workspace.load_scene(scene))),
        trajectory_sigma_m=strayed_m,
    )
    line = (
        f"{item.name} was placed automatically in scene {scene}, checked by {checked}; its keypoints are "
        f"expected to be {expected_error(context, scene, placement)} off"
    )
    return Found(placement, (line,))

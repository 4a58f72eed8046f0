"""Place a known object in one more scene from its clicks there; its model stays as it is (`rpl register`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rpl_data.geometry import transform
from rpl_data.images import read_color
from rpl_data.meshes import load_cloud, moved_cloud
from rpl_data.pipeline.context import Context, crop_of, model_key, path_key
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step
from rpl_data.pipeline.lifted_clicks import observe
from rpl_data.pipeline.placements import after_alignment, with_placements
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.pipeline.stages.segment import depth_views
from rpl_data.pipeline.stages.solve import solve_step, trajectory_sigmas_m
from rpl_data.pipeline.stages.surface import spheres_of
from rpl_data.place.decide import MOST_FREE
from rpl_data.segment.free_space import seen_through
from rpl_data.solve.expected import covariance_by_pose, expected_px
from rpl_data.solve.joint import joint_clicks
from rpl_data.solve.register import Registration, register_scene
from rpl_data.types import (
    DataError,
    Observation,
    Placement,
    PointCloud,
    Solution,
    expected_mm,
    posed_frames,
)
from rpl_data.types.instances import scene_of
from rpl_data.wording import counted

FUSED_FRAMES = 60
"""Frames of a new scene that are fused to align an object, spread over it."""
WORTH_MM = 0.1
"""A further click that should gain less is not mentioned."""


@dataclass(frozen=True)
class Found:
    """A placement, and what is to be said of it.

    Attributes:
        lines: for the user.
    """

    placement: Placement
    lines: tuple[str, ...]


def register_step(context: Context, object_name: str, scene: str, advance: Advance) -> Step:
    """Place a known object in one more scene from its clicks there, and align it to the scene's surface.

    Another instance in a scene is named as in `types.instances`: `00/2`.

    The placement is on the disk when this returns. The step that it returns adds it to the solution, in the
    place of the solve: a build then goes on from it and does not solve again.

    Args:
        advance: receives the progress.

    Raises:
        DataError: the object is not known, or its clicks do not place it.
    """
    item = object_named(context, object_name)
    refuse_changed(context, item, scene)
    found = _by_clicks(context, item, scene, advance)
    return adding_step(context, item, scene, found)


def refuse_changed(context: Context, item: ObjectRecipe, scene: str) -> None:
    """DataError when there is no such scene, or the model is not that of the present clicks of the others."""
    workspace = context.workspace
    workspace.load_scene(scene_of(scene))  # says which scenes there are
    outside = {scene, *workspace.load_placements(item.name)}
    solved = {r.click for r in workspace.load_solution(item.name).residuals if r.click.scene not in outside}
    now = {o.click for o in observe(workspace, item.name) if o.click.scene not in outside}
    if solved != now:
        changed = ", ".join(sorted({click.scene for click in solved ^ now}))
        raise DataError(
            f"the clicks on {item.name} in scene {changed} have changed since its model was solved; run "
            f"`rpl build` on {workspace.root}, then register it again"
        )


def object_named(context: Context, name: str) -> ObjectRecipe:
    """The object of the recipe; DataError when there is none of this name."""
    for item in context.objects:
        if item.name == name:
            return item
    raise DataError(f"the recipe has no object {name!r}; it has {', '.join(context.object_names)}")


def adding_step(context: Context, item: ObjectRecipe, scene: str, found: Found) -> Step:
    """Keep a placement, and make the step that adds it to what was solved."""
    workspace = context.workspace
    placements = {**workspace.load_placements(item.name), scene: found.placement}
    workspace.save_placements(item.name, placements)

    def run(advance: Advance) -> Outcome:
        refined = workspace.load_placed(item.name) if workspace.refined_file(item.name).exists() else None
        added = {scene: found.placement}
        workspace.save_solution(with_placements(workspace.load_solution(item.name), added))
        if refined is not None:  # which saving the solution removed
            workspace.save_refined(with_placements(refined, added))
        return Outcome(messages=found.lines, details=before.outcome.details if before else {})

    step = solve_step(context, item)
    before = Ledger(workspace.stages_file).entries.get(step.name)
    return replace(step, run=run)


def _by_clicks(context: Context, item: ObjectRecipe, scene: str, advance: Advance) -> Found:
    """Where the clicks put the object; aligned, where it has a dense model and the evidence supports it."""
    workspace = context.workspace
    solution, observations = workspace.load_placed(item.name), observe(workspace, item.name, scene=scene)
    strayed_m = trajectory_sigmas_m(workspace, [scene]).get(scene, 0.0)
    clicked = register_scene(
        solution.model,
        observations,
        covariance=solution.covariance,
        click_sigma_px=solution.click_sigma_px,
        depth_sigma_ratio=solution.depth_sigma_ratio,
        trajectory_sigma_m=strayed_m,
    )
    placement = Placement(
        scene_from_object=clicked.scene_from_object,
        points_object=solution.model.points_object,
        covariance_in_scene=clicked.covariance_in_scene,
        residuals=clicked.residuals,
        how="clicks",
        checked="its clicks",
        path_key=path_key(workspace.load_trajectory(workspace.load_scene(scene_of(scene)))),
        trajectory_sigma_m=strayed_m,
        statements=clicked.statements,
        next_clicks=clicked.next_clicks,
    )
    lines = [f"{item.name} {line}" for line in _said(context, solution, scene, clicked, placement)]
    if (model := dense_model(context, item, solution)) is None:
        lines.append(
            f"{item.name} stays where its clicks put it: aligning it needs its dense model; run `rpl build`, "
            "then register it again"
        )
    else:
        placement, line = _aligned(context, item, scene, model, clicked, placement, observations, advance)
        lines.append(f"{item.name} {line}")
    return Found(placement, tuple(lines))


def _said(
    context: Context, solution: Solution, scene: str, found: Registration, placement: Placement
) -> Iterator[str]:
    """How well the clicks place the object, what they contradict, and what to click next."""
    used = [r for r in found.residuals if solution.model.known[r.click.keypoint]]
    mean_px = float(np.mean([residual.error_px for residual in used]))
    yield (
        f"stands in scene {scene}; its {counted(len(used), 'click')} fit to {mean_px:.1f} px, and its "
        f"keypoints are expected to be {expected_error(context, scene, placement)} off"
    )
    yield from (statement.text for statement in found.statements)
    if found.next_clicks and found.next_clicks[0].gain_mm >= WORTH_MM:
        best = found.next_clicks[0]
        yield (
            f"would gain most by a click on keypoint {solution.model.keypoints[best.keypoint]} in frame "
            f"{best.frame} of scene {scene}: {best.gain_mm:.1f} mm, which leaves {best.left_mm:.1f} mm"
        )


def expected_error(context: Context, scene: str, placement: Placement) -> str:
    """The expected error of the keypoints over a scene, in mm and px."""
    recorded = context.workspace.load_scene(scene_of(scene))
    points = transform(placement.scene_from_object, placement.points_object)
    trajectory = context.workspace.load_trajectory(recorded)
    covariance = placement.covariance_in_scene
    error_px = expected_px(covariance, points, recorded.intrinsics, trajectory.scene_from_camera)
    return f"{expected_mm(covariance):.1f} mm ({error_px:.1f} px)"


def dense_model(context: Context, item: ObjectRecipe, solution: Solution) -> PointCloud | None:
    """The object's surface, in the frame of the solution; None where none was made of that solution."""
    made = Ledger(context.workspace.stages_file).entries.get(f"segment/{item.name}")
    if made is None or made.outcome.details.get("model") != model_key(solution.model):
        return None
    path = context.workspace.cloud_file(item.name)
    return load_cloud(path) if path.exists() else None


def _aligned(
    context: Context,
    item: ObjectRecipe,
    scene: str,
    model: PointCloud,
    clicked: Registration,
    placement: Placement,
    observations: Sequence[Observation],
    advance: Advance,
) -> tuple[Placement, str]:
    """The placement after alignment, and what held-out evidence said of it."""
    from rpl_data.refine.align import align_scene

    solution = context.workspace.load_placed(item.name)
    alone = alone_in(solution, scene, clicked)
    region = _region(context, item, alone, scene, advance)
    clicks = joint_clicks(alone, observations, hold_points=True)
    found = align_scene(
        model, region, [clicked.scene_from_object, *clicked.alternatives], clicks.terms, clicks.costs
    )
    there = replace(alone, scene_from_object={scene: found.scene_from_object})
    free = float(seen_through(model.points, depth_views(context.workspace, scene, there)).mean())
    reason = found.verdict.reason
    if found.verdict.accepted and free > MOST_FREE:
        reason = f"aligned, {free:.0%} of its surface would lie where the cameras saw through"
    if not found.verdict.accepted or free > MOST_FREE:
        return placement, (
            f"stays where its clicks put it: {reason}; with `--auto true`, all poses that agree with its "
            "clicks are tried"
        )
    posed = clicks.solved(found.scene_from_object[None], np.empty((0, 3)), found.normal)
    by_pose, points = np.linalg.inv(found.normal), solution.model.points_object
    covariance = covariance_by_pose(by_pose, found.scene_from_object, points, solution.covariance)
    checked = (
        "its clicks, free space, and parts of its surface and colours that the alignment did not use: they "
        f"agree better by {found.verdict.gain_sigmas:.1f} standard errors than where the clicks put it"
    )
    aligned = after_alignment(placement, found.scene_from_object, covariance, posed.residuals, checked)
    return aligned, (
        f"was aligned to the surface and colours of scene {scene}, checked by {checked}; its keypoints "
        f"are now expected to be {expected_error(context, scene, aligned)} off"
    )


def alone_in(solution: Solution, scene: str, clicked: Registration) -> Solution:
    """A known object in the one scene in which its clicks place it; for no other is anything stated."""
    return replace(
        solution,
        scene_from_object={scene: clicked.scene_from_object},
        covariance_in_scene={},
        trajectory_sigma_m={scene: clicked.trajectory_sigma_m},
        residuals=clicked.residuals,
        statements=clicked.statements,
    )


def _region(
    context: Context, item: ObjectRecipe, alone: Solution, scene: str, advance: Advance
) -> PointCloud | None:
    """The surface of the object as the scene shows it, scene frame; None where it shows none."""
    from rpl_data.reconstruct.surface import fuse_surface
    from rpl_data.segment.scene_regions import grown_regions

    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m
    recorded = workspace.load_scene(scene_of(scene))
    trajectory = workspace.load_trajectory(recorded)
    frames = posed_frames(recorded, trajectory, with_depth=True)
    chosen = frames[:: max(1, -(-len(frames) // FUSED_FRAMES))]
    [sphere] = spheres_of(alone, scene_of(scene))
    mesh = fuse_surface(
        recorded,
        trajectory,
        chosen,
        workspace.depth_reader(recorded),
        centre_scene=sphere.centre_m,
        radius_m=sphere.radius_m,
        voxel_m=voxel_m,
        colors=read_color,
        advance=advance,
    )
    grown = grown_regions({scene: mesh}, alone, voxel_m=voxel_m, crop_m=crop_of(workspace, item)).get(scene)
    return None if grown is None else moved_cloud(grown, alone.scene_from_object[scene])

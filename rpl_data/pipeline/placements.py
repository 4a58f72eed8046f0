"""Scenes in which `rpl register` placed a known object: they follow its model, and never change it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform, fit_rigid
from rpl_data.pipeline.context import path_key
from rpl_data.types import Click, ClickResidual, KeypointModel, Observation, Placement, Solution
from rpl_data.types.instances import instance_of, scene_of
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace

SAME_MODEL_M = 0.01
"""A model whose keypoints have moved farther than this is another one: what was placed by it is dropped."""


def standing(workspace: Workspace, object_name: str) -> dict[str, Placement]:
    """The placements that hold: with the camera poses and the clicks that they were made with."""
    kept, scenes = workspace.load_placements(object_name), set(workspace.scene_names())
    clicks = workspace.load_annotation(object_name).clicks if kept else ()
    return {
        scene: one
        for scene, one in kept.items()
        if scene_of(scene) in scenes and _holds(workspace, scene, one, clicks)
    }


def fallen(workspace: Workspace, object_name: str) -> list[str]:
    """Scenes that were placed and are there, but not by their present clicks and camera poses."""
    scenes = set(workspace.scene_names())
    there = {scene for scene in workspace.load_placements(object_name) if scene_of(scene) in scenes}
    return sorted(there - standing(workspace, object_name).keys())


FEWEST = 3
"""Keypoints clicked in a scene that place it."""


def solved_from(
    workspace: Workspace, object_name: str, observations: Sequence[Observation]
) -> list[Observation]:
    """The clicks that the model is solved from: not those in placed scenes.

    A scene whose placement has fallen counts like any other where its clicks can place it; else it waits.
    """
    left_out = set(standing(workspace, object_name))
    for scene in fallen(workspace, object_name):
        if len({o.click.keypoint for o in observations if o.click.scene == scene}) < FEWEST:
            left_out.add(scene)
    left_out |= thin_instances([o for o in observations if o.click.scene not in left_out]).keys()
    return [o for o in observations if o.click.scene not in left_out]


def thin_instances(observations: Sequence[Observation]) -> dict[str, int]:
    """Further instances, and moved objects in frames, with too few clicks yet: places with their keypoints.

    They wait for more clicks, so that the rest can be solved. Keypoints count that are clicked elsewhere too.
    """
    keypoints: dict[str, set[int]] = {}
    for observation in observations:
        keypoints.setdefault(observation.click.scene, set()).add(observation.click.keypoint)
    firm = {place for place, found in keypoints.items() if not instance_of(place) or len(found) >= FEWEST}
    if not firm:
        return {}
    known = set().union(*(keypoints[place] for place in firm))
    counts = {place: len(found & known) for place, found in keypoints.items() if instance_of(place)}
    return {place: count for place, count in counts.items() if count < FEWEST}


def thin_lines(observations: Sequence[Observation]) -> list[str]:
    """One line per place that waits for more clicks, for the user."""
    return [
        f"scene {place}: {counted(count, 'keypoint')} of this instance "
        f"{'is' if count == 1 else 'are'} clicked that other places show too, so it is left out; click at "
        f"least {FEWEST} that do not lie on a line"
        for place, count in thin_instances(observations).items()
    ]


def fallen_lines(workspace: Workspace, object_name: str) -> list[str]:
    """One line per scene that is not placed any more, for the user."""
    clicks = workspace.load_annotation(object_name).clicks
    return [
        f"scene {scene}: its clicks or camera poses are not those with which `rpl register` placed it, so it "
        + (
            "now counts like any other scene; register it again to place it by the model"
            if len({click.keypoint for click in clicks if click.scene == scene}) >= FEWEST
            else "is left out; register it again (`--auto true`)"
        )
        for scene in fallen(workspace, object_name)
    ]


def _holds(workspace: Workspace, scene: str, placement: Placement, clicks: Sequence[Click]) -> bool:
    """Whether a scene's poses are the same, and its clicks: on known keypoints, in frames with a pose."""
    trajectory = workspace.load_trajectory(workspace.load_scene(scene_of(scene)))
    posed = set(trajectory.frames.tolist())
    known = np.isfinite(placement.points_object).all(axis=1)
    used = {
        click
        for click in clicks
        if click.scene == scene and click.frame in posed and known[click.keypoint : click.keypoint + 1].all()
    }
    return path_key(trajectory) == placement.path_key and used == {r.click for r in placement.residuals}


PLACED = {
    "clicks": "placed by",
    "aligned": "aligned to its surface and colours, checked by",
    "automatic": "placed automatically, checked by",
}


def placement_lines(workspace: Workspace, *, scenes: Collection[str] | None = None) -> list[str]:
    """One line per scene in which `rpl register` placed an object: how, and what speaks for it.

    Args:
        scenes: only these; all when None.
    """
    return [
        f"{name} in scene {scene}: {PLACED[one.how]} {one.checked}"
        for name in workspace.object_names()
        for scene, one in sorted(standing(workspace, name).items())
        if (scenes is None or scene_of(scene) in scenes)
        and scene in workspace.load_placed(name).scene_from_object
    ]


def without_scenes(solution: Solution, scenes: Collection[str]) -> Solution:
    """The solution of the other scenes."""
    return replace(
        solution,
        scene_from_object={s: p for s, p in solution.scene_from_object.items() if s not in scenes},
        covariance_in_scene={s: c for s, c in solution.covariance_in_scene.items() if s not in scenes},
        trajectory_sigma_m={s: m for s, m in solution.trajectory_sigma_m.items() if s not in scenes},
        residuals=tuple(r for r in solution.residuals if r.click.scene not in scenes),
        statements=tuple(s for s in solution.statements if all(c.scene not in scenes for c in s.clicks)),
        next_clicks=tuple(click for click in solution.next_clicks if click.scene not in scenes),
    )


def with_placements(solution: Solution, placements: Mapping[str, Placement]) -> Solution:
    """The solution with the placed scenes added.

    The model may have been solved again since, in another frame: a placement then follows its keypoints. It
    is left out, with a warning, where they have moved too far for that.
    """
    poses = {scene: _followed(one, solution.model) for scene, one in placements.items()}
    placed = {scene: pose for scene, pose in poses.items() if pose is not None}
    lost = [_lost(scene) for scene in sorted(poses.keys() - placed.keys())]
    kept, added = without_scenes(solution, placed), [placements[scene] for scene in placed]
    told = {_lost(scene) for scene in placements}
    return replace(
        kept,
        warnings=(*(line for line in solution.warnings if line not in told), *lost),
        scene_from_object={**kept.scene_from_object, **placed},
        covariance_in_scene={
            **kept.covariance_in_scene,
            **{scene: _whole(placements[scene].covariance_in_scene, solution.model) for scene in placed},
        },
        trajectory_sigma_m={
            **kept.trajectory_sigma_m,
            **{scene: placements[scene].trajectory_sigma_m for scene in placed},
        },
        residuals=(*kept.residuals, *(r for one in added for r in one.residuals)),
        statements=(*(s for one in added for s in one.statements), *kept.statements),
        next_clicks=(*kept.next_clicks, *(click for one in added for click in one.next_clicks)),
    )


def after_alignment(
    placement: Placement,
    scene_from_object: Transform,
    covariance_in_scene: Float64[np.ndarray, "k 3 3"],
    residuals: Sequence[ClickResidual],
    checked: str,
) -> Placement:
    """The placement once it was aligned.

    That its clicks place it badly, and what a further one would bring, was said of the clicks alone.

    Args:
        covariance_in_scene: without what the poses of the scene stray.
    """
    return replace(
        placement,
        scene_from_object=scene_from_object,
        covariance_in_scene=covariance_in_scene + placement.trajectory_sigma_m**2 * np.eye(3),
        residuals=tuple(residuals),
        statements=tuple(said for said in placement.statements if said.kind != "weak scene"),
        next_clicks=(),
        how="aligned",
        checked=checked,
    )


def _lost(scene: str) -> str:
    return f"scene {scene} is not placed any more, as the model has changed: run `rpl register` again"


def _whole(covariance: Float64[np.ndarray, "k 3 3"], model: KeypointModel) -> Float64[np.ndarray, "k 3 3"]:
    """The covariances, with the largest for keypoints that became known after the scene was placed."""
    missing = model.known & ~np.isfinite(covariance).all(axis=(1, 2))
    largest = covariance[np.nanargmax(np.trace(covariance, axis1=1, axis2=2))]
    return np.where(missing[:, None, None], largest, covariance)


def _followed(placement: Placement, model: KeypointModel) -> Transform | None:
    """`scene_from_object` of the model as it is now; None where it is another one."""
    if np.array_equal(placement.points_object, model.points_object, equal_nan=True):
        return placement.scene_from_object
    if len(placement.points_object) != len(model.points_object):
        return None
    both = model.known & np.isfinite(placement.points_object).all(axis=1)
    if both.sum() < 3:
        return None
    then, now = placement.points_object[both], model.points_object[both]
    then_from_now = fit_rigid(then, now)
    moved = now @ then_from_now[:3, :3].T + then_from_now[:3, 3]
    if np.linalg.norm(moved - then, axis=1).max() > SAME_MODEL_M:
        return None
    followed: Transform = placement.scene_from_object @ then_from_now
    return followed

"""Scenes in which `rpl register` placed a known object: they follow its model, and never change it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from rpl_data.geometry import Transform, fit_rigid
from rpl_data.types import KeypointModel, Placement, Solution
from rpl_data.workspace.workspace import Workspace

SAME_MODEL_M = 0.01
"""A model whose keypoints have moved farther than this is another one: what was placed by it is dropped."""


def standing(workspace: Workspace, object_name: str) -> dict[str, Placement]:
    """The placements that hold: their scenes are there and have the clicks that they were placed with."""
    scenes = set(workspace.scene_names())
    clicks = workspace.load_annotation(object_name).clicks
    return {
        scene: one
        for scene, one in workspace.load_placements(object_name).items()
        if scene in scenes
        and {r.click for r in one.residuals} == {click for click in clicks if click.scene == scene}
    }


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
        if scenes is None or scene in scenes
    ]


def without_scenes(solution: Solution, scenes: Collection[str]) -> Solution:
    """The solution of the other scenes."""
    return replace(
        solution,
        scene_from_object={s: p for s, p in solution.scene_from_object.items() if s not in scenes},
        covariance_in_scene={s: c for s, c in solution.covariance_in_scene.items() if s not in scenes},
        trajectory_sigma_m={s: m for s, m in solution.trajectory_sigma_m.items() if s not in scenes},
        residuals=tuple(r for r in solution.residuals if r.click.scene not in scenes),
    )


def with_placements(solution: Solution, placements: Mapping[str, Placement]) -> Solution:
    """The solution with the placed scenes added.

    The model may have been solved again since, in another frame: a placement then follows its keypoints. It
    is left out, with a warning, where they have moved too far for that.
    """
    poses, warnings = {}, list(solution.warnings)
    for scene, one in placements.items():
        pose = _followed(one, solution.model)
        if pose is None:
            warnings.append(
                f"scene {scene} is not placed any more, as the model has changed: run `rpl register` again"
            )
        else:
            poses[scene] = pose
    kept = without_scenes(solution, poses)
    return replace(
        kept,
        warnings=tuple(warnings),
        scene_from_object={**kept.scene_from_object, **poses},
        covariance_in_scene={
            **kept.covariance_in_scene,
            **{scene: placements[scene].covariance_in_scene for scene in poses},
        },
        residuals=(*kept.residuals, *(r for scene in poses for r in placements[scene].residuals)),
    )


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

"""The paper's own chain on the same recording and the same clicks, to stand beside ours.

The paper's user does two things that a chain alone does not: clicks where the sensor measures the object (a
click without depth vanishes there), and crops the dense model by hand. So the chain is measured twice: as it
is, and with a careful hand that the truth guides in both, which no person can better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from rpl_data.clicks.table import clicks_to_csv
from rpl_data.evaluate.quality import compare_workspaces, model_error
from rpl_data.files import write_text
from rpl_data.geometry import transform
from rpl_data.meshes import load_cloud, load_mesh, save_cloud, select
from rpl_data.pipeline.build import recipe_of
from rpl_data.pipeline.presets import by_method
from rpl_data.pipeline.recipe import Recipe
from rpl_data.raycast import RayScene
from rpl_data.types import Click, DepthImage
from rpl_data.workspace.workspace import Workspace

from ..building import build_and_tell
from ..variants import built_beside, copied
from .rows import Scores, scores_of

NUDGED_PX, NUDGED_M = 10, 0.01
"""A careful click goes to the nearest pixel, at most so far away, that measures the keypoint so well."""
CROPPED_M = 0.005
"""A careful crop leaves what lies so near to the true surface."""


def papers_scores(
    workspace: Workspace, truth: Workspace, folder: Path, *, tracked: bool, workers: int | None
) -> dict[str, Scores]:
    """Errors of the paper's chain, by object, built in a folder."""
    made = built_beside(workspace, folder, lambda recipe: papers(recipe, tracked=tracked), workers=workers)
    return {row.object: scores_of(row) for row in compare_workspaces(made, truth)}


def careful_scores(
    workspace: Workspace, truth: Workspace, folder: Path, *, tracked: bool, workers: int | None
) -> dict[str, Scores]:
    """Errors of the paper's chain when a careful hand clicks and crops, by object.

    What does not depend on clicks is taken from the chain as it is, if that was built beside the folder.
    """
    copied(Workspace(folder.parent / "paper"), folder)
    clicks = folder / "careful.csv"
    write_text(clicks, careful_clicks(workspace, truth))

    def change(recipe: Recipe) -> Recipe:
        objects = tuple(replace(item, clicks=clicks) for item in recipe.objects)
        return replace(papers(recipe, tracked=tracked), objects=objects)

    made = built_beside(workspace, folder, change, until="segment", workers=workers)
    for name in made.object_names():
        crop_by_truth(made, truth, name)
    build_and_tell(recipe_of(made), made, until="label", workers=workers)
    return {row.object: scores_of(row) for row in compare_workspaces(made, truth)}


def papers(recipe: Recipe, *, tracked: bool) -> Recipe:
    """The recipe with the paper's chain; a trajectory that we track ourselves stands for ElasticFusion's."""
    changed = by_method(recipe, "paper")
    if not tracked:
        return changed
    return replace(changed, reconstruct=replace(changed.reconstruct, method="track"))


# The careful hand ---------------------------------------------------------------------------------


def careful_clicks(workspace: Workspace, truth: Workspace) -> str:
    """The clicks of a workspace as CSV, each moved to where the sensor measures its keypoint.

    A click is left out where no pixel near it does.
    """
    text = ""
    for name in workspace.object_names():
        annotation = workspace.load_annotation(name)
        table = clicks_to_csv(list(_nudged(workspace, truth, annotation.clicks)), annotation.keypoints)
        text += table if not text else table.partition("\n")[2]
    return text


def _nudged(workspace: Workspace, truth: Workspace, clicks: tuple[Click, ...]) -> Iterator[Click]:
    for scene_name in dict.fromkeys(click.scene for click in clicks):
        scene = workspace.load_scene(scene_name)
        video = workspace.parts().video_of(scene_name)
        true = {label.frame: label for label in truth.load_labels(video)}
        for click in (click for click in clicks if click.scene == scene_name):
            points = truth.load_solution(click.object).model.points_object
            pose = next(i for i in true[click.frame].instances if i.object == click.object).camera_from_object
            z_m = float(transform(pose, points[click.keypoint])[2])
            pixel = nearest_measuring(workspace.depth_reader(scene)(scene.frame(click.frame)), click, z_m)
            if pixel is not None:
                yield replace(click, scene=video, u_px=pixel[0], v_px=pixel[1])


def nearest_measuring(depth_m: DepthImage, click: Click, z_m: float) -> tuple[float, float] | None:
    """The nearest pixel that measures a click's keypoint: the click itself if it does; None = none near."""
    v, u = np.nonzero(np.abs(depth_m - z_m) < NUDGED_M)
    away_px = np.hypot(u - click.u_px, v - click.v_px)
    if not len(u) or away_px.min() > NUDGED_PX:
        return None
    best = int(away_px.argmin())
    here = away_px[best] <= np.hypot(0.5, 0.5)
    return (click.u_px, click.v_px) if here else (float(u[best]), float(v[best]))


def crop_by_truth(workspace: Workspace, truth: Workspace, name: str) -> None:
    """Remove from the points of a dense model all that do not belong to the object."""
    fit = model_error(workspace.load_solution(name).model, truth.load_solution(name).model)
    cloud = load_cloud(workspace.cloud_file(name))
    points = transform(fit.truth_from_object, cloud.points)
    nearest = RayScene([load_mesh(truth.mesh_file(name))]).closest(points).points
    kept = np.linalg.norm(points - nearest, axis=1) < CROPPED_M
    if kept.any():
        save_cloud(workspace.cloud_file(name), select(cloud, kept))

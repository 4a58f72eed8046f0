"""One recording, many sets of clicks: the sparse model solved for subsets of keypoints and scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.clicks.lift import lift_clicks
from rpl_data.evaluate.quality import model_error
from rpl_data.solve.solve import solve
from rpl_data.twin.annotator import click
from rpl_data.types import DataError, FrameLabel, KeypointModel, Observation
from rpl_data.workspace.workspace import Workspace

from .curve import Curve

KEYPOINTS, SCENES = 9, 8
"""The paper's: N_k = 9 while N_s varies, N_s = 8 while N_k does."""
LEAST_KEYPOINTS, LEAST_SCENES = 4, 2
"""Three points tie two scenes, but one side of an object shows few of few: with four, many draws fail."""


def curves_of(workspace: Workspace, *, seeds: int, click_noise_px: float) -> list[Curve]:
    """Both curves of every object of a twin."""
    truth = Workspace(workspace.truth)
    found = []
    for number, name in enumerate(truth.object_names()):
        model = truth.load_solution(name).model
        places = [
            scene for scene in workspace.scene_names() if scene in truth.load_solution(name).scene_from_object
        ]
        labels = {scene: list(truth.load_labels(scene)) for scene in places}
        rows_k, rows_s = [], []
        xs_k = tuple(range(LEAST_KEYPOINTS, len(model.keypoints) + 1))
        xs_s = tuple(range(LEAST_SCENES, len(places) + 1))
        for seed in range(seeds):
            rng = np.random.default_rng([seed, 5, number])
            observations = _clicked(workspace, name, labels, click_noise_px, rng)
            order = [places[i] for i in rng.permutation(len(places))]
            rows_k.append(tuple(_error_mm(model, observations, k, order[:SCENES]) for k in xs_k))
            rows_s.append(tuple(_error_mm(model, observations, KEYPOINTS, order[:s]) for s in xs_s))
        most_k, most_s = min(KEYPOINTS, len(model.keypoints)), min(SCENES, len(places))
        found.append(Curve(name, "keypoints", most_s, xs_k, tuple(rows_k)))
        found.append(Curve(name, "scenes", most_k, xs_s, tuple(rows_s)))
    return found


def _clicked(
    workspace: Workspace,
    name: str,
    labels: dict[str, list[FrameLabel]],
    noise_px: float,
    rng: np.random.Generator,
) -> list[Observation]:
    """Click all landmarks once in every scene that shows them, and lift the clicks to 3D."""
    scenes = {scene: workspace.load_scene(scene) for scene in labels}
    clicks = []
    for scene, of_scene in labels.items():
        intrinsics = scenes[scene].intrinsics
        clicks += click(
            of_scene, name, intrinsics=intrinsics, clicks_per_keypoint=1, noise_px=noise_px, rng=rng
        )
    trajectories = {scene: workspace.load_trajectory(scenes[scene]) for scene in labels}
    return lift_clicks(clicks, scenes, trajectories, workspace.depth_reader)


def _error_mm(
    truth: KeypointModel, observations: Sequence[Observation], keypoints: int, scenes: Sequence[str]
) -> float:
    """Mean error of the model of the first `keypoints` landmarks from those scenes; NaN without an answer."""
    chosen = [o for o in observations if o.click.keypoint < keypoints and o.click.scene in scenes]
    first = KeypointModel(truth.name, truth.keypoints[:keypoints], truth.points_object[:keypoints])
    try:
        solution = solve(truth.name, first.keypoints, chosen)
        errors_m = model_error(solution.model, first).keypoints_m
    except DataError:  # too few clicks in common: counted by the caller
        return float("nan")
    return 1e3 * float(errors_m[np.isfinite(errors_m)].mean())

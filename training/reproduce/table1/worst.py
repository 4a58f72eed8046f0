"""Where the labels of an object are worst, and what is known of the scene: few clicks explain most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpl_data.evaluate.quality import LabelErrors, label_errors, model_error
from rpl_data.types import Solution
from rpl_data.workspace.workspace import Workspace


@dataclass(frozen=True)
class WorstScene:
    """The scene with the largest mean 2D error of an object, strict protocol.

    Attributes:
        iou: of the full masks.
        clicked: how many keypoints are clicked there.
        rotation_deg: mean error of the object's orientation there.
    """

    scene: str
    error_2d_px: float
    iou: float
    clicked: int
    rotation_deg: float

    def __str__(self) -> str:
        """Describe the scene in a table's cell."""
        return (
            f"scene {self.scene}: {self.error_2d_px:.1f} px, IoU {self.iou:.3f}, "
            f"{self.rotation_deg:.1f} deg, {self.clicked} keypoints clicked"
        )


def worst_scenes(workspace: Workspace, truth: Workspace) -> dict[str, WorstScene]:
    """The worst scene of each object that has labels with truth, by the object's name."""
    solutions = {name: workspace.load_placed(name) for name in workspace.object_names()}
    known = [name for name in solutions if truth.solution_file(name).exists()]
    alignments = {
        name: model_error(solutions[name].model, truth.load_solution(name).model).truth_from_object
        for name in known
    }
    worst: dict[str, WorstScene] = {}
    for scene in workspace.labelled_scene_names():
        if scene not in truth.labelled_scene_names():
            continue
        places = workspace.parts().scenes_of(scene)  # those a recording was cut into
        found = label_errors(workspace.load_labels(scene), truth.load_labels(scene), alignments)
        for name in found.keys() & alignments.keys():
            if found[name].instances:
                one = _in_scene(scene, places, solutions[name], found[name])
                worst[name] = max(worst.get(name, one), one, key=lambda scene: scene.error_2d_px)
    return worst


def _in_scene(scene: str, places: Sequence[str], solution: Solution, errors: LabelErrors) -> WorstScene:
    instances = errors.instances
    return WorstScene(
        scene=scene,
        error_2d_px=float(np.nanmean([one.mean_px for one in instances])),
        iou=float(np.mean([one.iou_full for one in instances])),
        clicked=len({one.click.keypoint for one in solution.residuals if one.click.scene in places}),
        rotation_deg=float(np.rad2deg(np.mean([one.rotation_rad for one in instances]))),
    )

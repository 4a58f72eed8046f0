"""What cannot be solved, said before it is tried: no clicks, broken numbers, scenes that nothing ties."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.clicks.rigidity import describe_loose, generic_points, loose_scenes
from rpl_data.solve.initial_guess import Hypotheses
from rpl_data.types import DataError, Observation
from rpl_data.wording import counted

FEWEST = 3
"""Keypoints per scene; fewer leave the object free to turn."""


def refuse_bad(object_name: str, observations: Sequence[Observation]) -> None:
    """DataError for no clicks at all, or numbers that are not finite."""
    if not observations:
        raise DataError(f"object {object_name} has no clicks; mark its keypoints first (`rpl clicks import`)")
    for o in observations:
        if not (np.isfinite(o.ray_camera).all() and np.isfinite(o.scene_from_camera).all()):
            raise DataError(
                f"object {object_name}, scene {o.click.scene}, frame {o.click.frame}: the click on keypoint "
                f"{o.click.keypoint} or the camera pose is not a finite number; delete the click or "
                "mend the pose"
            )


def refuse_few(object_name: str, observations: Sequence[Observation]) -> None:
    """DataError for fewer than three keypoints in one scene alone; several are judged by what they share."""
    scenes = {o.click.scene for o in observations}
    clicked = {o.click.keypoint for o in observations}
    if len(scenes) > 1 or len(clicked) >= FEWEST:
        return
    raise DataError(
        f"object {object_name}, scene {min(scenes)}: {counted(len(clicked), 'keypoint')} clicked, and in no "
        f"other scene any; a scene needs at least {FEWEST} that do not lie on a line: click more"
    )


def refuse_untied(
    object_name: str, groups: Sequence[Hypotheses], scenes: Sequence[str], keypoints: Sequence[str]
) -> None:
    """DataError when the pattern of clicks cannot tie the scenes, wherever the keypoints are."""
    refuse_loose(
        object_name, generic_points(len(keypoints)), _clicked(groups, len(keypoints)), scenes, keypoints
    )


def refuse_loose(
    object_name: str,
    points_model: Float64[np.ndarray, "k 3"],
    clicked: np.ndarray,
    scenes: Sequence[str],
    keypoints: Sequence[str],
) -> None:
    """DataError when the keypoints where they are do not tie the scenes."""
    loose = loose_scenes(points_model, clicked)
    if loose:
        told = describe_loose(loose, clicked, scenes, keypoints, points_model)
        raise DataError(f"object {object_name}: {told}")


def _clicked(groups: Sequence[Hypotheses], keypoints: int) -> np.ndarray:
    """Which scene has candidates of which keypoint, bool (S, K)."""
    return np.array([[k in group for k in range(keypoints)] for group in groups])

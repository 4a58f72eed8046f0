"""What is said where no dense model can be made: whether surface was measured at the keypoints at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NoReturn

from scipy.spatial import cKDTree

from rpl_data.geometry import transform
from rpl_data.segment.region_growing import NEAR_M, CropBox
from rpl_data.types import DataError, Mesh, Solution
from rpl_data.wording import counted


def refuse_without_surface(
    surfaces: Mapping[str, Mesh], solution: Solution, crop_m: CropBox | None
) -> NoReturn:
    """DataError: no region grew from the keypoints in any scene."""
    near = {
        scene: _near_surface(mesh, solution, scene)
        for scene, mesh in surfaces.items()
        if scene in solution.scene_from_object
    }
    known = counted(int(solution.model.known.sum()), "keypoint")
    there = (
        ", ".join(f"of {count} of them in scene {scene}" for scene, count in near.items())
        or "in no placed scene"
    )
    if crop_m is not None:
        todo = "the crop box cuts surface away, too: remove it, or make it larger"
    elif any(2 * count >= solution.model.known.sum() for count in near.values()):
        todo = "there it does not stand out from what the object stands on: click keypoints above that"
    else:
        todo = "so most keypoints are not where depth was measured: mend the clicks or the camera poses, or "
        todo += "film the object from nearer, so that its depth is measured"
    raise DataError(
        f"object {solution.model.name}: no dense model grows from its {known}. Surface was measured within "
        f"{1e3 * NEAR_M:.0f} mm {there}; {todo}"
    )


def refuse_seen_through(name: str, scenes: Sequence[str]) -> NoReturn:
    """DataError: nothing is left of what grew, since other scenes saw through all of it."""
    raise DataError(
        f"object {name}: other scenes see through all of its surface in {counted(len(scenes), 'scene')} "
        f"({', '.join(scenes)}), so no dense model is left: the scenes do not agree on where it is, or depth "
        "is measured through it; check its clicks and the camera poses, or leave out the scenes that see "
        "through it"
    )


def _near_surface(mesh: Mesh, solution: Solution, scene: str) -> int:
    """How many of the known keypoints lie on a scene's surface."""
    model = solution.model
    if not len(mesh.vertices):
        return 0
    points = transform(solution.scene_from_object[scene], model.points_object[model.known])
    return int((cKDTree(mesh.vertices).query(points)[0] < NEAR_M).sum())

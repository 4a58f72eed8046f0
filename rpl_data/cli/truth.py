"""Write the true poses that came with recordings to the file that `truth:` in a recipe names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rpl_data.evaluate.cad import cads_in, mesh_of
from rpl_data.files import write_json
from rpl_data.json_arrays import Json
from rpl_data.pipeline.recipe import Recipe
from rpl_data.types import DataError, Recording


def write_true_poses(
    recordings: Sequence[Recording], recipe: Recipe, cads: Path, out: Path, *, metres_per_unit: float
) -> dict[str, int]:
    """Write the file with the true poses, and the CAD model and picked keypoints of each object.

    True poses refer to the frame of a CAD model, so the keypoints must be picked on that model.

    Args:
        recordings: recordings of the recipe.
        recipe: its objects must have the names that the dataset gives them.
        cads: folder with <object>.obj (or .ply, .stl ...) and <object>.pp.
        out: the JSON file to write.
        metres_per_unit: unit of the CAD models; 0.001 for BOP's.

    Returns:
        Number of frames with a true pose, by object name.

    Raises:
        DataError: the recordings have no true poses of the recipe's objects, or a CAD or its points are
            missing.
    """
    keypoints = {item.name: item.keypoint_names for item in recipe.objects}
    known = {name for recording in recordings for name in recording.true_poses}
    wanted = {name: names for name, names in keypoints.items() if name in known}
    if not wanted:
        raise DataError(
            f"the recordings have true poses of {', '.join(sorted(known)) or 'no object'}; the recipe's "
            f"objects are {', '.join(keypoints) or 'not named'}; call them alike"
        )
    content: Json = {}
    for name, cad in cads_in(cads, wanted, metres_per_unit=metres_per_unit).items():
        file = mesh_of(cads, name)
        assert file is not None  # it was just read
        content[f"points_{name}"] = [
            row.tolist() if np.isfinite(row).all() else [None] * 3 for row in cad.picked
        ]
        content[f"keypoints_{name}"] = list(wanted[name])
        content[f"mesh_{name}"] = {"file": str(file.resolve()), "metres_per_unit": metres_per_unit}
        content[f"camera_from_{name}"] = _rows(recordings, name)
    write_json(out, content, indent=None)
    prefix = "camera_from_"
    return {
        key.removeprefix(prefix): sum(row is not None for rows in scenes.values() for row in rows)
        for key, scenes in content.items()
        if key.startswith(prefix)
    }


def _rows(recordings: Sequence[Recording], name: str) -> Mapping[str, list[list[list[float]] | None]]:
    """One 4x4 matrix per frame, by scene, from frame 0 to the last one; None where there is no pose."""
    scenes = {}
    for recording in recordings:
        poses = recording.true_poses.get(name, {})
        if poses:
            rows = (poses.get(index) for index in range(max(poses) + 1))
            scenes[recording.scene.name] = [None if row is None else row.tolist() for row in rows]
    return scenes

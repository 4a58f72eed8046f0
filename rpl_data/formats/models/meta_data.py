"""RapidPoseLabels' saved_meta_data.npz, as its process.py writes it today.

With N scenes (in the order of their sorted names), K keypoints and M clicks:

- ``model`` (K, 3): keypoints in the frame of the first scene, the paper's F_w, here `world`
- ``scenes`` (7 N): N translations, then N quaternions w x y z, of scene_from_world
- ``ref`` (N, 3, K): clicked points in the frame of their scene; meaningless where not clicked
- ``sm`` (3 M, 3 N K): selection matrix, one identity block per click, scene by scene

There are two older generations: in one, ``scenes`` leaves out the first scene; the other has ``res`` instead
of ``model`` and ``scenes``: the optimised vector, with such scenes, then the keypoints row by row.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import decoding, refuse_special, writing
from rpl_data.formats.containers.cut_zip import ZIP_FAULTS
from rpl_data.formats.models.sparse_model import points_in_first_scene
from rpl_data.geometry import Points, from_quaternion_xyzw, invert, to_quaternion_xyzw, transform
from rpl_data.types import DataError, Observation, Solution

LARGEST_BYTES = 256 * 2**20
WRITE_AGAIN = "run RapidPoseLabels' process.py again"


@dataclass(frozen=True)
class MetaData:
    """Content of the file.

    Attributes:
        points_world: one row per keypoint, metres, in the frame of the first scene; NaN where unknown.
        scene_from_world: one rigid transform per scene; the first is the identity.
        clicked_scene: clicked points in the frame of their scene; NaN where not clicked.
    """

    points_world: Float64[np.ndarray, "k 3"]
    scene_from_world: Float64[np.ndarray, "n 4 4"]
    clicked_scene: Float64[np.ndarray, "n k 3"]


def read_meta_data(path: Path) -> MetaData:
    """Read a saved_meta_data.npz of any generation.

    Raises:
        DataError: the file is missing, of no known generation, or its arrays do not fit each other.
    """
    with decoding(path, WRITE_AGAIN):
        return _meta_data(path, _as_today(_load(path)))


def _meta_data(path: Path, arrays: Mapping[str, np.ndarray]) -> MetaData:
    missing = [key for key in ("model", "scenes", "ref", "sm") if key not in arrays]
    if missing:
        raise DataError(
            f"{path} lacks {', '.join(missing)} (it has {', '.join(arrays) or 'nothing'}); expected what "
            "RapidPoseLabels' process.py saves today; run it again"
        )
    model, ref, selection = arrays["model"], arrays["ref"], arrays["sm"]
    scenes, keypoints = ref.shape[0], len(model)
    if model.shape != (keypoints, 3) or ref.shape != (scenes, 3, keypoints):
        raise DataError(f"{path}: model {model.shape} and ref {ref.shape} do not fit (K, 3) and (N, 3, K)")
    if selection.ndim != 2 or selection.shape[1] != 3 * scenes * keypoints:
        raise DataError(f"{path}: sm has shape {selection.shape}; expected (3 M, {3 * scenes * keypoints})")
    clicked = (selection != 0).any(axis=0).reshape(scenes, keypoints, 3).all(axis=2)
    points = np.where(clicked[:, :, None], ref.transpose(0, 2, 1), np.nan)
    return MetaData(model, _transforms(path, arrays["scenes"].ravel(), scenes), points)


def _load(path: Path) -> dict[str, np.ndarray]:
    refuse_special(path)
    if not path.exists():
        raise DataError(f"{path} does not exist")
    try:
        with zipfile.ZipFile(path) as archive, decoding(path, WRITE_AGAIN):
            return {Path(name).stem: _array(archive, path, name) for name in archive.namelist()}
    except DataError:
        raise
    except ZIP_FAULTS as error:
        raise DataError(f"{path} is not an npz archive of numbers: {error}; {WRITE_AGAIN}") from error


def _array(archive: zipfile.ZipFile, path: Path, name: str) -> np.ndarray:
    """One array of numbers; its size is looked at before it is unpacked."""
    if archive.getinfo(name).file_size > LARGEST_BYTES:
        raise DataError(f"{path}: {name} is larger than {LARGEST_BYTES // 2**20} MB; {WRITE_AGAIN}")
    with archive.open(name) as file:
        content = file.read(LARGEST_BYTES)
    return np.asarray(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False), dtype=float)


def _as_today(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Convert the arrays of the oldest generation: split ``res`` into its parts."""
    if "res" not in arrays or "model" in arrays or arrays.get("ref", np.empty(0)).ndim != 3:
        return arrays
    result, model = arrays["res"].ravel(), 3 * arrays["ref"].shape[2]
    parts = {"scenes": result[:-model], "model": result[-model:].reshape(-1, 3)}
    return {key: value for key, value in arrays.items() if key != "res"} | parts


def _transforms(path: Path, values: np.ndarray, scenes: int) -> Float64[np.ndarray, "n 4 4"]:
    if len(values) not in (7 * scenes, 7 * (scenes - 1)):
        raise DataError(
            f"{path}: scenes has {len(values)} numbers; expected {7 * scenes}, 7 for each of {scenes} scenes"
        )
    listed = len(values) // 7
    translations_m = values[: 3 * listed].reshape(-1, 3)
    quaternions_wxyz = values[3 * listed :].reshape(-1, 4)
    transforms = [
        from_quaternion_xyzw(np.roll(q, -1), t) for q, t in zip(quaternions_wxyz, translations_m, strict=True)
    ]
    return np.array([*[np.eye(4)] * (scenes - listed), *transforms])


def write_meta_data(path: Path, solution: Solution, clicked_scene: Mapping[str, Points]) -> None:
    """Write a solution as saved_meta_data.npz, in the frame of the first scene by name.

    Args:
        path: the file to write.
        solution: the model, and `scene_from_object` of every scene.
        clicked_scene: per scene, one row per keypoint in the scene's frame, NaN where not clicked; see
            `clicked_points`.
    """
    names = sorted(solution.scene_from_object)
    world_from_object = solution.scene_from_object[names[0]]
    in_world = [solution.scene_from_object[name] @ invert(world_from_object) for name in names]
    quaternions_wxyz = [np.roll(to_quaternion_xyzw(scene_from_world), 1) for scene_from_world in in_world]
    nothing = np.full((len(solution.model.keypoints), 3), np.nan)
    points = np.array([clicked_scene.get(name, nothing) for name in names])
    with writing(path, "wb") as file:
        np.savez(
            file,
            model=points_in_first_scene(solution),
            scenes=np.concatenate([*(m[:3, 3] for m in in_world), *quaternions_wxyz]),
            ref=np.nan_to_num(points).transpose(0, 2, 1),
            sm=_selection(np.isfinite(points).all(axis=2)),
        )


def _selection(clicked: np.ndarray) -> Float64[np.ndarray, "m3 nk3"]:
    """Selection matrix of `clicked`, bool (n, k)."""
    columns = np.flatnonzero(np.repeat(clicked.ravel(), 3))
    selection = np.zeros((len(columns), 3 * clicked.size))
    selection[np.arange(len(columns)), columns] = 1
    return selection


def clicked_points(observations: Sequence[Observation], solution: Solution) -> dict[str, Points]:
    """3D positions of the clicks per scene: one row per keypoint, scene frame, NaN where there is none.

    The depth is the one that the solution settled on; several clicks on a keypoint are averaged.
    """
    found: dict[tuple[str, int], list[np.ndarray]] = {}
    for observation, residual in zip(observations, solution.residuals, strict=True):
        if residual.depth_m is None or residual.outlier:
            continue
        point = transform(observation.scene_from_camera, residual.depth_m * observation.ray_camera)
        found.setdefault((residual.click.scene, residual.click.keypoint), []).append(point)
    points = {scene: np.full((len(solution.model.keypoints), 3), np.nan) for scene, _ in found}
    for (scene, keypoint), several in found.items():
        points[scene][keypoint] = np.mean(several, axis=0)
    return points

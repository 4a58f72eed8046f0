"""YCB-Video in its own layout (Xiang et al., PoseCNN).

::

    <dataset>/data/0048/000001-color.png      or .jpg
                        000001-depth.png      16 bit, registered to colour; metres = value / factor_depth
                        000001-meta.mat       MATLAB: intrinsic_matrix, factor_depth, cls_indexes, poses
                                              (3, 4, n: camera_from_object, metres) and
                                              rotation_translation_matrix (camera_from_scene, metres)
              image_sets/classes.txt          names of the classes, numbered from 1

Sequences 0-59 and 60-91 are from two cameras, so the camera is read from each. A meta.mat with one object has
`poses` as 3 x 4. The objects' poses refer to the dataset's own models, not to BOP's, whose origins are moved
to their centres.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import read_text
from rpl_data.formats.containers.mat import read_mat
from rpl_data.formats.recordings.camera_file import CameraFile, told_of
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    grouped,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.scene_folders import chosen, scene_folders
from rpl_data.formats.recordings.times import FRAME_RATE_HZ
from rpl_data.formats.recordings.true_poses import with_true_poses
from rpl_data.geometry import Transform, invert, rigid
from rpl_data.types import DataError, Recording

METRES_PER_UNIT = 1e-4
CLASSES = (
    "002_master_chef_can", "003_cracker_box", "004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle",
    "007_tuna_fish_can", "008_pudding_box", "009_gelatin_box", "010_potted_meat_can", "011_banana",
    "019_pitcher_base", "021_bleach_cleanser", "024_bowl", "025_mug", "035_power_drill", "036_wood_block",
    "037_scissors", "040_large_marker", "051_large_clamp", "052_extra_large_clamp", "061_foam_brick",
)  # fmt: skip
"""Names of image_sets/classes.txt, in its order; used where a copy of the dataset lacks the file."""

_COLOR = re.compile(r"(\d{6})-color\.(?:png|jpg)")
_KEYS = ("cls_indexes", "factor_depth", "intrinsic_matrix", "poses", "rotation_translation_matrix")


def read_ycb_video(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one sequence, or those of the dataset, sorted by name.

    `Frame.index` is the number of the file, from 1. The poses of the objects are `Recording.true_poses`.

    Args:
        path: the dataset, its folder data, or a sequence.
        names: which sequences to read, such as 0048.
        metres_per_unit: unit of the depth images, instead of 1 / factor_depth.
        camera: used instead of intrinsic_matrix.

    Raises:
        DataError: there is no sequence, no meta.mat of it can be read, or no frame is complete.
    """
    path = path.absolute()
    root = path / "data" if (path / "data").is_dir() else path
    found = scene_folders(root, is_ycb_sequence)
    if not found:
        raise DataError(f"{path} has no <number>-color.png, and neither has any folder in it or in data/")
    return [
        _read_sequence(name, folder, metres_per_unit, camera)
        for name, folder in chosen(found, names, path).items()
    ]


def is_ycb_sequence(folder: Path) -> bool:
    """Whether the folder holds frames of this layout."""
    return folder.is_dir() and any(_COLOR.fullmatch(found.name) for found in folder.iterdir())


def _read_sequence(name: str, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    colors = {int(m[1]): p for p in sorted(folder.iterdir()) if (m := _COLOR.fullmatch(p.name))}
    metas = {number: _read_meta(folder / f"{number:06d}-meta.mat") for number in colors}
    whole = {number: meta for number, meta in metas.items() if meta is not None}
    if not whole:
        raise DataError(f"{folder}: none of {len(metas)} frames has a readable meta.mat; copy them again")
    source, first = folder / f"{min(whole):06d}-meta.mat", whole[min(whole)]
    own = CameraFile(
        camera or _camera(first, source),
        1 / float(_array(first, "factor_depth", source).item()) if unit_m is None else unit_m,
    )
    told = told_of(folder, camera=camera, metres_per_unit=unit_m, own=own, own_source=source)
    listing = Listing(
        name,
        folder,
        "ycb_video",
        [Pair(n, n / FRAME_RATE_HZ, colors[n], folder / f"{n:06d}-depth.png") for n in whole],
        told.camera or own.camera,
        source,
        told.metres_per_unit or METRES_PER_UNIT,
        notes=(f"no timestamps: {FRAME_RATE_HZ:g} frames per second assumed",),
        skipped=tuple(grouped(sorted(metas.keys() - whole.keys()), "without a readable meta.mat")),
    )
    recording = _with_trajectory(examine(listing), whole, folder)
    return with_true_poses(recording, _object_poses(whole, _classes(folder), folder))


def _read_meta(path: Path) -> Mapping[str, Any] | None:
    """What is needed of a meta.mat; None where it is missing or broken."""
    try:
        return read_mat(path, _KEYS)
    except DataError:
        return None  # the reader counts and names it


def _array(meta: Mapping[str, Any], key: str, source: Path) -> np.ndarray:
    if key not in meta:
        raise DataError(f"{source} lacks {key}; expected a meta.mat of YCB-Video, with {', '.join(_KEYS)}")
    return np.asarray(meta[key], dtype=np.float64)


def _camera(meta: Mapping[str, Any], source: Path) -> Camera:
    matrix = _array(meta, "intrinsic_matrix", source)
    return float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])


def _with_trajectory(recording: Recording, metas: Mapping[int, Mapping[str, Any]], folder: Path) -> Recording:
    known = {
        number: invert(_rigid(_array(meta, "rotation_translation_matrix", folder)))
        for number, meta in metas.items()
        if "rotation_translation_matrix" in meta
    }
    if not known:
        return without_poses(recording, "rotation_translation_matrix in meta.mat")
    return with_poses(recording, known, without="without rotation_translation_matrix in meta.mat")


def _rigid(rows: np.ndarray) -> Transform:
    return rigid(np.ascontiguousarray(rows[:3, :3]), np.ascontiguousarray(rows[:3, 3]))


def _classes(folder: Path) -> Sequence[str]:
    """Names of the classes from 1, of the dataset that contains the sequence."""
    for above in list(folder.parents)[:2]:
        if (above / "image_sets" / "classes.txt").exists():
            return read_text(above / "image_sets" / "classes.txt").split()
    return CLASSES


def _object_poses(
    metas: Mapping[int, Mapping[str, Any]], classes: Sequence[str], folder: Path
) -> dict[str, dict[int, Transform]]:
    """Read camera_from_object by class name and frame."""
    poses: dict[str, dict[int, Transform]] = {}
    for number, meta in metas.items():
        numbers = _array(meta, "cls_indexes", folder).ravel().astype(int)
        matrices = _array(meta, "poses", folder)
        matrices = matrices[..., None] if matrices.ndim == 2 else matrices
        if matrices.shape != (3, 4, len(numbers)) or not all(1 <= n <= len(classes) for n in numbers):
            raise DataError(
                f"{folder / f'{number:06d}-meta.mat'}: poses {matrices.shape} and cls_indexes "
                f"{numbers.tolist()} do not fit (3, 4, n) and n classes of 1-{len(classes)}; copy it again"
            )
        for row, one in enumerate(numbers.tolist()):
            poses.setdefault(classes[one - 1], {})[number] = _rigid(matrices[:, :, row])
    return poses

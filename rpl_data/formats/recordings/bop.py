"""Scenes of BOP (the benchmark for 6D object pose, "scenewise" layout), read as recordings and written.

::

    <dataset>/<split>/000048/
      rgb/000001.png             or .jpg
      depth/000001.png           16 bit, depth_mm = value * depth_scale
      scene_camera.json          by image id: cam_K (9 numbers, row-major), depth_scale, and, not in all
                                 datasets, cam_R_w2c, cam_t_w2c (mm): camera_from_scene
      scene_gt.json              by image id, per instance: obj_id, cam_R_m2c, cam_t_m2c (mm)

Ids are written without leading zeros in the JSON files and with them in file names. Cameras are OpenCV's,
rotations row-major. BOP moves the origin of each dataset's models to their centre: poses of YCB-Video's
objects here differ from those of the dataset's own layout.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.files import read_json, read_text, write_json
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
from rpl_data.formats.recordings.scene_folders import chosen, folders_in, scene_folders
from rpl_data.formats.recordings.times import FRAME_RATE_HZ
from rpl_data.formats.recordings.true_poses import with_true_poses
from rpl_data.geometry import Transform, invert, rigid
from rpl_data.json_arrays import Json
from rpl_data.types import DataError, Intrinsics, Recording
from rpl_data.wording import counted

_KEY = re.compile(r'[\s,]*"(\d+)"\s*:\s*')


def read_bop(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one scene, or the scenes of a split, sorted by name.

    `Frame.index` is the image id. The poses of the objects are `Recording.true_poses`, named obj_000005; an
    object that appears more than once in an image has none there, since the two cannot be told apart.

    Args:
        path: <dataset>/<split>, or a scene in it.
        names: which scenes to read, by folder name.
        metres_per_unit: unit of the depth images, instead of depth_scale.
        camera: used instead of cam_K.

    Raises:
        DataError: there is no scene, its files are broken, the camera changes within it, or no frame is
            complete.
    """
    path = path.absolute()
    found = scene_folders(path, is_bop_scene)
    if not found:
        splits = [folder.name for folder in folders_in(path) if any(map(is_bop_scene, folder.glob("*")))]
        hint = f"; its splits are {', '.join(splits)}: give one of them" if splits else ""
        raise DataError(f"{path} has no scene_camera.json, and neither has any folder in it{hint}")
    return [
        _read_scene(name, folder, metres_per_unit, camera)
        for name, folder in chosen(found, names, path).items()
    ]


def is_bop_scene(folder: Path) -> bool:
    """Whether the folder is a scene of this layout."""
    return (folder / "scene_camera.json").is_file()


def _read_scene(name: str, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    cameras, lost = _by_id(folder / "scene_camera.json")
    if not cameras:
        raise DataError(f"{folder / 'scene_camera.json'} lists no images")
    source = folder / "scene_camera.json"
    own = CameraFile(
        camera or _one_camera(cameras, source), _one_unit_m(cameras, source) if unit_m is None else unit_m
    )
    told = told_of(folder, camera=camera, metres_per_unit=unit_m, own=own, own_source=source)
    listing = Listing(
        name,
        folder,
        "bop",
        [Pair(i, i / FRAME_RATE_HZ, _color(folder, i), folder / "depth" / f"{i:06d}.png") for i in cameras],
        told.camera or own.camera,
        source,
        told.metres_per_unit or 0.001,
        notes=(f"no timestamps: {FRAME_RATE_HZ:g} image ids per second assumed",),
        skipped=lost,
    )
    recording = examine(listing)
    poses = {i: invert(_pose(entry, "w2c", source)) for i, entry in cameras.items() if "cam_R_w2c" in entry}
    if poses:
        recording = with_poses(recording, poses, without="without cam_R_w2c in scene_camera.json")
    else:
        recording = without_poses(recording, "cam_R_w2c in scene_camera.json")
    return _with_truth(recording, folder / "scene_gt.json")


def _by_id(path: Path) -> tuple[dict[int, Any], tuple[str, ...]]:
    """Read a file that lists entries by image id, sorted; also what was lost of it."""
    lost: tuple[str, ...] = ()
    try:
        content = read_json(path)
    except DataError:
        content = _whole_entries(read_text(path))
        if not content:
            raise
        kept = counted(len(content), "image")
        lost = (f"{path.name} was cut off or is damaged after {kept}; the rest of it is lost",)
    try:
        return dict(sorted((int(key), value) for key, value in content.items())), lost
    except (AttributeError, ValueError) as error:
        raise DataError(f'{path}: expected {{"<image id>": ...}}: {error}') from error


def _whole_entries(text: str) -> dict[str, Any]:
    """Entries of a JSON object up to the first that is broken."""
    entries: dict[str, Any] = {}
    decoder, at = json.JSONDecoder(), text.find("{") + 1
    while key := _KEY.match(text, at):
        try:
            entries[key[1]], at = decoder.raw_decode(text, key.end())
        except json.JSONDecodeError:
            break
    return entries


def _color(folder: Path, index: int) -> Path:
    jpeg = folder / "rgb" / f"{index:06d}.jpg"
    return jpeg if jpeg.exists() else jpeg.with_suffix(".png")


def _one_camera(cameras: Mapping[int, Json], source: Path) -> Camera:
    """The camera of all images; DataError when it changes, since a scene here has one camera."""
    (first, entry), *others = cameras.items()
    matrix = _numbers(entry, "cam_K", 9, source)
    for index, other in others:
        if not np.allclose(_numbers(other, "cam_K", 9, source), matrix, atol=0.01):
            raise DataError(
                f"{source}: cam_K changes between images {first} and {index}, as in cropped images; a scene "
                "has one camera here: choose a split with the whole images"
            )
    fx, _, cx, _, fy, cy = (float(value) for value in matrix[:6])
    return fx, fy, cx, cy


def _one_unit_m(cameras: Mapping[int, Json], source: Path) -> float:
    """Metres per unit of depth; depth_scale is in millimetres."""
    scales = {float(_numbers(entry, "depth_scale", 1, source)[0]) for entry in cameras.values()}
    if len(scales) > 1:
        raise DataError(f"{source}: depth_scale changes within the scene: {sorted(scales)}; expected one")
    return scales.pop() / 1000


def _numbers(entry: Json, key: str, count: int, source: Path) -> Float64[np.ndarray, " n"]:
    try:
        values = np.ravel(np.array(entry[key], dtype=np.float64))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{source}: an image has no numbers {key} ({error!r})") from error
    if len(values) != count or not np.isfinite(values).all():
        raise DataError(f"{source}: expected {count} finite numbers in {key}, found {entry[key]}")
    return values


def _pose(entry: Json, which: str, source: Path) -> Transform:
    """The transform "w2c" or "m2c" of an entry; its translation is stored in millimetres."""
    rotation = _numbers(entry, f"cam_R_{which}", 9, source).reshape(3, 3)
    return rigid(rotation, _numbers(entry, f"cam_t_{which}", 3, source) / 1000)


def _with_truth(recording: Recording, path: Path) -> Recording:
    """Add the poses of scene_gt.json, which test images of some datasets do not have."""
    if not path.exists():
        return recording
    poses: dict[str, dict[int, Transform]] = {}
    twice: list[int] = []
    entries, lost = _by_id(path)
    for index, instances in entries.items():
        ids = [instance.get("obj_id") for instance in instances]
        twice += [index] if len(set(ids)) < len(ids) else []
        for instance in instances:
            if ids.count(instance.get("obj_id")) == 1:
                name = f"obj_{int(_numbers(instance, 'obj_id', 1, path)[0]):06d}"
                poses.setdefault(name, {})[index] = _pose(instance, "m2c", path)
    notes = grouped(twice, "with an object more than once: the truth leaves that object out")
    return with_true_poses(replace(recording, notes=(*recording.notes, *lost, *notes)), poses)


# Writing ------------------------------------------------------------------------------------------


def write_scene_camera(
    folder: Path,
    intrinsics: Intrinsics,
    metres_per_unit: float,
    scene_from_camera: Mapping[int, Transform | None],
) -> None:
    """Write scene_camera.json; DataError for a lens with distortion, which it cannot hold.

    Args:
        folder: folder of the scene.
        intrinsics: camera of all images.
        metres_per_unit: unit of the depth images.
        scene_from_camera: pose by image id; None where it is not known.
    """
    if any(intrinsics.distortion):
        raise DataError(f"scene_camera.json in {folder} cannot hold lens distortion; undistort first")
    fixed = {"cam_K": intrinsics.matrix.ravel().tolist(), "depth_scale": 1000 * metres_per_unit}
    entries = {
        str(index): fixed | ({} if pose is None else _entry(invert(pose), "w2c"))
        for index, pose in scene_from_camera.items()
    }
    write_json(folder / "scene_camera.json", entries)


def write_scene_gt(folder: Path, camera_from_object: Mapping[int, Iterable[tuple[int, Transform]]]) -> None:
    """Write scene_gt.json.

    Args:
        folder: folder of the scene.
        camera_from_object: by image id, the object id and pose of every instance.
    """
    entries = {
        str(index): [_entry(pose, "m2c") | {"obj_id": number} for number, pose in instances]
        for index, instances in camera_from_object.items()
    }
    write_json(folder / "scene_gt.json", entries)


def _entry(a_from_b: Transform, which: str) -> Json:
    return {
        f"cam_R_{which}": a_from_b[:3, :3].ravel().tolist(),
        f"cam_t_{which}": (1000 * a_from_b[:3, 3]).tolist(),
    }

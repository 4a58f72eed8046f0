"""Numbered frames with one pose each: 7-Scenes, 3DMatch and the input of tsdf-fusion-python.

::

    <scene>/camera-intrinsics.txt       the 3x3 matrix K; may lie in the folder above instead
            frame-000540.color.jpg      or .png
            frame-000540.depth.png      16 bit, millimetres; 0 and 65535 = no depth
            frame-000540.pose.txt       4x4, scene_from_camera, metres; for all frames or for none

The layout does not say whether depth is registered to colour. In its usual recordings (a Kinect's two
cameras, one K) it is not, so the scene is marked as not registered unless the caller knows better.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import read_text, write_text
from rpl_data.formats.recordings.camera_file import read_camera, told_of
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.matrices import rigid_or_none
from rpl_data.formats.recordings.scene_folders import chosen_scenes
from rpl_data.formats.recordings.times import FRAME_RATE_HZ
from rpl_data.geometry import Transform
from rpl_data.types import DataError, Intrinsics, Recording
from rpl_data.untrusted.numbers import plain_number

_COLOR = re.compile(r"frame-(\d+)\.color\.(?:jpg|jpeg|png)")


def read_frames(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one scene, or the scenes in the folders of a folder, sorted by name.

    `Frame.index` is the number in the file's name. Frames without depth, with an unreadable image, or
    without a valid pose where others have one, are left out and named in `Recording.skipped`.

    Args:
        path: a folder with frame-N files, or with such folders.
        names: which scenes to read, by folder name.
        metres_per_unit: unit of the depth images; 0.001 when not given, which `Recording.notes` says.
        camera: used instead of camera-intrinsics.txt.

    Raises:
        DataError: there is no frame, no camera, no complete frame, or the depth unit is wrong.
    """
    path = path.absolute()
    scenes = chosen_scenes(path, has_frames, names, lacks="frame-<number>.color.jpg (or .png)")
    return [_read_scene(name, folder, metres_per_unit, camera) for name, folder in scenes.items()]


def has_frames(folder: Path) -> bool:
    """Whether the folder holds frames of this layout."""
    return folder.is_dir() and any(_COLOR.fullmatch(found.name) for found in folder.iterdir())


def _read_scene(name: str, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    pairs = [_pair(folder, found) for found in sorted(folder.iterdir()) if _COLOR.fullmatch(found.name)]
    camera_file = folder / "camera-intrinsics.txt"
    if not camera_file.exists():
        camera_file = folder.parent / "camera-intrinsics.txt"
    own = read_camera(camera_file) if camera_file.exists() else None
    told = told_of(folder, camera=camera, metres_per_unit=unit_m, own=own, own_source=camera_file)
    if told.camera is None:
        raise DataError(
            f"{folder} has no camera-intrinsics.txt with the 3x3 matrix K, nor has the folder above; "
            "write it, or give `camera: [fx, fy, cx, cy]`"
        )
    listing = Listing(
        name,
        folder,
        "frames",
        sorted(pairs, key=lambda pair: pair.index),
        told.camera,
        told.source,
        0.001 if told.metres_per_unit is None else told.metres_per_unit,
        assumed_unit=told.metres_per_unit is None,
        registered=False,
        notes=(
            f"no timestamps: {FRAME_RATE_HZ:g} frames per second assumed",
            "depth assumed not to be registered to colour; set `registered: true` if the camera aligned it",
        ),
    )
    recording = examine(listing)
    files = {frame.index: _pose_file(frame.color) for frame in recording.scene.frames}
    if not any(file.exists() for file in files.values()):
        return without_poses(recording, "pose.txt")
    poses = {index: _read_pose(file) for index, file in files.items() if file.exists()}
    valid = {index: pose for index, pose in poses.items() if pose is not None}
    return with_poses(recording, valid, without="without a valid pose.txt (the tracker was lost there)")


def _pair(folder: Path, color: Path) -> Pair:
    stem = color.name.split(".")[0]
    number = int(stem.removeprefix("frame-"))
    return Pair(number, number / FRAME_RATE_HZ, color, folder / f"{stem}.depth.png")


def _pose_file(color: Path) -> Path:
    return color.with_name(f"{color.name.split('.')[0]}.pose.txt")


def _read_pose(path: Path) -> Transform | None:
    """Read scene_from_camera; None where a lost tracker left no rigid transform."""
    try:
        values = [plain_number(float, token) for token in read_text(path).split()]
    except ValueError:  # 7-Scenes' tracker writes "-1.#IND"
        return None
    return rigid_or_none(values) if len(values) == 16 else None


# Writing ------------------------------------------------------------------------------------------


def write_frame_camera(folder: Path, intrinsics: Intrinsics) -> None:
    """Write camera-intrinsics.txt; DataError for a lens with distortion, which it cannot hold."""
    if any(intrinsics.distortion):
        raise DataError(f"camera-intrinsics.txt in {folder} cannot hold lens distortion; undistort first")
    _write_matrix(folder / "camera-intrinsics.txt", intrinsics.matrix)


def write_frame_pose(folder: Path, index: int, scene_from_camera: Transform) -> None:
    """Write the pose of a frame."""
    _write_matrix(folder / f"frame-{index:06d}.pose.txt", scene_from_camera)


def _write_matrix(path: Path, matrix: Float64[np.ndarray, "n n"]) -> None:
    lines = [" ".join(repr(float(value)) for value in row) for row in matrix]
    write_text(path, "\n".join(lines) + "\n")

"""Read ScanNet's recordings (.sens); depth of a size of its own keeps it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rpl_data.formats.containers.sens import Sens, index_sens, sens_color, sens_depth
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    grouped,
    intrinsics_of,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.matrices import rigid_or_none
from rpl_data.formats.recordings.saved_images import write_color, write_depth
from rpl_data.formats.recordings.scene_folders import chosen
from rpl_data.formats.recordings.times import FRAME_RATE_HZ
from rpl_data.types import DataError, Recording


def read_sens(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read the recordings of a folder, or one, and unpack their images; scenes are named after their files.

    `Frame.index` is the frame's position in the file. Frames whose pose is lost are left out and counted.

    Args:
        path: a .sens file, or a folder of them.
        unpack: returns the folder for the images of a scene, given its name.
        names: which recordings to read, without suffix.
        metres_per_unit: of the depth; what the file says when left out.
        camera: used instead of the file's colour camera.

    Raises:
        DataError: there is no recording, or no complete frame in it.
    """
    path = path.absolute()
    files = sorted(path.glob("*.sens")) if path.is_dir() else [path]
    found = chosen({file.stem: file for file in files}, names, path)
    if not found:
        raise DataError(f"{path} holds no .sens file")
    return [_read_file(name, file, unpack(name), metres_per_unit, camera) for name, file in found.items()]


def is_sens(path: Path) -> bool:
    """Whether the path is a ScanNet recording, by its suffix."""
    return path.suffix == ".sens" and path.is_file()


def _read_file(name: str, file: Path, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    sens = index_sens(file)
    lens = camera or _camera(sens.color)
    unit_m = 1 / sens.units_per_metre if unit_m is None else unit_m
    times_s, notes = _times_s(sens)
    pairs: list[Pair] = []
    broken: list[int] = []
    with file.open("rb") as opened:
        for number, frame in enumerate(sens.frames):
            color, units = sens_color(opened, sens, frame), sens_depth(opened, sens, frame)
            if color is None or units is None:
                broken.append(number)
                continue
            pairs.append(
                Pair(
                    number,
                    times_s[number],
                    write_color(folder, number, color),
                    write_depth(folder, number, units),
                )
            )
    if not pairs:
        raise DataError(f"{file}: all of its {len(sens.frames)} frames are damaged; copy it again")
    if not sens.one_place:
        notes += ("colour and depth have extrinsics of their own, which are not used: not registered",)
    listing = Listing(
        name,
        file,
        "scannet",
        pairs,
        lens,
        file,
        unit_m,
        registered=sens.one_place,
        depth_camera=_depth_camera(sens, lens),
        notes=(f"recorded by {sens.sensor}", *notes),
        skipped=(*_loss(sens), *grouped(broken, "with damaged data in the file")),
    )
    return _posed(examine(listing), sens)


def _camera(matrix: np.ndarray) -> Camera:
    return tuple(float(value) for value in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))


def _depth_camera(sens: Sens, lens: Camera) -> Camera | None:
    """The camera of depth; None where it has the pixels of the colour image."""
    depth = _camera(sens.depth)
    same = intrinsics_of(lens, *sens.color_px) == intrinsics_of(depth, *sens.depth_px)
    return None if same else depth


def _times_s(sens: Sens) -> tuple[list[float], tuple[str, ...]]:
    stored = [frame.time_us for frame in sens.frames]
    if len(set(stored)) > len(stored) // 2:
        return [time * 1e-6 for time in stored], ()
    note = f"no timestamps: {FRAME_RATE_HZ:g} frames per second assumed"
    return [number / FRAME_RATE_HZ for number in range(len(stored))], (note,)


def _loss(sens: Sens) -> list[str]:
    whole = len(sens.frames)
    if sens.promised <= whole:
        return []
    return [
        f"{sens.promised - whole} of {sens.promised} frames: the file was cut off after frame {whole - 1}"
    ]


def _posed(recording: Recording, sens: Sens) -> Recording:
    """Add the poses that are rigid; none where all are the same, as before a reconstruction."""
    found = {
        frame.index: rigid_or_none(sens.frames[frame.index].scene_from_camera)
        for frame in recording.scene.frames
    }
    poses = {index: pose for index, pose in found.items() if pose is not None}
    stacked = np.array(list(poses.values()))
    if not poses or (len(poses) > 1 and np.ptp(stacked, axis=0).max() < 1e-9):
        return without_poses(recording, "poses in the file")
    return with_poses(recording, poses, without="without a valid pose (the tracker was lost there)")

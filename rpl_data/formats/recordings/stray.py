"""Stray Scanner: a video, depth and confidence images, and ARKit's odometry.

::

    <scan>/rgb.mp4                 HEVC, 1920 x 1440
           depth/000000.png        16 bit, mm, 256 x 192, one per frame of the video; npy in early versions
           confidence/000000.png   0, 1, 2
           camera_matrix.csv       K of the video
           odometry.csv            timestamp, frame, x, y, z, qx, qy, qz, qw; newer versions: more columns

Source: github.com/strayrobots/scanner, docs/format.md. Its poses are scene_from_camera in OpenCV's axes:
StrayScanner/Helpers/OdometryEncoder.swift turns ARKit's camera half about x before it writes (`q_WA * q_AC`).
Columns are found by their names.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rpl_data.files import read_text
from rpl_data.formats.containers.video import video_frames
from rpl_data.formats.recordings.depth_files import read_depth_file, stored_units
from rpl_data.formats.recordings.frame_files import Camera, grouped
from rpl_data.formats.recordings.matrices import read_matrix_camera
from rpl_data.formats.recordings.phones import (
    DOUBTED,
    Phone,
    PhoneFrame,
    has_confidence,
    phone_recording,
    read_confidence,
)
from rpl_data.formats.recordings.saved_images import write_images
from rpl_data.formats.recordings.scene_folders import chosen_scenes
from rpl_data.geometry import Transform, from_quaternion_xyzw
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.child import in_child
from rpl_data.untrusted.numbers import plain_number

RATE_HZ = 60.0
"""Assumed frame rate of a video without times."""

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


def read_stray(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one scan, or the scans in the folders of a folder, and unpack their images.

    Each scan is read in a process of its own, which a damaged video may end. `Frame.index` is the number of
    the frame in the video.

    Args:
        path: a scan, or a folder of scans.
        unpack: returns the folder for the images of a scene, given its name.
        names: which scans to read, by folder name.
        metres_per_unit: unit of the depth images; 0.001 by the format.
        camera: used instead of camera_matrix.csv.

    Raises:
        DataError: there is no scan, its video cannot be played, or no frame is complete.
    """
    path = path.absolute()
    return [
        in_child(read_scan, name, folder, unpack(name), metres_per_unit, camera, file=folder / "rgb.mp4")
        for name, folder in chosen_scenes(path, is_stray, names, lacks="rgb.mp4 with depth/").items()
    ]


def is_stray(folder: Path) -> bool:
    """Whether the folder is a scan of this app."""
    return (folder / "rgb.mp4").is_file() and (folder / "depth").is_dir()


def read_scan(
    name: str, folder: Path, out: Path, metres_per_unit: float | None, camera: Camera | None
) -> Recording:
    """Read a scan in this process; arguments as `read_stray`, errors too."""
    rows = read_odometry(folder / "odometry.csv")
    depths = {int(path.stem): path for path in (folder / "depth").iterdir()
              if path.suffix in (".png", ".npy") and path.stem.isdigit()}  # fmt: skip
    frames: list[PhoneFrame] = []
    alone, broken, seen = [], [], 0
    for number, (time_s, image) in enumerate(video_frames(folder / "rgb.mp4")):
        seen = number + 1
        if number not in depths:
            alone.append(number)
            continue
        row = rows.get(number, Row(number / RATE_HZ if time_s is None else time_s, None))
        try:
            units = _depth(folder, depths[number])
        except DataError:
            broken.append(number)
            continue
        files = write_images(out, number, image, units)
        frames.append(PhoneFrame(number, row.timestamp_s, *files, pose=row.pose))
    skipped = [
        *grouped(alone, "of the video without a depth image"),
        *grouped(broken, "with a damaged depth or confidence image"),
        *grouped(sorted(n for n in depths if n >= seen), "of the depth images beyond the end of the video"),
    ]
    lens = camera or read_matrix_camera(folder / "camera_matrix.csv").camera
    notes = (DOUBTED,) if has_confidence(folder) else ()
    phone = Phone(name, folder, "stray", frames, lens, notes=notes, skipped=tuple(skipped))
    return phone_recording(phone, lambda: out, metres_per_unit=metres_per_unit, camera=camera)


def _depth(folder: Path, path: Path) -> np.ndarray:
    """Depth in millimetres, without what is of low confidence."""
    confidence = folder / f"confidence/{path.stem}.png"
    confident = read_confidence(confidence if has_confidence(folder) else None)
    return stored_units(read_depth_file(path), None, confident)


@dataclass(frozen=True)
class Row:
    """A row of the odometry.

    Attributes:
        timestamp_s: time of the frame.
        pose: scene_from_camera in OpenCV's axes.
    """

    timestamp_s: float
    pose: Transform | None


def read_odometry(path: Path) -> Mapping[int, Row]:
    """Time and pose by the number of the frame; rows that are not whole are left out.

    Raises:
        DataError: the first line does not name the columns.
    """
    if not path.is_file():
        return {}
    lines = csv.reader(read_text(path, errors="replace").splitlines())
    names = [cell.strip().lower() for cell in next(lines, [])]
    wanted = ("timestamp", "frame", *_POSE)
    if not set(wanted) <= set(names):
        named = ", ".join(names)[:200]
        raise DataError(f"{path}: expected a first line with {', '.join(wanted)}; found {named}")
    columns = [names.index(name) for name in wanted]
    found: dict[int, Row] = {}
    for line in lines:
        try:
            values = [plain_number(float, line[column]) for column in columns]
        except (ValueError, IndexError):  # cut off in the middle
            continue
        norm = math.hypot(*values[5:])
        if all(map(math.isfinite, values)) and len(line) == len(names) and 0.9 < norm < 1.1:
            pose = from_quaternion_xyzw(np.array(values[5:]), np.array(values[2:5]))
            found[int(values[1])] = Row(values[0], pose)
    return found

"""LabelFusion's log directories, once the images were extracted from the log.

::

    <log>/posegraph.posegraph                 TUM lines, scene_from_camera (scene = the first camera)
          posegraph_smoothed.posegraph        preferred where it is there
          images/0000000001_rgb.png
                 0000000001_depth.png         16 bit, millimetres; only when extracted with depth
                 0000000001_utime.txt         time in microseconds
                 0000000001_poses.yaml        by object: label, num_pixels, pose
                                              [[x, y, z], [qw, qx, qy, qz]], camera_from_object, metres;
                                              only objects that are visible

The camera is stored nowhere: LabelFusion itself assumes f = 528 px and the centre (320, 240) for all. A mesh
that
was an .obj is rotated by -90 degrees about x relative to the poses (LabelFusion issue 56).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import read_text
from rpl_data.formats.recordings.camera_file import told_of
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    grouped,
    match_poses,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.formats.recordings.pose_lines import read_pose_rows
from rpl_data.formats.recordings.scene_folders import chosen, folders_in, scene_folders
from rpl_data.formats.recordings.times import Clock, clock_beside, clock_of
from rpl_data.formats.recordings.true_poses import with_true_poses
from rpl_data.geometry import Transform, from_quaternion_xyzw
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.yaml_text import read_yaml

METRES_PER_UNIT = 0.001
CAMERA: Camera = (528.0, 528.0, 320.0, 240.0)
"""LabelFusion's assumed camera, for 640 x 480 images of an Asus Xtion."""

POSE_GRAPHS = ("posegraph_smoothed.posegraph", "posegraph.posegraph")

_COLOR = re.compile(r"(\d{10})_rgb\.png")


def read_labelfusion(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one log, or the logs of a folder, sorted by name.

    `Frame.index` is the number of the file, from 1. The poses of the objects are `Recording.true_poses`.

    Args:
        path: a log directory, or a folder of them.
        names: which logs to read, by folder name.
        metres_per_unit: unit of the depth images; 0.001 by the format.
        camera: camera of the colour images; LabelFusion's own when not given, which `Recording.notes` says.

    Raises:
        DataError: there is no log, its images were not extracted with depth, or no frame is complete.
    """
    path = path.absolute()
    found = scene_folders(path, is_log)
    if not found:
        packed = any(any(folder.glob("*.lcmlog")) for folder in (path, *folders_in(path)))
        todo = "; extract them from the log with LabelFusion (run_create_data -d)" if packed else ""
        raise DataError(f"{path} has no images/<number>_rgb.png, and neither has any folder in it{todo}")
    return [
        _read_log(name, folder, metres_per_unit, camera)
        for name, folder in chosen(found, names, path).items()
    ]


def is_log(folder: Path) -> bool:
    """Whether the folder is a log directory with images."""
    images = folder / "images"
    return images.is_dir() and any(_COLOR.fullmatch(found.name) for found in images.iterdir())


def _read_log(name: str, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    colors = {int(m[1]): p for p in sorted((folder / "images").iterdir()) if (m := _COLOR.fullmatch(p.name))}
    if not any(_beside(color, "depth.png").exists() for color in colors.values()):
        raise DataError(
            f"{folder / 'images'} holds no depth images; extract them again with depth (run_create_data -d)"
        )
    stored = {number: _time(_beside(color, "utime.txt")) for number, color in colors.items()}
    timed = {number: time for number, time in stored.items() if time is not None}
    if not timed:
        raise DataError(f"{folder / 'images'}: no frame has a readable utime.txt; extract the images again")
    told = told_of(folder, camera=camera, metres_per_unit=unit_m)
    clock = _clock(folder, list(timed.values()))
    listing = Listing(
        name,
        folder,
        "labelfusion",
        [
            Pair(n, time * clock.unit_s, colors[n], _beside(colors[n], "depth.png"))
            for n, time in timed.items()
        ],
        told.camera or _usual_camera(folder, colors),
        told.source if told.camera else folder,
        METRES_PER_UNIT if told.metres_per_unit is None else told.metres_per_unit,
        notes=(
            *(() if told.camera else ("no camera stored: LabelFusion's own f = 528 px assumed",)),
            *((clock.note,) if clock.note else ()),
        ),
        skipped=tuple(grouped(sorted(stored.keys() - timed.keys()), "without a readable utime.txt")),
    )
    recording = _with_trajectory(examine(listing), folder)
    return with_true_poses(recording, _object_poses(colors))


def _usual_camera(folder: Path, colors: Mapping[int, Path]) -> Camera:
    """Return LabelFusion's camera; DataError for images of another size."""
    sizes = {(found.width, found.height) for found in map(probe, colors.values()) if found is not None}
    if sizes - {(640, 480)}:
        width, height = max(sizes - {(640, 480)})
        raise DataError(
            f"{folder}: LabelFusion's camera is for 640 x 480 images, these are {width} x {height}; "
            "give `camera: [fx, fy, cx, cy]`"
        )
    return CAMERA


def _beside(color: Path, ending: str) -> Path:
    return color.with_name(color.name.replace("rgb.png", ending))


def _clock(folder: Path, times: Sequence[float]) -> Clock:
    """Microseconds, as the format says, unless the frames' usual step says otherwise."""
    source = folder / "images" / "*_utime.txt"
    found = clock_of(times, source)
    return replace(found, note="") if found.unit_s == 1e-6 else found if found.note else Clock(1e-6)


def _time(path: Path) -> float | None:
    """Read the time of a frame as it is stored; None where it is missing or cut off."""
    try:
        return float(int(read_text(path).strip()))
    except (DataError, ValueError):
        return None


def _with_trajectory(recording: Recording, folder: Path) -> Recording:
    graph = next((folder / name for name in POSE_GRAPHS if (folder / name).exists()), None)
    if graph is None:
        return without_poses(recording, "posegraph.posegraph")
    rows, frames = read_pose_rows(graph), recording.scene.frames
    stamps_s = np.array([frame.timestamp_s for frame in frames])
    clock = clock_beside(rows.times.tolist(), stamps_s.tolist(), Clock(1.0), graph)
    matched = match_poses(
        rows.times * clock.unit_s, rows.poses, [frame.index for frame in frames], stamps_s, source=str(graph)
    )
    known = replace(recording, skipped=(*recording.skipped, *rows.lost))
    return with_poses(known, matched, without=f"without a pose in {graph.name} at their time")


def _object_poses(colors: Mapping[int, Path]) -> dict[str, dict[int, Transform]]:
    """Read camera_from_object by object and frame."""
    poses: dict[str, dict[int, Transform]] = {}
    for number, color in colors.items():
        path = _beside(color, "poses.yaml")
        for name, entry in (_read_yaml(path) if path.exists() else {}).items():
            try:
                position_m, wxyz = (np.array(part, dtype=np.float64) for part in entry["pose"])
                pose = from_quaternion_xyzw(np.roll(wxyz, -1), position_m)
            except (KeyError, TypeError, ValueError) as error:
                raise DataError(
                    f"{path}: {name} should have pose [[x, y, z], [qw, qx, qy, qz]]; {error!r}"
                ) from error
            poses.setdefault(str(name), {})[number] = pose
    return poses


def _read_yaml(path: Path) -> Mapping[str, Any]:
    content: object = read_yaml(read_text(path), source=str(path))
    if content is not None and not isinstance(content, dict):
        raise DataError(f"{path}: expected objects by name, found {type(content).__name__}")
    return content or {}

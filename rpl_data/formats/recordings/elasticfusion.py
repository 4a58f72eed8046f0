"""Files that ElasticFusion reads and writes: a log (.klg), its camera, and the trajectory it found.

::

    <name>.klg             all frames, see `klg`
    <name>.klg.freiburg    TUM lines "t tx ty tz qx qy qz qw", scene_from_camera, t in seconds
    <name>.cal             "fx fy cx cy"; or camera.txt, for all logs of the folder
    <name>.klg.ply         the fused surface, in the frame of the first camera

ElasticFusion never processes the last frame, and skips others when told so; hence poses are matched by time.
Run with -icl, it writes the log's numbers unchanged instead of seconds. The .freiburg file of a run that was
killed is empty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64

from rpl_data.formats.containers.klg import (
    METRES_PER_UNIT,
    KlgIndex,
    index_klg,
    klg_color,
    klg_depth_mm,
    klg_image_size,
)
from rpl_data.formats.recordings.camera_file import Told, read_camera, told_of
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
from rpl_data.formats.recordings.pose_lines import PoseRows, nearest, read_pose_rows
from rpl_data.formats.recordings.saved_images import write_images
from rpl_data.formats.recordings.scene_folders import chosen
from rpl_data.formats.recordings.times import (
    FRAME_RATE_HZ,
    USUAL_STEPS_S,
    clock_of,
    refuse_jumping,
)
from rpl_data.geometry import Transform
from rpl_data.types import DataError, Recording

_MICROSECOND = 1e-6
_LONGEST_STEP_S = 2.0
"""A log of ElasticFusion's is a film: of frames farther apart than this, the unit is another one."""
_DATES_S = (1e9, 2.2e9)
"""Seconds since 1970 in the years 2001 to 2039."""


def read_klg(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
    bgr: bool = False,
) -> list[Recording]:
    """Read the logs of a folder, or one log, and unpack their images; a scene is named after its log.

    `Frame.index` is the frame's position in the log.

    Args:
        path: a .klg file, or a folder of them.
        unpack: returns the folder for the images of a scene, given its name.
        names: which logs to read, without .klg.
        metres_per_unit: unit of the depth; that of <name>.cal or camera.txt when not given, else 0.001.
        camera: used instead of <name>.cal or camera.txt beside the log.
        bgr: order of the colours, see `klg_color`.

    Raises:
        DataError: there is no log, no camera, or no complete frame.
    """
    path = path.absolute()
    logs = sorted(path.glob("*.klg")) if path.is_dir() else [path]
    found = chosen({log.stem: log for log in logs}, names, path)
    if not found:
        raise DataError(f"{path} holds no .klg file")
    return [_read_log(name, log, unpack(name), metres_per_unit, camera, bgr) for name, log in found.items()]


def _read_log(
    name: str, log: Path, folder: Path, unit_m: float | None, camera: Camera | None, bgr: bool
) -> Recording:
    index = index_klg(log)
    stored = np.array([entry.time for entry in index.entries], dtype=float)
    unit_s, notes = _unit_s(log, stored)
    told = _told_of(log, camera, unit_m)
    pairs, broken = _unpack(log, index, stored * unit_s, folder, bgr)
    listing = Listing(
        name,
        log,
        "klg",
        pairs,
        told.camera or (),
        told.source,
        METRES_PER_UNIT if told.metres_per_unit is None else told.metres_per_unit,
        notes=notes,
        skipped=(*_loss(index), *broken),
    )
    recording = examine(listing)
    poses = log.with_name(f"{log.name}.freiburg")
    if not poses.exists():
        return without_poses(recording, poses.name)
    rows = read_pose_rows(poses)
    recording = replace(recording, skipped=(*recording.skipped, *rows.lost))
    matched = _match(poses, rows, stored, unit_s, [frame.index for frame in recording.scene.frames])
    return with_poses(recording, matched, without=f"without a pose in {poses.name} at their time")


def _loss(index: KlgIndex) -> list[str]:
    """Describe what a log that was cut off has lost."""
    whole, promised = len(index.entries), index.promised
    if promised > whole:
        return [f"{promised - whole} of {promised} frames: the log was cut off after frame {whole - 1}"]
    if index.lost_bytes:
        return [f"the log was cut off in the middle of frame {whole}: its {index.lost_bytes} bytes are lost"]
    return []


def _unit_s(log: Path, stored: Float64[np.ndarray, " n"]) -> tuple[float, tuple[str, ...]]:
    """Seconds per unit of the stored times, which are microseconds by the format, and a note where not.

    png_to_klg stores the digits of the time it read, without the point: seconds that do not have six decimals
    are then not microseconds. Times since 1970 tell their unit by their size, others by their usual step as
    in all formats, or else by the power of ten that comes nearest to 30 frames per second.
    """
    refuse_jumping(stored.tolist(), log)
    step = float(np.median(np.abs(np.diff(stored)))) if len(stored) > 1 else 0.0
    if step == 0:
        return _MICROSECOND, ()
    dated = [10.0**-digits for digits in range(10) if _DATES_S[0] < stored[0] * 10.0**-digits < _DATES_S[1]]
    clock = clock_of(stored.tolist(), log)
    if dated and USUAL_STEPS_S[0] <= step * dated[0] <= USUAL_STEPS_S[1]:
        unit_s = dated[0]
    elif clock.note and step * clock.unit_s <= _LONGEST_STEP_S:
        unit_s = clock.unit_s
    else:
        unit_s = 10.0 ** -round(float(np.log10(step * FRAME_RATE_HZ)))
    if unit_s == _MICROSECOND:
        return unit_s, ()
    odd = f"times are not microseconds (frames would be {step * 1e-6:g} s apart)"
    return unit_s, (f"{odd}: units of {unit_s:.4g} s assumed",)


def _told_of(log: Path, camera: Camera | None, unit_m: float | None) -> Told:
    """Camera and depth unit of a log, by <name>.cal and camera.txt beside it; DataError without a camera."""
    path = log.with_suffix(".cal")
    own = read_camera(path) if path.exists() else None
    told = told_of(log.parent, camera=camera, metres_per_unit=unit_m, own=own, own_source=path)
    if told.camera is None:
        raise DataError(
            f"{log}: a log does not hold its camera; give `camera: [fx, fy, cx, cy]` in pixels, "
            f"or write these four numbers into {path.name} beside it"
        )
    return told


def _unpack(
    log: Path, index: KlgIndex, times_s: Float64[np.ndarray, " n"], folder: Path, bgr: bool
) -> tuple[list[Pair], list[str]]:
    """Write the images, one frame at a time; frames with damaged data are counted."""
    size = klg_image_size(log, index)
    pairs: list[Pair] = []
    broken: list[int] = []
    with log.open("rb") as file:
        for number in range(len(index.entries)):
            files = _unpack_frame(file, index, number, size, folder, bgr)
            if files is None:
                broken.append(number)
            else:
                pairs.append(Pair(number, float(times_s[number]), *files))
    return pairs, grouped(broken, "with damaged data in the log")


def _unpack_frame(
    file: BinaryIO, index: KlgIndex, number: int, size: tuple[int, int], folder: Path, bgr: bool
) -> tuple[Path, Path] | None:
    entry = index.entries[number]
    depth, color = klg_depth_mm(file, entry, size), klg_color(file, entry, size, bgr=bgr)
    if depth is None or color is None:
        return None
    return write_images(folder, number, color, depth, lossless=True)


def _match(
    poses: Path, rows: PoseRows, stored: Float64[np.ndarray, " n"], unit_s: float, numbers: Sequence[int]
) -> dict[int, Transform]:
    """Match a pose to each frame by time, on the clock that fits.

    ElasticFusion takes the log's times for microseconds, or with -icl writes them unchanged; other programs
    write true seconds.
    """
    times = stored[list(numbers)]
    clocks = (1 / _MICROSECOND, 1.0, 1 / unit_s)
    apart = [float(np.median(nearest(rows.times * clock, times)[1])) for clock in clocks]
    pose_times_s = rows.times * (clocks[int(np.argmin(apart))] * unit_s)
    return match_poses(pose_times_s, rows.poses, numbers, times * unit_s, source=str(poses))

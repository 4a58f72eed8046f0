"""Recordings of an Azure Kinect or an Orbbec Femto: .mkv of k4arecorder, read without the maker's SDK.

::

    track COLOR    MJPEG, NV12, YUY2 or BGRA, as tag K4A_COLOR_MODE says ("MJPG_1080P")
          DEPTH    16 bit, big-endian (b16g), millimetres, in the geometry of the depth camera; K4A_DEPTH_MODE
    attachment     calibration.json

PyAV takes the file apart; nothing is decoded by it, since all tracks hold plain pixels or JPEG files.
Sources: learn.microsoft.com, "Azure Kinect DK recording file format"; Azure-Kinect-Sensor-SDK, src/record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rpl_data.formats.containers.k4a_calibration import (
    COLOR_MODES,
    DEPTH_MODES,
    Mode,
    k4a_calibration,
)
from rpl_data.formats.containers.matroska import missing_bytes
from rpl_data.formats.recordings.color_lens import camera_numbers
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    grouped,
    without_poses,
)
from rpl_data.formats.recordings.partners import partners
from rpl_data.formats.recordings.saved_images import write_color, write_depth
from rpl_data.formats.recordings.scene_folders import chosen
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.child import in_child
from rpl_data.wording import counted

MEMORY_BYTES = 4 * 2**30
_UNPACKED = {"NV12": (3, 2, cv2.COLOR_YUV2RGB_NV12), "YUY2": (2, 1, cv2.COLOR_YUV2RGB_YUYV)}
"""Bytes per pixel as a fraction, and OpenCV's conversion to RGB."""


def read_kinect(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read the recordings of a folder, or one, and unpack their images; scenes are named after their files.

    Each file is read in a process of its own. Depth keeps its own camera, which the calibration in the file
    describes. Of a recording that was cut off or never closed, what is complete is kept.

    Args:
        path: an .mkv file, or a folder of them.
        unpack: returns the folder for the images of a scene, given its name.
        names: which recordings to read, without suffix.
        metres_per_unit: of the depth; 0.001 by the format.
        camera: used instead of the colour camera of the calibration.

    Raises:
        DataError: there is no recording, or it lacks colour, depth or its calibration.
    """
    path = path.absolute()
    files = sorted(path.glob("*.mkv")) if path.is_dir() else [path]
    recordings = chosen({file.stem: file for file in files}, names, path)
    if not recordings:
        raise DataError(f"{path} holds no .mkv file of an Azure Kinect")
    return [
        in_child(
            read_mkv, name, file, unpack(name), metres_per_unit, camera, file=file, memory_bytes=MEMORY_BYTES
        )
        for name, file in recordings.items()
    ]


def is_mkv(path: Path) -> bool:
    """Whether the path is a Matroska file."""
    return path.suffix == ".mkv" and path.is_file()


@dataclass(frozen=True)
class Tracks:
    """What the head of a file says.

    Attributes:
        color, depth: numbers of the tracks.
        color_format: MJPG, NV12, YUY2 or BGRA.
        delay_ns: how much later depth images are taken than colour images, on purpose.
        calibration: content of calibration.json.
        device: name for the report.
    """

    color: int
    depth: int
    color_format: str
    color_mode: Mode
    depth_mode: Mode
    delay_ns: int
    calibration: bytes
    device: str


def read_mkv(name: str, file: Path, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    """Read one file, as `read_kinect` does in a process of its own."""
    if not file.is_file():
        raise DataError(f"{file} does not exist; expected a recording of an Azure Kinect (.mkv)")
    missing = missing_bytes(file)
    if missing is None:
        raise DataError(f"{file} is no Matroska file; expected a recording of an Azure Kinect (.mkv)")
    tracks, times = survey_mkv(file)
    found = k4a_calibration(
        tracks.calibration, tracks.depth_mode, tracks.color_mode, source=f"{file}: calibration.json"
    )
    pairs, skipped = _unpack(file, folder, tracks, times)
    if missing:
        skipped.insert(0, f"{file.name} was cut off or never closed: what is complete is read")
    listing = Listing(
        name,
        file,
        "kinect",
        pairs,
        camera or camera_numbers(found.color),
        file,
        0.001 if unit_m is None else unit_m,
        depth_camera=camera_numbers(found.depth),
        color_from_depth=found.color_from_depth,
        notes=(tracks.device,),
        skipped=tuple(skipped),
    )
    return without_poses(examine(listing), "poses in an Azure Kinect's file")


def _packets(file: Path) -> Iterator[tuple[int, int, bytes]]:
    """Track, time in nanoseconds and content of each packet, as far as the file goes."""
    import av

    with av.open(str(file), metadata_errors="replace") as container:
        try:
            for packet in container.demux():
                if packet.pts is not None and packet.size:
                    time_ns = int(packet.pts * packet.time_base * 10**9)
                    yield packet.stream_index, time_ns, bytes(packet)
        except av.FFmpegError:
            return  # the rest is damaged or missing


def survey_mkv(file: Path) -> tuple[Tracks, Mapping[int, list[int]]]:
    """The tracks of a file, and the times of their packets in nanoseconds."""
    import av

    try:
        with av.open(str(file), metadata_errors="replace") as container:
            tracks = _tracks(container, file)
    except av.FFmpegError as error:
        raise DataError(f"{file} cannot be opened: {error}; record it again") from error
    times: dict[int, list[int]] = {tracks.color: [], tracks.depth: []}
    for track, time_ns, _ in _packets(file):
        if track in times:
            times[track].append(time_ns)
    return tracks, times


def _tracks(container: Any, file: Path) -> Tracks:
    streams = {str(stream.metadata.get("title", "")).upper(): stream for stream in container.streams}
    tags = dict(container.metadata)
    for stream in container.streams:
        tags |= stream.metadata
    if "COLOR" not in streams or "DEPTH" not in streams:
        found = ", ".join(filter(None, streams)) or "none"
        raise DataError(
            f"{file} has the tracks {found}; expected COLOR and DEPTH, as k4arecorder records them (without "
            "-d OFF and -c OFF)"
        )
    format, _, color = tags.get("K4A_COLOR_MODE", "").partition("_")
    depth = tags.get("K4A_DEPTH_MODE", "")
    if color not in COLOR_MODES or depth not in DEPTH_MODES or format not in ("MJPG", "BGRA", *_UNPACKED):
        raise DataError(
            f"{file}: modes {tags.get('K4A_COLOR_MODE')} and {depth or None} are not known; expected such as "
            "MJPG_1080P and NFOV_UNBINNED"
        )
    attached = [stream.data for stream in container.streams if stream.type == "attachment"]
    calibration = next((data for data in attached if b"CalibrationInformation" in data), None)
    if calibration is None:
        raise DataError(
            f"{file} holds no calibration.json, without which depth has no place; record it again"
        )
    serial = tags.get("K4A_DEVICE_SERIAL_NUMBER")
    delay = tags.get("K4A_DEPTH_DELAY_NS", "0")
    return Tracks(
        streams["COLOR"].index,
        streams["DEPTH"].index,
        format,
        COLOR_MODES[color],
        DEPTH_MODES[depth],
        int(delay) if delay.lstrip("-").isdigit() else 0,
        bytes(calibration),
        f"recorded by an Azure Kinect {serial or 'without serial number'}, {format}_{color}, {depth}",
    )


def _unpack(
    file: Path, folder: Path, tracks: Tracks, times: Mapping[int, list[int]]
) -> tuple[list[Pair], list[str]]:
    """Write the images that have a partner; also one line per kind of loss."""
    color_ns, depth_ns = (np.array(times[track], dtype=np.int64) for track in (tracks.color, tracks.depth))
    paired = partners(color_ns + tracks.delay_ns, depth_ns)
    color_job = {color: color for color in paired}, partial(_save_color, folder, tracks)
    depth_job = (
        {depth: color for color, depth in paired.items()},
        partial(_save_depth, folder, tracks.depth_mode),
    )
    saved = _saved(file, {tracks.color: color_job, tracks.depth: depth_job})
    colors, depths = saved[tracks.color], saved[tracks.depth]
    both = sorted(colors.keys() & depths.keys())
    if not both:
        raise DataError(f"{file} holds no complete colour image with a depth image at its time; record again")
    pairs = [Pair(index, float(color_ns[index]) * 1e-9, colors[index], depths[index]) for index in both]
    alone = len(color_ns) - len(paired)
    lines = [f"{counted(alone, 'colour image')} without depth at the same time"] if alone else []
    return pairs, lines + grouped(sorted(paired.keys() - set(both)), "with a damaged image in the file")


def _saved(
    file: Path, jobs: Mapping[int, tuple[Mapping[int, int], Callable[[int, bytes], Path | None]]]
) -> dict[int, dict[int, Path]]:
    """Save the packets of each track whose place in it has an index; the files by track and index."""
    saved: dict[int, dict[int, Path]] = {track: {} for track in jobs}
    places = {track: count() for track in jobs}
    for track, _, content in _packets(file):
        if track not in jobs:
            continue
        index_of, save = jobs[track]
        index = index_of.get(next(places[track]))
        path = None if index is None else save(index, content)
        if path is not None and index is not None:
            saved[track][index] = path
    return saved


def _save_color(folder: Path, tracks: Tracks, index: int, content: bytes) -> Path | None:
    width, height = tracks.color_mode.size
    if tracks.color_format == "MJPG":
        return write_color(folder, index, content) if content.startswith(b"\xff\xd8") else None
    data = np.frombuffer(content, np.uint8)
    if tracks.color_format == "BGRA":
        if len(data) != 4 * width * height:
            return None
        return write_color(folder, index, np.ascontiguousarray(data.reshape(height, width, 4)[..., 2::-1]))
    above, below, conversion = _UNPACKED[tracks.color_format]
    if len(data) * below != above * width * height:
        return None
    shape = (height * 3 // 2, width) if tracks.color_format == "NV12" else (height, width, 2)
    return write_color(folder, index, np.asarray(cv2.cvtColor(data.reshape(shape), conversion), np.uint8))


def _save_depth(folder: Path, mode: Mode, index: int, content: bytes) -> Path | None:
    width, height = mode.size
    if len(content) != 2 * width * height:
        return None
    return write_depth(folder, index, np.frombuffer(content, ">u2").reshape(height, width).astype(np.uint16))

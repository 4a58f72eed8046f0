"""Read recordings of RealSense cameras: .db3, and .bag of earlier versions. The file holds everything."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rpl_data.capture.camera import Shot
from rpl_data.capture.device import COLOR_FORMATS, choose, opened
from rpl_data.capture.streams import Streams
from rpl_data.formats.containers.db3 import repair_db3
from rpl_data.formats.containers.ros_topics import is_of_ros
from rpl_data.formats.containers.rosbag import repair_bag
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    without_poses,
)
from rpl_data.formats.recordings.saved_images import write_images
from rpl_data.formats.recordings.scene_folders import chosen
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.child import in_child

SUFFIXES = (".db3", ".bag")
GET_LIBREALSENSE = (
    "`pip install pyrealsense2`; no wheels for macOS and ARM: build librealsense for Python there"
)
PATIENCE_S = 10.0
"""A file whose next frame takes longer than this has no more frames."""


def read_realsense(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read the recordings of a folder, or one, and unpack their images; scenes are named after their files.

    Each file is read in a process of its own, since librealsense may end the process on a damaged one. Depth
    is moved onto the colour pixels. Of a recording that was cut off or never closed, what is whole
    is kept and the loss is named in `Recording.skipped`.

    Args:
        path: a .db3 or .bag file, or a folder of them.
        unpack: returns the folder for the images of a scene, given its name.
        names: which recordings to read, without suffix.
        metres_per_unit: used instead of the file's unit.
        camera: used instead of the file's camera.

    Raises:
        DataError: there is no recording, it lacks colour or depth, nothing of it is complete, or pyrealsense2
            is missing.
    """
    path = path.absolute()
    files = [found for found in sorted(path.iterdir()) if is_recording(found)] if path.is_dir() else [path]
    recordings = chosen({found.stem: found for found in files}, names, path)
    if not recordings:
        raise DataError(f"{path} holds no {' or '.join(SUFFIXES)} file")
    if find_spec("pyrealsense2") is None:
        raise DataError(f"{path} needs pyrealsense2, which is not installed; {GET_LIBREALSENSE}")
    return [
        in_child(_read_file, name, found, unpack(name), metres_per_unit, camera, file=found)
        for name, found in recordings.items()
    ]


def is_recording(path: Path) -> bool:
    """Whether the path has the suffix of such a recording, and is not one that ROS made."""
    return path.suffix in SUFFIXES and not is_of_ros(path)


def _read_file(name: str, file: Path, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    pairs: list[Pair] = []
    with playing(file, folder) as (shots, streams, lost):
        found = streams.camera
        for index, shot in enumerate(shots):
            files = write_images(folder, index, shot.color, shot.depth)
            pairs.append(Pair(index, shot.timestamp_s, *files))
        skipped = (*lost, *streams.counts.lines())
    if not pairs:
        raise DataError(f"{file} holds no colour image with depth at its time; record it again")
    lens = found.intrinsics
    listing = Listing(
        name,
        file,
        "realsense",
        pairs,
        camera or (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion),
        file,
        found.metres_per_unit if unit_m is None else unit_m,
        notes=(f"recorded by {found.name}", *found.notes),
        skipped=skipped,
    )
    return without_poses(examine(listing), "poses in a RealSense file")


@contextmanager
def playing(file: Path, scratch: Path) -> Iterator[tuple[Iterator[Shot], Streams, tuple[str, ...]]]:
    """Play a file: its image pairs, its streams, and what was lost; a repaired copy may be in `scratch`."""
    if not file.is_file():
        raise DataError(f"{file} does not exist; expected a recording of a RealSense camera")
    repaired = scratch / f"repaired{file.suffix}"
    try:
        device, lost = _loaded(file, repaired)
        playback = device.as_playback()
        playback.set_real_time(False)
        choices = _choices(playback, file)
        playback.pause()  # otherwise the first sensor plays before the second starts
        with opened(playback, choices, lossless=True) as streams:
            # Stopping waits for the first frames to be taken, which happens only after it has returned.
            resuming = threading.Thread(target=playback.resume)
            resuming.start()
            try:
                yield streams.shots(patience_s=PATIENCE_S, ended=lambda: _stopped(playback)), streams, lost
            finally:
                streams.close()
                resuming.join()
    finally:
        repaired.unlink(missing_ok=True)


def _stopped(playback: Any) -> bool:
    return str(playback.current_status().name) == "stopped"


def _loaded(file: Path, repaired: Path) -> tuple[Any, tuple[str, ...]]:
    """Load the device of a file, or of its repaired copy if the file itself cannot be played."""
    import pyrealsense2 as rs

    context = rs.context()
    try:
        return context.load_device(str(file)), ()
    except RuntimeError:
        lost = _repair(file, repaired)
    try:
        return context.load_device(str(repaired)), (lost,)
    except RuntimeError as error:
        raise DataError(f"{file} can be neither played nor repaired: {error}; record it again") from error


def _repair(file: Path, repaired: Path) -> str:
    """Write the repaired copy, and return a line about what was lost."""
    repaired.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".db3":
        kept = repair_db3(file, repaired)
        return f"{file.name} was cut off: the first {kept.seconds:.1f} s are complete, the rest is lost"
    bag = repair_bag(file, repaired)
    cut = f"{file.name} was never closed or cut off"
    return f"{cut}: what is complete is read, its first {bag.seconds:.1f} s"


def _choices(device: Any, file: Path) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Choose sensor and profile of colour and of depth."""
    found = {}
    for kind, formats in (("color", COLOR_FORMATS), ("depth", ("z16",))):
        for sensor in device.query_sensors():
            profile = choose(sensor.get_stream_profiles(), kind, formats)
            if profile is not None:
                found[kind] = (sensor, profile)
        if kind not in found:
            word = "colour" if kind == "color" else kind
            raise DataError(f"{file} holds no {word} stream; record depth and colour together")
    return found["color"], found["depth"]

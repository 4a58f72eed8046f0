"""Recordings that Luxonis' own programs make of OAK cameras: told apart, and refused with what to do instead.

::

    recording_<time>.tar           DepthAI 3, `pipeline.enableHolisticRecord` or DEPTHAI_RECORD:
        record_config.json           camera_info.json in newer versions
        <node>.mp4 (.avi), .mcap     one pair per camera: its video, and times and exposures as protobuf
    <number>-<device>/             depthai_sdk 1, `oak.record(..., RecordType.VIDEO)`, and depthai-record:
        calib.json                   the calibration, `eepromToJsonFile`
        color.mp4 left.mp4 ...       H.265, H.264 or MJPEG; also .hevc, .h264, .mjpeg

Neither holds depth: they keep what the cameras saw, and the device computes depth anew when that is played
back. The holistic recorder takes source nodes alone (Camera and IMU), and its video recorder turns other
images into 8-bit video. What depthai_sdk writes as MCAP or DB3 holds depth, and is read as `format: ros`; its
.bag holds depth without colour ("Color recording isn't yet possible").
Sources: luxonis/depthai-core, src/utility/PipelineImplHelper.cpp and src/pipeline/node/host/Record.cpp;
docs.luxonis.com, "Holistic Record and Replay"; luxonis/depthai, depthai_sdk/record.py and recorders/.
"""

from __future__ import annotations

import tarfile
from contextlib import suppress
from pathlib import Path

from rpl_data.files import FAULTS
from rpl_data.types import DataError

_MOST_MEMBERS = 100
"""An archive of the recorder has two or three files per camera, and the list of settings comes first."""

_SETTINGS = "record_config.json"
_CALIBRATION = "calib.json"
_VIDEOS = (".mp4", ".avi", ".hevc", ".h265", ".h264", ".mjpeg")


def refuse_oak(path: Path) -> None:
    """Raise a DataError, which says what to do, when the path is, or holds, such a recording."""
    places = [path, *sorted(path.iterdir())] if path.is_dir() else [path]
    for place in places:
        if is_holistic(place) or _is_of_sdk(place):
            raise DataError(
                f"{place} is a recording of an OAK camera without depth: it keeps the cameras' videos, from "
                "which the device computes depth when DepthAI plays them back. Record with `rpl capture "
                "--camera oak`, or with depthai-ros into a ROS bag; or play it back with DepthAI, write "
                "colour to rgb/ and depth, aligned to it, as 16-bit PNG to depth/, and give that folder"
            )


def is_holistic(place: Path) -> bool:
    """Whether a path is an archive of DepthAI 3's recorder, or was unpacked from one."""
    if place.is_dir():
        return (place / _SETTINGS).is_file() and _has_video(place)
    if place.suffix != ".tar" or not place.is_file():
        return False
    with suppress(tarfile.TarError, OSError, *FAULTS), tarfile.open(place, "r:") as archive:
        for _ in range(_MOST_MEMBERS):
            member = archive.next()
            if member is None:
                return False
            if member.name == _SETTINGS:
                return True
    return False


def _is_of_sdk(place: Path) -> bool:
    return place.is_dir() and (place / _CALIBRATION).is_file() and _has_video(place)


def _has_video(folder: Path) -> bool:
    return any(file.suffix in _VIDEOS for file in folder.iterdir())

"""Recordings in one file, and what reads them: ROS bags, Azure Kinect's and ScanNet's files."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bags import realsense
from kinect_writer import calibration, recorded
from sens_writer import write_sens

Parser = Callable[[Path], Any]


def container_seeds(folder: Path) -> Iterator[tuple[str, Path, Parser]]:
    """A good file of each kind, and what reads it, without the process of its own that a reader has."""
    from rpl_data.formats.containers.ros_topics import is_of_ros

    for suffix in ("bag", "db3", "mcap"):
        made = realsense(folder / f"ros_{suffix}.{suffix}", 2)
        bag = folder / f"whole.{suffix}"
        shutil.copy(made if made.is_file() else made / f"ros_{suffix}.{suffix}", bag)
        yield f"ROS {suffix}", bag, lambda path: _read_bag(path, folder / "out")
    ramp = np.arange(500, 500 + 64 * 48, dtype="<u4") % 701
    (folder / "depth.rvl").write_bytes(struct.pack("<iffII", 0, 0, 0, 64, 48) + ramp.tobytes())
    yield "RVL", folder / "depth.rvl", _read_rvl
    yield "H.264 of a topic", _h264(folder / "packets.h264"), _read_h264
    yield "whose db3", folder / "whole.db3", is_of_ros
    yield "whose bag", folder / "whole.bag", is_of_ros
    yield "Azure Kinect", recorded(folder / "kinect.mkv", 1), _survey_mkv
    (folder / "calibration.json").write_bytes(calibration())
    yield "Azure Kinect's calibration", folder / "calibration.json", _calibration
    yield "ScanNet", write_sens(folder / "scan.sens", count=2), lambda path: _read_sens(path, folder / "out")


def _read_bag(path: Path, out: Path) -> None:
    from rpl_data.formats.recordings.ros.read import read_bag
    from rpl_data.formats.recordings.ros.wanted import Topics

    read_bag("a", (path,), out, None, None, Topics())


def _h264(path: Path) -> Path:
    """Three pictures, of which the first stands for itself."""
    import av

    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.framerate = 64, 48, "yuv420p", 30
    noise = np.random.default_rng(0).integers(0, 255, (3, 48, 64, 3), np.uint8)
    pictures = [av.VideoFrame.from_ndarray(one, format="rgb24") for one in noise]
    packets = [packet for picture in [*pictures, None] for packet in encoder.encode(picture)]
    path.write_bytes(b"".join(map(bytes, packets)))
    return path


def _read_h264(path: Path) -> None:
    from rpl_data.formats.recordings.ros.video import Header, VideoDecoder, VideoPacket, size_of_video

    content = path.read_bytes()
    size_of_video(VideoPacket(Header("camera"), "h264", content))
    decoder = VideoDecoder("h264")
    for number, at in enumerate(range(0, len(content), 1500)):
        list(decoder.push(number, content[at : at + 1500]))
    list(decoder.flush())


def _read_rvl(path: Path) -> None:
    from types import SimpleNamespace

    from rpl_data.formats.recordings.ros.decode import depth_of, size_of

    for kind in ("16UC1", "32FC1"):
        data = np.frombuffer(path.read_bytes(), np.uint8)
        image = SimpleNamespace(format=f"{kind}; compressedDepth rvl", data=data)
        size_of(image)
        depth_of(image)


def _survey_mkv(path: Path) -> None:
    """All but moving depth, which takes a second and sees images of the right size only."""
    from rpl_data.formats.containers.matroska import missing_bytes
    from rpl_data.formats.recordings.kinect import survey_mkv

    missing_bytes(path)
    survey_mkv(path)


def _calibration(path: Path) -> None:
    from rpl_data.formats.containers.k4a_calibration import COLOR_MODES, DEPTH_MODES, k4a_calibration

    modes = DEPTH_MODES["NFOV_UNBINNED"], COLOR_MODES["720P"]
    found = k4a_calibration(path.read_bytes(), *modes, source=str(path))
    assert np.isfinite(found.color_from_depth).all()


def _read_sens(path: Path, out: Path) -> None:
    from rpl_data.formats.recordings.scannet import read_sens

    for recording in read_sens(path, unpack=lambda name: out):
        assert np.isfinite(recording.scene.intrinsics.fx)

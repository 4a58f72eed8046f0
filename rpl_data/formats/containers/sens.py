"""ScanNet's recordings (.sens): one file with all frames, their cameras and their poses.

::

    uint32 4 (version), uint64 length and bytes of the sensor's name
    4x4 float32, row by row: intrinsics and extrinsics of colour, intrinsics and extrinsics of depth
    int32 colour compression (0 raw, 1 PNG, 2 JPEG), int32 depth compression (0 raw, 1 zlib, 2 occi)
    uint32 width and height of colour, then of depth; float32 depth units per metre; uint64 number of frames
    per frame: 4x4 float32 camera-to-world, uint64 times of colour and depth in us, uint64 sizes of both, both
    inertial measurements, which are not read

Little-endian. A frame whose pose is lost has -inf in it.
Sources: ScanNet, SensReader/README.md and python/SensorData.py; BundleFusion, sensorData.h.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64, UInt16

from rpl_data.files import opened
from rpl_data.types import DataError

_LARGEST_SIDE_PX = 16384
_MATRICES = struct.Struct("<64f")
_IMAGES = struct.Struct("<iiIIIIfQ")
_FRAME = struct.Struct("<16f4Q")


@dataclass(frozen=True)
class SensFrame:
    """Position of a frame in the file, and what is said of it.

    Attributes:
        color_at: offset of the colour image; depth follows it.
        time_us: time of the colour image.
    """

    scene_from_camera: tuple[float, ...]
    time_us: int
    color_at: int
    color_bytes: int
    depth_bytes: int


@dataclass(frozen=True)
class Sens:
    """The head of a recording and all complete frames.

    Attributes:
        color, depth: 4x4 intrinsics.
        one_place: whether the extrinsics say that the two cameras are in one place.
        units_per_metre: of the stored depth.
        promised: the number of frames in the head.
    """

    sensor: str
    color: Float64[np.ndarray, "4 4"]
    depth: Float64[np.ndarray, "4 4"]
    one_place: bool
    is_raw_color: bool
    is_zlib: bool
    color_px: tuple[int, int]
    depth_px: tuple[int, int]
    units_per_metre: float
    promised: int
    frames: tuple[SensFrame, ...]


def index_sens(path: Path) -> Sens:
    """Find the frames without decoding them.

    Raises:
        DataError: the file is missing, or is no such recording with a complete frame.
    """
    with opened(path) as file:
        return _index(file, path)


def _index(file: BinaryIO, path: Path) -> Sens:
    size = file.seek(0, 2)
    file.seek(0)
    version, length = struct.unpack("<IQ", file.read(12).ljust(12, b"\0"))
    if version != 4 or length > 1000:
        raise DataError(
            f"{path} is no ScanNet recording (.sens, version 4), or of a version that is not known"
        )
    sensor = file.read(length).decode("ascii", "replace")
    head = file.read(_MATRICES.size + _IMAGES.size)
    if len(head) < _MATRICES.size + _IMAGES.size:
        raise DataError(f"{path} was cut off within its head; nothing of it can be kept")
    matrices = np.array(_MATRICES.unpack_from(head), float).reshape(4, 4, 4)
    color, depth, cw, ch, dw, dh, units, promised = _IMAGES.unpack_from(head, _MATRICES.size)
    if not np.isfinite(matrices).all() or not 0 < units < 1e6:
        raise DataError(f"{path} is damaged: its cameras are no numbers; copy it again")
    if not all(0 < side <= _LARGEST_SIDE_PX for side in (cw, ch, dw, dh)):
        raise DataError(f"{path} is damaged: images of {cw} x {ch} and {dw} x {dh} px; copy it again")
    if color not in (0, 1, 2) or depth not in (0, 1):
        raise DataError(
            f"{path}: colour of compression {color} and depth of compression {depth} cannot be read; "
            "expected JPEG or PNG, and zlib: export the frames with ScanNet's SensReader"
        )
    frames = _frames(file, size, promised, 3 * cw * ch if color == 0 else None)
    if not frames:
        raise DataError(f"{path} holds no complete frame; copy it again")
    one_place = bool(np.allclose(matrices[1], matrices[3], atol=1e-4))
    return Sens(
        sensor,
        matrices[0],
        matrices[2],
        one_place,
        color == 0,
        depth == 1,
        (cw, ch),
        (dw, dh),
        units,
        promised,
        tuple(frames),
    )


def _frames(file: BinaryIO, size: int, promised: int, raw_bytes: int | None) -> list[SensFrame]:
    """Walk over the frames as far as they are complete."""
    frames: list[SensFrame] = []
    while len(frames) < promised:
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            break
        *pose, time_us, _, color, depth = _FRAME.unpack(head)
        at = file.tell()
        if color + depth > size - at or (raw_bytes is not None and color != raw_bytes):
            break
        frames.append(SensFrame(tuple(pose), time_us, at, color, depth))
        file.seek(at + color + depth)
    return frames


def sens_color(file: BinaryIO, sens: Sens, frame: SensFrame) -> np.ndarray | bytes | None:
    """The colour of a frame: the JPEG or PNG it was stored as, or RGB; None when it is damaged."""
    file.seek(frame.color_at)
    stored = file.read(frame.color_bytes)
    if not sens.is_raw_color:
        return stored if stored.startswith((b"\xff\xd8", b"\x89PNG")) else None
    width, height = sens.color_px
    return np.frombuffer(stored, np.uint8).reshape(height, width, 3)


def sens_depth(file: BinaryIO, sens: Sens, frame: SensFrame) -> UInt16[np.ndarray, "height width"] | None:
    """The depth of a frame in its stored unit; None when it is damaged."""
    file.seek(frame.color_at + frame.color_bytes)
    stored = file.read(frame.depth_bytes)
    width, height = sens.depth_px
    if sens.is_zlib:
        try:  # never more than the image has: a few bytes may unpack to gigabytes
            stored = zlib.decompressobj().decompress(stored, 2 * width * height + 1)
        except zlib.error:
            return None
    if len(stored) != 2 * width * height:
        return None
    return np.frombuffer(stored, "<u2").reshape(height, width).astype(np.uint16)

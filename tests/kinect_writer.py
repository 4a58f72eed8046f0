"""Writes what k4arecorder writes: a Matroska file with two tracks, tags and the calibration, by hand."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np

DEPTH_LENS = [
    0.5122697949409485, 0.49451231956481934, 0.4921168386936188, 0.4921667277812958, 3.1305770874023438,
    2.324939012527466, 0.1304156482219696, 3.458651542663574, 3.350114583969116, 0.6629416346549988, 0, 0,
    -0.0000511557373101823, 0.00008132171933539212,
]  # fmt: skip
COLOR_LENS = [
    0.4967627227306366, 0.5108628273010254, 0.470907062292099, 0.6274453997612, 0.7227460145950317,
    -2.8855903148651123, 1.6327226161956787, 0.6021990180015564, -2.7196261882781982, 1.565053105354309, 0, 0,
    -0.0001431911950930953, 0.0007828465895727277,
]  # fmt: skip
"""Of a device, with what its SDK makes of it: github.com/panispani/3DReconstruct, pointCloudGen/calib.md."""


def camera(location: str, lens: list[float], size: tuple[int, int], place: list[float]) -> dict[str, Any]:
    model = {"ModelType": "CALIBRATION_LensDistortionModelBrownConrady", "ModelParameters": lens}
    turned = {"Rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "Translation": place}
    where = f"CALIBRATION_CameraLocation{location}"
    return {
        "Intrinsics": model, "Location": where, "Rt": turned, "SensorWidth": size[0], "SensorHeight": size[1]
    }  # fmt: skip


def calibration(color_lens: list[float] = COLOR_LENS, color_size: tuple[int, int] = (4096, 3072)) -> bytes:
    cameras = [
        camera("D0", DEPTH_LENS, (1024, 1024), [0, 0, 0]),
        camera("PV0", color_lens, color_size, [-0.032, -0.002, 0.004]),
    ]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras}}).encode()


# A Matroska file ----------------------------------------------------------------------------------


def element(number: int, content: bytes) -> bytes:
    return number.to_bytes((number.bit_length() + 7) // 8) + (len(content) | 1 << 56).to_bytes(8) + content


def whole(value: int) -> bytes:
    return value.to_bytes(max(1, (value.bit_length() + 7) // 8))


def track(number: int, name: str, codec: str, size: tuple[int, int], fourcc: bytes) -> bytes:
    video = element(0xB0, whole(size[0])) + element(0xBA, whole(size[1]))
    bitmap = struct.pack("<IiiHH4sIiiII", 40, *size, 1, 16, fourcc, 0, 0, 0, 0, 0)
    return element(
        0xAE,
        element(0xD7, whole(number))
        + element(0x73C5, whole(number))
        + element(0x83, b"\1")
        + element(0x86, codec.encode())
        + element(0x63A2, bitmap)
        + element(0x536E, name.encode())
        + element(0xE0, video),
    )


def tag(name: str, value: str) -> bytes:
    simple = element(0x67C8, element(0x45A3, name.encode()) + element(0x4487, value.encode()))
    return element(0x7373, element(0x63C0, b"") + simple)


def write_mkv(
    path: Path,
    frames: list[tuple[int, list[tuple[int, bytes]]]],
    *,
    tags: dict[str, str],
    attached: bytes | None = None,
    names: tuple[str, str] = ("COLOR", "DEPTH"),
) -> Path:
    """`frames`: time in ms, and its blocks, each with the number of its track and its bytes."""
    head = element(0x4282, b"matroska") + element(0x4287, b"\4") + element(0x4285, b"\2")
    info = element(0x2AD7B1, whole(1_000_000)) + element(0x4D80, b"test") + element(0x5741, b"test")
    color, depth = (1280, 720), (320, 288)
    tracks = track(1, names[0], "V_MS/VFW/FOURCC", color, b"MJPG")
    tracks += track(2, names[1], "V_MS/VFW/FOURCC", depth, b"b16g")
    file = element(0x466E, b"calibration.json") + element(0x4660, b"application/octet-stream")
    file += element(0x465C, calibration() if attached is None else attached) + element(0x46AE, b"\7")
    segment = element(0x1549A966, info) + element(0x1654AE6B, tracks)
    segment += element(0x1941A469, element(0x61A7, file)) if attached != b"" else b""
    segment += element(0x1254C367, b"".join(tag(*pair) for pair in tags.items()))
    for at_ms, blocks in frames:
        content = b"".join(
            element(0xA3, bytes([0x80 | number]) + struct.pack(">hB", 0, 0x80) + block)
            for number, block in blocks
        )
        segment += element(0x1F43B675, element(0xE7, whole(at_ms)) + content)
    path.write_bytes(element(0x1A45DFA3, head) + element(0x18538067, segment))
    return path


MODES = {"K4A_COLOR_MODE": "MJPG_720P", "K4A_DEPTH_MODE": "NFOV_2X2BINNED", "K4A_DEPTH_DELAY_NS": "0"}
RED = np.full((720, 1280, 3), (200, 30, 30), np.uint8)
JPEG = cv2.imencode(".jpg", RED[..., ::-1])[1].tobytes()
WALL = np.full((288, 320), 800, ">u2")


def recorded(path: Path, count: int = 3, color: bytes = JPEG, **tags: str) -> Path:
    frames = [(33 * n, [(1, color), (2, (WALL + n).astype(">u2").tobytes())]) for n in range(count)]
    return write_mkv(path, frames, tags=MODES | tags)

"""Writes ScanNet's .sens files."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from recordings import LENS, color_image, depth_image, poses

LOST = np.full((4, 4), -np.inf)


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def write_sens(
    path: Path,
    *,
    count: int = 4,
    kinds: tuple[int, int] = (2, 1),
    depth_step: int = 1,
    lost: tuple[int, ...] = (),
    times: bool = True,
    depth_place: np.ndarray = np.eye(4),  # noqa: B008
    still: bool = False,
) -> Path:
    """`depth_step`: every so many pixels of the depth image are stored, as a camera of fewer pixels would."""
    fx, fy, cx, cy = LENS
    half = (fx / depth_step, fy / depth_step, (cx + 0.5) / depth_step - 0.5, (cy + 0.5) / depth_step - 0.5)
    matrices = (intrinsics(*LENS), np.eye(4), intrinsics(*half), depth_place)
    name = b"StructureSensor"
    content = struct.pack("<IQ", 4, len(name)) + name
    content += b"".join(matrix.astype("<f4").tobytes() for matrix in matrices)
    size = 64 // depth_step, 48 // depth_step
    content += struct.pack("<iiIIIIfQ", *kinds, 64, 48, *size, 1000.0, count)
    for number in range(count):
        rgb = color_image(number)
        suffix = {1: ".png", 2: ".jpg"}.get(kinds[0])
        color = rgb.tobytes() if suffix is None else cv2.imencode(suffix, rgb[..., ::-1])[1].tobytes()
        depth = depth_image(number)[::depth_step, ::depth_step].astype("<u2").tobytes()
        depth = zlib.compress(depth) if kinds[1] == 1 else depth
        pose = LOST if number in lost else poses(count)[0 if still else number]
        time_us = 1_000_000 + 33_000 * number if times else 0
        content += pose.astype("<f4").tobytes() + struct.pack("<4Q", time_us, time_us, len(color), len(depth))
        content += color + depth
    path.write_bytes(content + struct.pack("<Q", 0))
    return path

"""A minimal OpenEXR file: one part of scan lines with one channel."""

from __future__ import annotations

import struct
import zlib

import numpy as np


def exr_bytes(image: np.ndarray, *, channel: str = "R", compression: int = 3) -> bytes:
    """The file of a float32 or float16 image; compression 0 = none, 2 = zip of a line, 3 = of 16 lines."""
    height, width = image.shape
    kind = 2 if image.dtype == np.float32 else 1
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = channel.encode() + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) + b"\0"
    attributes = {
        ("channels", "chlist"): channels,
        ("compression", "compression"): bytes([compression]),
        ("dataWindow", "box2i"): box,
        ("displayWindow", "box2i"): box,
        ("lineOrder", "lineOrder"): b"\0",
        ("pixelAspectRatio", "float"): struct.pack("<f", 1),
        ("screenWindowCenter", "v2f"): struct.pack("<2f", 0, 0),
        ("screenWindowWidth", "float"): struct.pack("<f", 1),
    }
    head = b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
    for (name, type_), value in attributes.items():
        head += name.encode() + b"\0" + type_.encode() + b"\0" + struct.pack("<I", len(value)) + value
    head += b"\0"
    lines = 16 if compression == 3 else 1
    blocks, offsets = b"", []
    start = len(head) + 8 * -(-height // lines)
    for row in range(0, height, lines):
        raw = image[row : row + lines].tobytes()
        packed = raw if compression == 0 else min(_zipped(raw), raw, key=len)
        offsets.append(start + len(blocks))
        blocks += struct.pack("<iI", row, len(packed)) + packed
    return head + struct.pack(f"<{len(offsets)}Q", *offsets) + blocks


def _zipped(raw: bytes) -> bytes:
    values = np.frombuffer(raw, np.uint8)
    split = np.concatenate([values[0::2], values[1::2]]).astype(np.int64)
    steps = split.copy()
    steps[1:] = split[1:] - split[:-1] + 128
    return zlib.compress((steps & 255).astype(np.uint8).tobytes())

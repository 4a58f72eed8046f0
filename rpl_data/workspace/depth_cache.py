"""Depth images packed so that reading them again costs a third of a PNG: differences along rows, zstd."""

from __future__ import annotations

import numpy as np

from rpl_data.types import DepthUnits

LEVEL = 1
"""Of zstd; higher ones save a few per cent of the bytes and cost more than the reading gains."""


def pack(units: DepthUnits) -> bytes:
    """A 16-bit image as bytes."""
    import zstandard

    steps = units.copy()
    steps[:, 1:] -= units[:, :-1]  # modulo 2^16
    return zstandard.ZstdCompressor(level=LEVEL, write_checksum=True).compress(steps.tobytes())


def unpack(packed: bytes, *, height: int, width: int) -> DepthUnits | None:
    """The image again; None where the bytes are broken or of an image of another size."""
    import zstandard

    try:
        steps = np.frombuffer(zstandard.ZstdDecompressor().decompress(packed), np.uint16)
    except zstandard.ZstdError:
        return None
    if steps.size != height * width:
        return None
    units: DepthUnits = np.cumsum(steps.reshape(height, width), axis=1, dtype=np.uint16)
    return units

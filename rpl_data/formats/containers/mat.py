"""MATLAB files of versions 5 to 7: arrays of numbers by name, with every size checked before it is believed.

SciPy's reader ends the process on some damaged files, so this is our own. Only what datasets store is
read: real arrays of numbers. Structures, cells, text and sparse arrays are passed over. Format: MathWorks,
"MAT-File Format", version 5; the files of version 7.3 are HDF5 and are refused.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from rpl_data.files import decoding, read_bytes

HEADER_BYTES = 128
LARGEST_BYTES = 256 * 2**20
"""An array is not larger when it is unpacked; a greater size is a fault."""
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
MATRIX, COMPRESSED = 14, 15
NUMERIC = range(6, 16)
"""Classes of arrays: double, single, and the whole numbers of 8 to 64 bits."""
NAME_WITHIN = 512
"""Bytes from the start of an array by which its name has ended; more need not be unpacked to pass it over."""


def read_mat(path: Path, names: Collection[str]) -> dict[str, np.ndarray]:
    """The arrays of these names that a file holds, as MATLAB shows them.

    Raises:
        DataError: the file is missing, damaged, or of version 7.3.
    """
    content = read_bytes(path)
    with decoding(path, "copy it again"):
        if content[124:128] not in (b"\x00\x01IM", b"\x01\x00MI"):
            raise ValueError("it has no header of a MATLAB file of version 5 to 7")
        order = "<" if content[126:128] == b"IM" else ">"
        found: dict[str, np.ndarray] = {}
        for kind, data in _elements(content[HEADER_BYTES:], order):
            array = _array(_unpacked(kind, data, order, names), order, names)
            if array is not None:
                found[array[0]] = array[1]
        return found


def _unpacked(kind: int, data: bytes, order: str, names: Collection[str]) -> bytes:
    """The content of an array; nothing where its name is none of `names`."""
    if kind == MATRIX:
        return data
    if kind != COMPRESSED:
        return b""
    start = zlib.decompressobj().decompress(data, NAME_WITHIN)
    if _name(start[8:], order) not in names:
        return b""
    unpacking = zlib.decompressobj()
    whole = unpacking.decompress(data, LARGEST_BYTES)
    if unpacking.unconsumed_tail:
        raise ValueError(f"an array is larger than {LARGEST_BYTES // 2**20} MB")
    (kind, data), *_ = _elements(whole, order)
    return data if kind == MATRIX else b""


def _name(start: bytes, order: str) -> str:
    """The name of an array, from its first bytes: flags, sizes, name."""
    at = 0
    for _ in range(3):
        (_, name), at = _element(start, at, order)
    return name.decode("ascii", "replace")


def _array(data: bytes, order: str, names: Collection[str]) -> tuple[str, np.ndarray] | None:
    """Name and values of an array; None for one that is not wanted or holds no real numbers."""
    if not data or _name(data, order) not in names:
        return None
    (_, flags), (_, sizes), (_, name), (kind, values), *rest = _elements(data, order)
    if flags[0 if order == "<" else 3] not in NUMERIC or rest or kind not in TYPES:
        return None
    shape = tuple(np.frombuffer(sizes, order + "i4").tolist())
    numbers = np.frombuffer(values, order + TYPES[kind])
    if len(shape) > 8 or min(shape, default=0) < 0 or int(np.prod(shape, dtype=object)) != len(numbers):
        raise ValueError(f"{name!r} has {len(numbers)} numbers, which are no array of {shape}")
    return name.decode("ascii", "replace"), numbers.reshape(shape, order="F")


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of the elements one after another."""
    at = 0
    while at + 8 <= len(data):
        element, at = _element(data, at, order)
        yield element


def _element(data: bytes, at: int, order: str) -> tuple[tuple[int, bytes], int]:
    """Type and content of the element at an offset, and the offset of the one behind it."""
    kind, size = struct.unpack_from(order + "II", data, at)
    if kind >> 16:  # a small element: type and size in one word, up to four bytes behind them
        kind, size, start, following = kind & 0xFFFF, kind >> 16, at + 4, at + 8
    else:
        start = at + 8
        following = start + (size if kind == COMPRESSED else -(-size // 8) * 8)
    if start + size > len(data):
        raise ValueError("it ends in the middle of an array")
    return (kind, data[start : start + size]), following

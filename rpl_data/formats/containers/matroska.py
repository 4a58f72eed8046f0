"""Is a Matroska file (.mkv) whole? Its outermost sizes tell, before any decoder sees it.

Format: RFC 8794 (EBML) and RFC 9559 (Matroska).
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

_EBML, _SEGMENT = 0x1A45DFA3, 0x18538067


def missing_bytes(path: Path) -> int | None:
    """How many bytes the file lacks: 0 for a whole one, -1 where its recorder never wrote the size.

    None where it is no Matroska file.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        head = _element(file)
        if head is None or head[0] != _EBML or head[1] is None or head[1] > size:
            return None
        file.seek(head[1], 1)
        segment = _element(file)
        if segment is None or segment[0] != _SEGMENT:
            return None
        return -1 if segment[1] is None else max(0, file.tell() + segment[1] - size)


def _element(file: BinaryIO) -> tuple[int, int | None] | None:
    """The number and the size of the element that starts here; a size of all ones means unknown."""
    number = _integer(file, keep_mark=True)
    size = _integer(file, keep_mark=False)
    if number is None or size is None:
        return None
    return number[0], None if size[0] == (1 << 7 * size[1]) - 1 else size[0]


def _integer(file: BinaryIO, *, keep_mark: bool) -> tuple[int, int] | None:
    """An integer of 1 to 8 bytes, whose first set bit says how many; also that number of bytes."""
    first = file.read(1)
    if not first or not first[0]:
        return None
    count = 9 - first[0].bit_length()
    rest = file.read(count - 1)
    if len(rest) < count - 1:
        return None
    value = int.from_bytes(first + rest)
    return (value if keep_mark else value & ((1 << 7 * count) - 1)), count

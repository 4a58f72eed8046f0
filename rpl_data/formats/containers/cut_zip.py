"""Members of a zip archive, also of one that was cut off and so has lost the list at its end.

Every member has a header of its own before its content (PKWARE's APPNOTE 4.3.7), which is enough to find what
is whole. Nothing is unpacked before its size is known to be allowed.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rpl_data.types import DataError

MOST_BYTES = 2**28
"""Largest member that is unpacked."""

ZIP_FAULTS = (
    zipfile.BadZipFile, RuntimeError, OSError, ValueError, KeyError, EOFError, struct.error, zlib.error
)  # fmt: skip
"""What zipfile raises for a damaged archive; RuntimeError for a password or a packing it does not know."""

_HEADER = struct.Struct("<4s5H3I2H")
_STORED, _DEFLATED = 0, 8
_SIZES_FOLLOW = 8
"""Flag of a member whose sizes stand behind its content instead of before it."""


@dataclass(frozen=True)
class Members:
    """What an archive, or a folder in its place, holds.

    Attributes:
        read: reads a member, by its name; DataError where it is damaged.
        lost: what was cut off, in words; empty for a whole archive.
    """

    read: dict[str, Callable[[], bytes]]
    lost: tuple[str, ...] = ()


def members_of(path: Path) -> Members:
    """The files of a zip archive, of one that was cut off, or of the folder it was unpacked to."""
    if path.is_dir():
        files = (file for file in path.rglob("*") if file.is_file())
        return Members({file.relative_to(path).as_posix(): file.read_bytes for file in files})
    try:
        with zipfile.ZipFile(path) as archive:
            names = [info.filename for info in archive.infolist() if not info.is_dir()]
        return Members({name: partial(_read, path, name) for name in names})
    except ZIP_FAULTS:
        return _salvaged(path)


def _read(path: Path, name: str) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            allowed = archive.getinfo(name).file_size <= MOST_BYTES
            content = archive.read(name) if allowed else b""
    except ZIP_FAULTS as error:
        raise _damaged(path, name, error) from error
    if not allowed:
        raise _too_large(path, name)
    return content


def _salvaged(path: Path) -> Members:
    """Walk from member to member as far as they are whole."""
    data = path.read_bytes()
    found: dict[str, Callable[[], bytes]] = {}
    at = 0
    while (member := _member(data, at)) is not None:
        name, content, method, at = member
        if not name.endswith("/"):
            found[name] = partial(_unpacked, path, name, content, method)
    if not found:
        raise DataError(f"{path} is no zip archive, or was cut off before its first file; copy it again")
    return Members(found, (f"{path.name} was cut off: {len(found)} files of it are whole",))


def _member(data: bytes, at: int) -> tuple[str, bytes, int, int] | None:
    """Name, packed content, method and end of the member at a position; None where it is not whole."""
    if len(data) < at + _HEADER.size:
        return None
    magic, _, flags, method, _, _, _, size, _, name_size, extra_size = _HEADER.unpack_from(data, at)
    start = at + _HEADER.size + name_size + extra_size
    if magic != b"PK\x03\x04" or method not in (_STORED, _DEFLATED):
        return None
    name = data[at + _HEADER.size : at + _HEADER.size + name_size].decode("utf-8", "replace")
    end = start + size
    behind = end
    if flags & _SIZES_FOLLOW and not size:
        end = data.find(b"PK\x07\x08", start)
        behind = end + 16
        if end < 0:
            return None
    if behind > len(data):
        return None
    return name, data[start:end], method, behind


def _unpacked(path: Path, name: str, content: bytes, method: int) -> bytes:
    """Unpack a member; DataError where it is damaged, ends too early or is too large."""
    if method == _STORED:
        return content
    unpacking = zlib.decompressobj(-15)
    try:
        unpacked = unpacking.decompress(content, MOST_BYTES)
    except zlib.error as error:
        raise _damaged(path, name, error) from error
    if unpacking.unconsumed_tail:
        raise _too_large(path, name)
    if not unpacking.eof:  # a packed byte sequence that looks like the mark behind a member
        raise _damaged(path, name, "its packed content ends too early")
    return unpacked


def _damaged(path: Path, name: str, why: object) -> DataError:
    return DataError(f"{path}: {name} is damaged: {why}; copy the file again")


def _too_large(path: Path, name: str) -> DataError:
    return DataError(f"{path}: {name} is larger than {MOST_BYTES} bytes; record it again")

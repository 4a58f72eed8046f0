"""Read the messages of an MCAP file, whole or cut off: ROS 2's recordings, and ROS 1's in this container.

An MCAP file is a list of records: a header, schemas, channels, and messages, most of them packed in chunks;
then a summary and a footer, written on closing. The package `rosbags` refuses files that were not closed,
that hold ROS 1 (depthai's recorder writes such), or one channel of another kind; going through the records
needs none of what is written at the end. Of a chunk that was cut, the messages before the cut are read.
Format: mcap.dev/spec. Second source: `rosbags.rosbag2.storage_mcap`.
"""

from __future__ import annotations

import importlib
import struct
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from rpl_data.files import FAULTS, decoding, refuse_special
from rpl_data.types import DataError

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15
_RECORD = struct.Struct("<BQ")
_FOOTER_BYTES = 20 + _RECORD.size + len(_MAGIC)
_LARGEST_CHUNK_BYTES = 2**29
"""Recorders close a chunk at about a megabyte; of no record more than this is read."""


@dataclass(frozen=True)
class McapMessage:
    """A message as it is stored.

    Attributes:
        topic: its topic.
        schema: name of its type, such as sensor_msgs/msg/Image or sensor_msgs/Image.
        encoding: cdr (ROS 2), ros1, or another one.
        log_ns: when the recorder received it, nanoseconds.
    """

    topic: str
    schema: str
    encoding: str
    log_ns: int
    raw: bytes


@dataclass
class McapFile:
    """An MCAP file; its channels become known as it is read.

    Attributes:
        damaged: number of chunks that could not be unpacked, in the last pass.
        is_closed: whether its recorder ended it.
    """

    path: Path
    damaged: int = 0
    is_closed: bool = False
    _schemas: dict[int, str] = field(default_factory=dict)
    _channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise a DataError when the path is no MCAP file."""
        refuse_special(self.path)
        with self.path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise DataError(f"{self.path} is not an MCAP file; expected a ROS 2 recording")
            end = file.seek(0, 2)
            file.seek(max(0, end - len(_MAGIC)))
            self.is_closed = end > _FOOTER_BYTES and file.read() == _MAGIC

    def topics(self) -> dict[str, tuple[str, str]]:
        """Type and encoding of each topic: from the summary, or else by going through the file."""
        with decoding(self.path, "record it again"), self.path.open("rb") as file:
            if not (self.is_closed and self._read_summary(file)):
                for _ in self.messages(()):
                    pass
        return {
            topic: (self._schemas.get(schema, ""), encoding)
            for schema, topic, encoding in self._channels.values()
        }

    def messages(self, topics: Collection[str]) -> Iterator[McapMessage]:
        """Go through the messages of some topics, in the order of the file, as far as they are complete."""
        self.damaged = 0
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            at = len(_MAGIC)
            file.seek(at)
            while (head := file.read(_RECORD.size)) and len(head) == _RECORD.size:
                kind, length = _RECORD.unpack(head)
                if kind in (_FOOTER, _DATA_END):
                    return
                at += _RECORD.size
                left = min(length, size - at)
                if kind == _CHUNK:
                    for inner, content in _records(self._chunk(file.read(min(left, _LARGEST_CHUNK_BYTES)))):
                        yield from self._take(inner, content, topics)
                elif length <= min(left, _LARGEST_CHUNK_BYTES) and kind in (_SCHEMA, _CHANNEL, _MESSAGE):
                    yield from self._take(kind, file.read(length), topics)
                at += left
                file.seek(at)

    def _take(self, kind: int, content: bytes, topics: Collection[str]) -> Iterator[McapMessage]:
        """Note a schema or a channel, or yield a message that is wanted."""
        with decoding(self.path, "record it again"):
            if kind == _SCHEMA:
                (number,) = struct.unpack_from("<H", content)
                self._schemas[number] = _strings(content[2:], 1)[0]
            elif kind == _CHANNEL:
                number, schema = struct.unpack_from("<HH", content)
                topic, encoding = _strings(content[4:], 2)
                self._channels[number] = (schema, "/" + topic.lstrip("/"), encoding)
            elif kind == _MESSAGE:
                number, _, log_ns = struct.unpack_from("<HIQ", content)
                schema, topic, encoding = self._channels.get(number, (0, "", ""))
                if topic in topics:
                    name = self._schemas.get(schema, "")
                    yield McapMessage(topic, name, encoding, log_ns, content[22:])

    def _read_summary(self, file: BinaryIO) -> bool:
        """Note the channels that the summary repeats; False when there is none."""
        end = file.seek(0, 2)
        file.seek(end - _FOOTER_BYTES + _RECORD.size)
        (start,) = struct.unpack("<Q", file.read(8))
        if not len(_MAGIC) < start < end:
            return False
        file.seek(start)
        for kind, content in _records(file.read(min(end - start, _LARGEST_CHUNK_BYTES))):
            for _ in self._take(kind if kind in (_SCHEMA, _CHANNEL) else 0, content, ()):
                pass
        return bool(self._channels)

    def _chunk(self, content: bytes) -> bytes:
        """The records of a chunk, unpacked as far as it goes; a few bytes never become gigabytes."""
        if len(content) < 40:
            return b""
        (promised,) = struct.unpack_from("<Q", content, 16)
        (name_bytes,) = struct.unpack_from("<I", content, 28)
        name = content[32 : 32 + min(name_bytes, 16)].decode("ascii", "replace")
        try:
            return _unpacked(content[32 + name_bytes + 8 :], name, min(promised, _LARGEST_CHUNK_BYTES))
        except (*FAULTS, RuntimeError, zstd().ZstdError):
            self.damaged += 1
            return b""


def zstd() -> Any:
    """The module that unpacks Zstandard: Python's own from 3.14 on, before that its backport."""
    return importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


def _unpacked(packed: bytes, compression: str, most: int) -> bytes:
    if compression == "lz4":
        frame = importlib.import_module("lz4.frame")
        return bytes(frame.LZ4FrameDecompressor().decompress(packed, most))
    if compression == "zstd":
        return bytes(zstd().ZstdDecompressor().decompress(packed, most))
    if compression:
        raise ValueError(f"unknown compression {compression}")
    return packed


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Kind and content of each complete record."""
    at = 0
    while at + _RECORD.size <= len(content):
        kind, length = _RECORD.unpack_from(content, at)
        at += _RECORD.size
        if at + length > len(content):
            return
        yield kind, content[at : at + length]
        at += length


def _strings(content: bytes, count: int) -> list[str]:
    """The strings at the start, each after its length."""
    found = []
    for _ in range(count):
        (length,) = struct.unpack_from("<I", content)
        found.append(content[4 : 4 + length].decode("utf-8", "replace"))
        content = content[4 + length :]
    return found

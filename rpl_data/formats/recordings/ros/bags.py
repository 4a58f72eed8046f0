"""Find the bags at a path, and go through the messages of one, whole or cut off, by the package `rosbags`.

::

    <name>.bag                          ROS 1
    <name>.db3  <name>.mcap             ROS 2, also packed as <name>.db3.zstd
    <name>/metadata.yaml                ROS 2: a folder is one bag, whose files follow one another
           <name>_0.mcap, <name>_1.mcap ...

metadata.yaml is written when the recorder ends, so a recorder that was killed leaves none. Files without it
are one bag where they are called as recorders call their parts: <name>_0, <name>_1 and so on without a gap.
Others, such as mug_1.bag and mug_2.bag, are a bag each.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rpl_data.files import FAULTS, writing
from rpl_data.formats.containers.db3 import repair_db3
from rpl_data.formats.containers.mcap import McapFile, zstd
from rpl_data.formats.containers.ros_topics import is_of_ros
from rpl_data.formats.containers.rosbag import repair_bag
from rpl_data.formats.recordings.scene_folders import folders_in
from rpl_data.types import DataError
from rpl_data.wording import counted

Result = TypeVar("Result")
SUFFIXES = (".bag", ".db3", ".mcap")
PACKED = ".zstd"
_CODINGS = ("cdr", "ros1")
_PART = re.compile(r"(.+)_(\d+)")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_UNPACKED_BYTES = 2**28
"""No message is larger; images of 8 megapixels take a tenth."""
_MOST_TIMES_LARGER = 200
"""A packed file that unpacks to more than this is made to fill disks."""


def bags_at(path: Path) -> dict[str, tuple[Path, ...]]:
    """The bags at a path by name, each with its files in order: a file, or a folder of files or of bags."""
    if not path.is_dir():
        return {_stem(path): (path,)} if is_ros_file(path) else {}
    places = [(path, _bags_in(path)), *((folder, _bags_in(folder)) for folder in folders_in(path))]
    often = Counter(name for _, bags in places for name in bags)
    return {
        f"{folder.name}_{name}" if often[name] > 1 else name: files
        for folder, bags in places
        for name, files in bags.items()
    }


def is_ros_file(path: Path) -> bool:
    """Whether the path has the suffix of a ROS bag and is not one of librealsense's own recordings."""
    if not path.name.removesuffix(PACKED).endswith(SUFFIXES) or not path.is_file():
        return False
    return path.suffix in (".mcap", PACKED) or is_of_ros(path)


def _bags_in(folder: Path) -> dict[str, tuple[Path, ...]]:
    files = sorted((path for path in folder.iterdir() if is_ros_file(path)), key=_in_order)
    if files and (folder / "metadata.yaml").exists():
        return {folder.name: tuple(files)}
    series: dict[str, list[Path]] = {}
    for file in files:
        part = _PART.fullmatch(_stem(file))
        series.setdefault(part[1] if part else _stem(file), []).append(file)
    bags: dict[str, tuple[Path, ...]] = {}
    for name, parts in series.items():
        if [_stem(file) for file in parts] == [f"{name}_{number}" for number in range(len(parts))]:
            bags[name] = tuple(parts)
        else:
            bags |= {_stem(file): (file,) for file in parts}
    return bags


def _stem(path: Path) -> str:
    return Path(path.name.removesuffix(PACKED)).stem


def _in_order(path: Path) -> tuple[str, int]:
    part = _PART.fullmatch(_stem(path))
    return (part[1], int(part[2])) if part else (_stem(path), -1)


class _RepairedError(Exception):
    """A file had to be repaired: what was read of it must be read again."""


@dataclass(frozen=True)
class Message:
    """A message as it is stored.

    Attributes:
        topic: its topic.
        type: its type as ROS 2 writes it, such as sensor_msgs/msg/Image.
        bag_ns: when the recorder received it, in nanoseconds.
        raw: its bytes.
        is_ros1: how they are encoded: ROS 1's way, else CDR.
    """

    topic: str
    type: str
    bag_ns: int
    raw: bytes
    is_ros1: bool


class Bag:
    """The files of a bag; those that cannot be read as they are get a repaired copy in `scratch`.

    Attributes:
        lost: one line per file that was cut off.
    """

    def __init__(self, files: Sequence[Path], scratch: Path) -> None:
        self._scratch = scratch
        self._copies: list[Path] = []
        self.lost: list[str] = []
        self._files = [self._unpacked(file) if file.suffix == PACKED else file for file in files]

    def close(self) -> None:
        """Delete the copies."""
        for copy in self._copies:
            copy.unlink(missing_ok=True)

    def mended(self, work: Callable[[Bag], Result]) -> Result:
        """Return `work(self)`, begun anew when it comes to a file that is damaged and had to be repaired."""
        while True:
            try:
                return work(self)
            except _RepairedError:
                continue

    def types(self) -> dict[str, str]:
        """The type of each topic."""
        found: dict[str, str] = {}
        for number, file in enumerate(self._files):
            if file.suffix == ".mcap":
                topics = McapFile(file).topics().items()
                found |= {topic: _type(name) for topic, (name, coding) in topics if coding in _CODINGS}
                continue
            with self._reading(number) as reader:
                found |= {_topic(one): str(one.msgtype) for one in reader.connections}
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Go through the messages of some topics, file by file."""
        for number, file in enumerate(self._files):
            if file.suffix == ".mcap":
                yield from self._mcap_messages(file, topics)
                continue
            with self._reading(number) as reader:
                wanted = [one for one in reader.connections if _topic(one) in topics]
                if wanted:
                    yield from _messages(reader, wanted, self._files[number].suffix == ".bag")

    def _mcap_messages(self, file: Path, topics: Collection[str]) -> Iterator[Message]:
        mcap = McapFile(file)
        for one in mcap.messages(topics):
            if one.encoding in _CODINGS:
                raw = _unpacked_message(one.raw)
                yield Message(one.topic, _type(one.schema), one.log_ns, raw, one.encoding == "ros1")
        if not mcap.is_closed:
            self._lose(f"{file.name} was never closed or cut off: what is complete is read")
        if mcap.damaged:
            self._lose(f"{counted(mcap.damaged, 'chunk')} of {file.name} damaged, with all messages in it")

    def _lose(self, line: str) -> None:
        if line not in self.lost:
            self.lost.append(line)

    @contextmanager
    def _reading(self, number: int) -> Iterator[Any]:
        """Open a file; when it cannot be read to its end, put a repaired copy in its place."""
        file = self._files[number]
        try:
            with closing(_opened(file)) as reader:
                yield reader
        except DataError:
            raise
        except _faults() as error:
            if file in self._copies and not file.name.startswith("unpacked"):
                raise DataError(f"{file} is damaged beyond repair: {error}; record it again") from error
            copy = self._copy("repaired", file)
            self._lose(_repair(file, copy))
            self._files[number] = copy
            raise _RepairedError from error

    def _copy(self, how: str, file: Path) -> Path:
        """A name for a copy of a file."""
        self._scratch.mkdir(parents=True, exist_ok=True)
        self._copies.append(self._scratch / f"{how}-{len(self._copies)}{file.suffix}")
        return self._copies[-1]

    def _unpacked(self, file: Path) -> Path:
        """Unpack a file that was packed as a whole; of one that was cut off, what there is."""
        copy = self._copy("unpacked", file.with_suffix(""))
        left = _MOST_TIMES_LARGER * file.stat().st_size
        decoder = zstd().ZstdDecompressor()
        with file.open("rb") as packed, writing(copy, "wb") as out:
            while left > 0 and not decoder.eof:
                part = packed.read(1 << 16) if decoder.needs_input else b""
                if decoder.needs_input and not part:
                    break  # it was cut off
                content = decoder.decompress(part, 1 << 20)
                out.write(content)
                left -= len(content)
        return copy


def _messages(reader: Any, connections: Sequence[Any], is_ros1: bool) -> Iterator[Message]:
    for connection, bag_ns, raw in reader.messages(connections):
        content = bytes(raw) if is_ros1 else _unpacked_message(bytes(raw))
        yield Message(_topic(connection), str(connection.msgtype), bag_ns, content, is_ros1)


def _unpacked_message(content: bytes) -> bytes:
    """A message that rosbag2 packed on its own, unpacked; others begin with 0 (CDR)."""
    if not content.startswith(_ZSTD_MAGIC):
        return content
    try:
        return bytes(zstd().ZstdDecompressor().decompress(content, _MOST_UNPACKED_BYTES))
    except zstd().ZstdError:
        return b""


def _type(name: str) -> str:
    """The name of a type as ROS 2 writes it: sensor_msgs/msg/Image of sensor_msgs/Image."""
    package, _, rest = name.partition("/")
    return name if rest.startswith("msg/") else f"{package}/msg/{rest}"


def _topic(connection: Any) -> str:
    return "/" + str(connection.topic).lstrip("/")


def _opened(file: Path) -> Any:
    """The reader of a file, open."""
    from rosbags.rosbag1 import Reader as Bag1
    from rosbags.rosbag2 import Reader as Bag2

    reader = Bag1(file) if file.suffix == ".bag" else Bag2(file)
    reader.open()
    return reader


def _faults() -> tuple[type[Exception], ...]:
    """What `rosbags` and the packages below it raise on files that are cut off or damaged."""
    import struct

    import apsw
    from rosbags.rosbag1 import ReaderError as Error1
    from rosbags.rosbag2 import ReaderError as Error2

    return (*FAULTS, struct.error, AssertionError, OSError, RuntimeError, apsw.Error, Error1, Error2)


def _repair(file: Path, copy: Path) -> str:
    """Write the repaired copy, and return a line about what was lost."""
    cut = f"{file.name} was never closed or cut off"
    if file.suffix == ".db3":
        return f"{cut}: the first {repair_db3(file, copy).seconds:.1f} s are complete, the rest is lost"
    bag = repair_bag(file, copy)
    return f"{cut}: what is complete is read, its first {bag.seconds:.1f} s"

"""Repair a recording in SQLite (.db3, ROS 2's or librealsense's) that was cut off.

It has two tables: topics, written first, and messages, in order of arrival. SQLite refuses a file that is
shorter than its header says; its rows can still be read one at a time, up to the pages that are gone.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import apsw

from rpl_data.files import decoding, refuse_special
from rpl_data.types import DataError

_SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
    data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""

_TOPICS = "id, name, type, serialization_format, offered_qos_profiles"
"""What every version has; ROS 2 Iron and later have one column more."""

_MOST_UNREADABLE_ROWS = 1000
"""After this many consecutive rows that cannot be read, the file has ended."""

Row = tuple[int, int, int, bytes]


@dataclass(frozen=True)
class Db3Repair:
    """Result of a repair.

    Attributes:
        messages: number of complete messages.
        seconds: time from the first of them to the last.
    """

    messages: int
    seconds: float


def repair_db3(path: Path, repaired: Path) -> Db3Repair:
    """Write `repaired` with the topics and the complete messages of a broken file.

    Raises:
        DataError: no topic or no message can be read.
    """
    refuse_special(path)
    with decoding(path, "record it again"):
        return _repaired(path, repaired)


def _repaired(path: Path, repaired: Path) -> Db3Repair:
    times_ns: list[int] = []
    repaired.unlink(missing_ok=True)
    with _whole_pages(path) as old, closing(sqlite3.connect(repaired)) as new:
        new.execute("PRAGMA synchronous = OFF")  # a copy that a crash spoils is made again
        new.executescript(_SCHEMA)
        try:
            old.execute("PRAGMA writable_schema = ON")  # otherwise a file that is too short is refused
            topics = old.execute(f"SELECT {_TOPICS} FROM topics").fetchall()
        except apsw.Error as error:
            raise _nothing_of(path) from error
        # A damaged row that lacks a value is left out.
        new.executemany("INSERT OR IGNORE INTO topics VALUES (?, ?, ?, ?, ?)", topics)
        for row in _whole_messages(old):
            if new.execute("INSERT OR IGNORE INTO messages VALUES (?, ?, ?, ?)", row).rowcount:
                times_ns.append(row[2])
        new.commit()
    if not times_ns:
        raise DataError(f"{path} was cut off within its first message; nothing of it can be kept")
    return Db3Repair(len(times_ns), (max(times_ns) - min(times_ns)) * 1e-9)


def db3_uri(path: Path) -> str:
    """The address by which SQLite opens a file that it must never change."""
    return f"{path.absolute().as_uri()}?mode=ro&immutable=1"


def _nothing_of(path: Path) -> DataError:
    return DataError(f"{path} is not a recording of a RealSense camera or of ROS 2, or all of it is lost")


class _WholePages(apsw.VFS):
    """Opens files of which a page that is cut off cannot be read; SQLite itself would take it for zeros."""

    def __init__(self) -> None:
        super().__init__("rpl-whole-pages", "")

    def xOpen(self, name: Any, flags: list[int]) -> apsw.VFSFile:
        """Open a file."""
        return _WholePagesFile("", name, flags)


class _WholePagesFile(apsw.VFSFile):
    def xRead(self, amount: int, offset: int) -> bytes:
        """Read so many bytes; an error when there are fewer."""
        content = super().xRead(amount, offset)
        if len(content) < amount:
            raise apsw.IOError("the file was cut off here")
        return content


@contextmanager
def _whole_pages(path: Path) -> Iterator[apsw.Connection]:
    system = _WholePages()
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    try:
        try:
            connection = apsw.Connection(db3_uri(path), flags=flags, vfs="rpl-whole-pages")
        except apsw.Error as error:
            raise _nothing_of(path) from error
        with closing(connection):
            yield connection
    finally:
        system.unregister()


def _whole_messages(connection: apsw.Connection) -> Iterator[Row]:
    number = missing = 0
    while missing < _MOST_UNREADABLE_ROWS:
        number += 1
        try:
            row = connection.execute(
                "SELECT id, topic_id, timestamp, data FROM messages WHERE id = ?", (number,)
            ).fetchone()
        except apsw.Error:
            row = None
        missing = missing + 1 if row is None else 0
        if row is not None:
            yield row

"""Repair of a RealSense recording in SQLite (.db3) that was cut off, as by a full disk or a copy that broke.

Two tables: topics, written first, and messages, in the order they came. SQLite refuses a file that is shorter
than its header says; its rows can still be read one at a time, up to the pages that are gone.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from rpl_data.files import decoding, refuse_special
from rpl_data.types import DataError

_SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
    data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""

_PATIENCE = 1000
"""So many rows in a row that cannot be read are the end."""

Row = tuple[int, int, int, bytes]


@dataclass(frozen=True)
class Db3Repair:
    """What a repair found.

    Attributes:
        messages: that are whole.
        seconds: from the first of them to the last.
    """

    messages: int
    seconds: float


def repair_db3(path: Path, repaired: Path) -> Db3Repair:
    """Write `repaired`: the topics and the messages that are whole.

    Raises:
        DataError: no topic or no message can be read.
    """
    refuse_special(path)
    with decoding(path, "record it again"):
        return _repaired(path, repaired)


def _repaired(path: Path, repaired: Path) -> Db3Repair:
    times_ns: list[int] = []
    repaired.unlink(missing_ok=True)
    with closing(sqlite3.connect(_uri(path), uri=True)) as old, closing(sqlite3.connect(repaired)) as new:
        new.executescript(_SCHEMA)
        try:
            old.execute("PRAGMA writable_schema = ON")  # a file shorter than it should be is refused else
            topics = old.execute("SELECT * FROM topics").fetchall()
        except sqlite3.DatabaseError as error:
            raise DataError(f"{path} is no recording of a RealSense camera, or all of it is lost") from error
        new.executemany("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", topics)
        for row in _whole_messages(old):
            new.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
            times_ns.append(row[2])
        new.commit()
    if not times_ns:
        raise DataError(f"{path} was cut off before its first message was whole; nothing can be kept of it")
    return Db3Repair(len(times_ns), (max(times_ns) - min(times_ns)) * 1e-9)


def _uri(path: Path) -> str:
    return f"{path.absolute().as_uri()}?mode=ro&immutable=1"


def _whole_messages(connection: sqlite3.Connection) -> Iterator[Row]:
    number = missing = 0
    while missing < _PATIENCE:
        number += 1
        try:
            row = connection.execute(
                "SELECT id, topic_id, timestamp, data FROM messages WHERE id = ?", (number,)
            ).fetchone()
        except sqlite3.DatabaseError:
            row = None
        missing = missing + 1 if row is None else 0
        if row is not None:
            yield row

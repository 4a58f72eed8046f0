"""Repair of SQLite bags: rows that lost a value are left out, those around them are kept."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from rpl_data.formats.containers.db3 import repair_db3


def test_a_row_that_lacks_a_value_is_left_out(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "damaged.db3")) as damaged:
        damaged.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format,"
            " offered_qos_profiles);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
        )
        damaged.execute(
            "INSERT INTO topics VALUES (1, '/color', 'image', 'cdr', ''), (2, NULL, 'x', 'cdr', '')"
        )
        rows = [(1, 1, 1_000_000_000, b"a"), (2, None, 2_000_000_000, b"b"), (3, 1, 3_000_000_000, b"c")]
        damaged.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        damaged.commit()
    done = repair_db3(tmp_path / "damaged.db3", tmp_path / "whole.db3")
    assert (done.messages, done.seconds) == (2, 2.0)
    with closing(sqlite3.connect(tmp_path / "whole.db3")) as whole:
        assert whole.execute("SELECT name FROM topics").fetchall() == [("/color",)]
        assert whole.execute("SELECT data FROM messages").fetchall() == [(b"a",), (b"c",)]

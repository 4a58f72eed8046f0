"""The topics of a .bag or .db3 file, read without a player: is it librealsense's own recording, or ROS's?

Both kinds of program write the same two containers. librealsense (its Viewer, `rpl capture`) names its topics
/device_0/sensor_0/... and says its version in /file_version; no ROS driver does.
"""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from rpl_data.files import FAULTS
from rpl_data.formats.containers.db3 import db3_uri

_LOOKED_AT_BYTES = 1 << 20
"""In a bag, topics stand in the first chunk, packed or not, and again in the index at the end."""

_MOST_STEPS = 1_000_000
"""Steps of SQLite's machine that reading the names may take; 10,000 names take a tenth."""

_DEVICE = re.compile(rb"/file_version|device_\d+/(sensor_\d|info)")


def is_of_ros(path: Path) -> bool:
    """Whether a .bag or .db3 file was written by ROS; False for librealsense's, and for what is neither."""
    if not path.is_file():
        return False
    if path.suffix == ".bag":
        return _is_bag_without_device(path)
    topics = db3_topics(path)
    return topics is not None and not any(_DEVICE.search(name.encode()) for name in topics)


def db3_topics(path: Path) -> list[str] | None:
    """Names of the topics of an SQLite recording, whole or cut off; None where there are none to be read."""
    with suppress(sqlite3.Error, OSError, *FAULTS), closing(sqlite3.connect(db3_uri(path), uri=True)) as file:
        file.set_progress_handler(lambda: 1, _MOST_STEPS)  # ends a query that a made-up table never would
        file.execute("PRAGMA writable_schema = ON")  # otherwise a file that is too short is refused
        return [str(name) for (name,) in file.execute("SELECT name FROM topics LIMIT 10000")]
    return None


def _is_bag_without_device(path: Path) -> bool:
    """Look for the names in the file's start, where LZ4 leaves a first mention as it is, and at its end."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            start = file.read(_LOOKED_AT_BYTES)
            file.seek(max(0, size - _LOOKED_AT_BYTES))
            end = file.read()
    except OSError:
        return False
    return start.startswith(b"#ROSBAG V2") and not any(map(_DEVICE.search, (start, end)))

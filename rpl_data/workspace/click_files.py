"""The log of clicks as a file: one JSON event per line, append-only."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from rpl_data.clicks.log import Event
from rpl_data.files import append_bytes, decoding, read_text
from rpl_data.types import DataError


def append_events(path: Path, events: Iterable[Event]) -> None:
    """Append events, all or none; they are on the disk when this returns.

    Raises:
        DataError: the file cannot be written; it stays as it was.
    """
    lines = "".join(json.dumps(event) + "\n" for event in events)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        append_bytes(path, lines.encode())
    except OSError as error:
        why = f"{error.strerror}; the last action was not saved"
        raise DataError(f"cannot write {path}: {why}") from error


def read_events(path: Path) -> list[Event]:
    """Read the events; empty while there is no file. A last line cut off by a crash is ignored.

    Raises:
        DataError: a line before the last is broken; the message names it.
    """
    if not path.exists():
        return []
    lines = read_text(path).split("\n")
    events = []
    for number, line in enumerate(lines, start=1):
        if not line:
            continue
        try:
            with decoding(f"{path} line {number}", "delete that line"):
                events.append(dict(json.loads(line)))
        except DataError:
            if number < len(lines):  # else it has no newline at its end: it was never acknowledged
                raise
    return events

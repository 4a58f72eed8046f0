"""A workspace in one line, for a person at a Python prompt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rpl_data.files import read_json
from rpl_data.types import DataError
from rpl_data.wording import counted


def summary(
    root: Path, scene_names: Callable[[], Sequence[str]], object_names: Callable[[], Sequence[str]]
) -> str:
    """How many scenes, frames, objects and labelled frames a workspace holds.

    Never raises, since it is printed wherever a workspace is: a file that cannot be read is named instead.
    """
    if not root.exists():
        return "not there yet"
    try:
        scenes, objects = scene_names(), object_names()
        frames = sum(len(read_json(root / "scenes" / name / "scene.json")["frames"]) for name in scenes)
        labelled = sum(_lines(path) for path in root.glob("labels/*.jsonl"))
    except (DataError, OSError, KeyError, TypeError) as error:
        return f"cannot be counted: {error}"
    parts = [
        f"{counted(len(scenes), 'scene')} with {counted(frames, 'frame')}",
        counted(len(objects), "object") + (f" ({', '.join(objects)})" if objects else ""),
        counted(labelled, "labelled frame"),
    ]
    return ", ".join(parts)


def _lines(path: Path) -> int:
    """Lines of a file of any size, a piece at a time."""
    with path.open("rb") as file:
        return sum(piece.count(b"\n") for piece in iter(lambda: file.read(1 << 20), b""))

"""A workspace in one line, for a person at a Python prompt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rpl_data.files import read_json
from rpl_data.types import DataError


def summary(root: Path, scene_names: Callable[[], Sequence[str]]) -> str:
    """How many scenes, frames, objects and labelled frames a workspace holds.

    Never raises, since it is printed wherever a workspace is: a file that cannot be read is named instead.
    """
    if not root.exists():
        return "not there yet"
    objects = sorted({path.parent.name for path in root.glob("objects/*/*")})
    try:
        scenes = scene_names()
        frames = sum(len(read_json(root / "scenes" / name / "scene.json")["frames"]) for name in scenes)
        labelled = sum(_lines(path) for path in root.glob("labels/*.jsonl"))
    except (DataError, OSError, KeyError, TypeError) as error:
        return f"cannot be counted: {error}"
    parts = [
        f"{_counted(len(scenes), 'scene')} with {_counted(frames, 'frame')}",
        _counted(len(objects), "object") + (f" ({', '.join(objects)})" if objects else ""),
        _counted(labelled, "labelled frame"),
    ]
    return ", ".join(parts)


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def _lines(path: Path) -> int:
    """Lines of a file of any size, a piece at a time."""
    with path.open("rb") as file:
        return sum(piece.count(b"\n") for piece in iter(lambda: file.read(1 << 20), b""))

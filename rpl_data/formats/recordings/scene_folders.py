"""Which folders below a path hold a scene, and which of them to read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rpl_data.types import DataError


def folders_in(path: Path) -> list[Path]:
    """The folders directly below a path, sorted; none where it is not a folder."""
    return sorted(folder for folder in path.iterdir() if folder.is_dir()) if path.is_dir() else []


def scene_folders(path: Path, is_scene: Callable[[Path], bool]) -> dict[str, Path]:
    """Which of a folder and the folders directly below it hold a scene, by name."""
    return {folder.name: folder for folder in (path, *folders_in(path)) if is_scene(folder)}


def chosen(found: Mapping[str, Path], names: Sequence[str] | None, where: Path) -> dict[str, Path]:
    """Choose the scenes to read, by name and sorted; DataError when one of `names` does not exist."""
    unknown = [name for name in names or [] if name not in found]
    if unknown:
        raise DataError(f"{where} has no scene {', '.join(map(str, unknown))}; it has {', '.join(found)}")
    return {name: found[name] for name in sorted(found if names is None else names)}

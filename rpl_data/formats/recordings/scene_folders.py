"""Which folders below a path hold a scene, and which of them to read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rpl_data.types import DataError


def folders_in(path: Path) -> list[Path]:
    """The folders directly below a path, sorted; none where it is not a folder."""
    return sorted(folder for folder in path.iterdir() if folder.is_dir()) if path.is_dir() else []


def scene_folders(path: Path, is_scene: Callable[[Path], bool]) -> dict[str, Path]:
    """Which of a folder and those directly below it hold a scene, by name; DataError for a name twice."""
    found: dict[str, Path] = {}
    for folder in filter(is_scene, (path, *folders_in(path))):
        if folder.name in found:
            raise DataError(
                f"two scenes are called {folder.name}: {found[folder.name]} and {folder}; rename a folder"
            )
        found[folder.name] = folder
    return found


def chosen_scenes(
    path: Path, is_scene: Callable[[Path], bool], names: Sequence[str] | None, *, lacks: str
) -> dict[str, Path]:
    """The scenes to read of a folder and those directly below it, by name and sorted.

    Args:
        lacks: what a folder that is no scene lacks, for the message.

    Raises:
        DataError: there is no scene, two have one name, or one of `names` does not exist.
    """
    found = scene_folders(path, is_scene)
    if not found:
        raise DataError(f"{path} has no {lacks}, and neither has any folder in it")
    return chosen(found, names, path)


def chosen(found: Mapping[str, Path], names: Sequence[str] | None, where: Path) -> dict[str, Path]:
    """Choose the scenes to read, by name and sorted; DataError when one of `names` does not exist."""
    unknown = [name for name in names or [] if name not in found]
    if unknown:
        raise DataError(f"{where} has no scene {', '.join(map(str, unknown))}; it has {', '.join(found)}")
    return {name: found[name] for name in sorted(found if names is None else names)}

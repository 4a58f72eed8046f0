"""The recordings that a recipe names, opened."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rpl_data.pipeline.recipe import SceneSource
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.names import checked_name


def recordings_of(
    sources: Sequence[SceneSource],
    *,
    unpack: Callable[[str], Path] | None = None,
    faults: dict[str, DataError] | None = None,
) -> list[Recording]:
    """Open all scenes of all sources.

    Args:
        sources: the sources of the scenes.
        unpack: returns an empty folder for the images of a scene whose recording is a single file; called
            once per name.
        faults: takes the sources that cannot be read, with why, by their paths and the names of their scenes
            where those were chosen; without it, the first such fault is raised.

    Raises:
        DataError: two scenes share a name, or a source cannot be read; with `faults`, only when none can.
    """
    found: dict[str, Recording] = {}
    unread = 0
    for source in sources:
        unpacked: set[str] = set()

        def fresh(name: str, source: SceneSource = source, unpacked: set[str] = unpacked) -> Path:
            if name in found or name in unpacked:  # its images would replace those of the other
                first = found[name].scene.source if name in found else str(source.path)
                raise _same_name(name, first, str(source.path))
            unpacked.add(name)
            assert unpack is not None  # else nothing asks for a folder
            return unpack(name)

        try:
            opened = open_scenes(**_recorded(source), unpack=None if unpack is None else fresh)
        except DataError as error:
            unread += 1
            if faults is None or unread == len(sources):
                raise
            faults[_said(source)] = error
            continue
        for recording in opened:
            name = checked_name(recording.scene.name, "scene", where=str(source.path))
            if name in found:
                raise _same_name(name, found[name].scene.source, recording.scene.source)
            found[name] = replace(recording, moving=source.moves(name))
        _refuse_unknown_moving(source, found)
    return list(found.values())


def _said(source: SceneSource) -> str:
    """What a source is called: several may choose scenes of one folder."""
    return f"{source.path} ({', '.join(source.names)})" if source.names else str(source.path)


def _recorded(source: SceneSource) -> dict[str, Any]:
    """All that a source says of its recordings: neither masks, nor whether objects move."""
    return {name: value for name, value in vars(source).items() if name not in ("masks", "moving")}


def _refuse_unknown_moving(source: SceneSource, there: Collection[str]) -> None:
    named = () if isinstance(source.moving, bool) else source.moving
    if unknown := sorted(set(named) - set(there)):
        raise DataError(
            f"{source.path}: `moving` names {', '.join(unknown)}; there are {', '.join(there)}; use the same "
            "names"
        )


def _same_name(name: str, one: str, other: str) -> DataError:
    return DataError(
        f"two scenes are called {name}: {one} and {other}; rename a folder, or choose scenes by `names`"
    )

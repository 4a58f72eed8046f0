"""Devices and their files -> scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rpl_data.formats.rpl import read_rpl
from rpl_data.types import DataError, Recording

READERS: dict[str, Callable[..., list[Recording]]] = {"rpl": read_rpl}
"""By format name: ``reader(path, *, names, metres_per_unit) -> recordings``."""


def open_scenes(
    path: Path, format: str, *, names: Sequence[str] | None = None, metres_per_unit: float | None = None
) -> list[Recording]:
    """The recordings found at `path`, read as `format`, a key of `READERS`.

    Args:
        path: what the format's reader expects, usually a folder.
        format: name of the format.
        names: which scenes to read; all where None.
        metres_per_unit: of the depth images; the format's own where None.

    Raises:
        DataError: the format is unknown, or the reader cannot read what is there.
    """
    if format not in READERS:
        raise DataError(f"unknown format {format!r} for {path}; expected one of {', '.join(sorted(READERS))}")
    return READERS[format](path, names=names, metres_per_unit=metres_per_unit)

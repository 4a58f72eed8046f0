"""Images of each scene of an export, by which the scene is known again in another one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rpl_data.files import file_hash
from rpl_data.json_arrays import Json
from rpl_data.types import spread_evenly

SAMPLES = 5
"""Images of a scene by which it is known again: some of them may be left out of a later export."""

Samples = dict[str, list[list[str]]]
"""By scene, files of some of its images, relative to the export, each with its SHA-256."""


def samples_by_scene(folder: Path, images: Iterable[Json]) -> Samples:
    """Some images of each scene; files that are missing are left out.

    Args:
        folder: the export.
        images: the entries of its COCO files.
    """
    files: dict[str, list[str]] = {}
    for image in images:
        files.setdefault(image["scene"], []).append(image["file_name"])
    return {
        scene: [
            [name, file_hash(folder / name)]
            for name in spread_evenly(names, SAMPLES)
            if (folder / name).is_file()
        ]
        for scene, names in files.items()
    }

"""A recording, or all recordings of a recipe, for the doctor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.pipeline.sources import recordings_of
from rpl_data.recordings.open import only_format, open_scenes
from rpl_data.types import DataError, Recording


def recordings_at(
    path: Path,
    scratch: Path,
    *,
    format: str | None = None,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Sequence[float] | None = None,
    topics: Topics | None = None,
) -> list[Recording]:
    """The recordings of a recipe as it reads and mends them, or those found at a path.

    Args:
        path: a recipe (`.yaml`), or what a reader expects.
        scratch: a folder for the images of formats that keep all of them in one file.
        format: a key of `READERS` or `UNPACKERS` of `rpl_data.recordings.open`; guessed where None.
        names: only these scenes.
        metres_per_unit: of the depth images; what the format says where None.
        camera: fx, fy, cx, cy and distortion of the colour images; what the recording says where None.
        topics: topics of a ROS bag to use; found by their names where None.

    Raises:
        DataError: nothing is there, its format cannot be guessed, or its reader refuses it.
    """
    if path.suffix in (".yaml", ".yml"):
        found = recordings_of(load_recipe(path).scenes, unpack=scratch.joinpath)
        if not found:
            raise DataError(f"{path} names no recordings; give `rpl check` the folder of a recording")
        return [recording for recording in found if names is None or recording.scene.name in names]
    chosen = format or only_format(path)
    return open_scenes(
        path,
        chosen,
        names=names,
        metres_per_unit=metres_per_unit,
        camera=None if camera is None else tuple(camera),
        unpack=scratch.joinpath,
        topics=topics,
    )

"""What `rpl check` looks at: a recording, or all recordings of a recipe, or exports."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rpl_data.export.checks import CHECKS, check_export, dialect_of, holds_exports
from rpl_data.export.checksums import EDITED
from rpl_data.export.checksums import NAME as CHECKSUMS
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.pipeline.sources import recordings_of
from rpl_data.recordings.open import only_format, open_scenes
from rpl_data.types import DataError, Recording
from rpl_data.wording import counted
from rpl_data.workspace.paths import Paths

MOST_LINES = 50
"""Faults of an export that are printed; of the others, the number is."""


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


def exports_at(path: Path, dialect: str | None = None) -> list[tuple[Path, str | None]]:
    """The export at a path, or those in a workspace or its `export` folder, each with its format.

    Args:
        path: any path; empty comes back where it is no export. The format of one that no check knows is None.
        dialect: what the folder is; guessed when left out.

    Raises:
        DataError: the format is not known, there is no such folder, or a workspace has no exports.
    """
    if dialect is not None:
        if dialect not in CHECKS:
            raise DataError(f"unknown export {dialect!r}; expected one of {', '.join(CHECKS)}")
        return [(path, dialect)]
    if Paths(path).stages_file.exists():
        exports = Paths(path).export("coco").parent
        if not exports.is_dir():
            raise DataError(f"{path} is a workspace without exports; make one: rpl export --workspace {path}")
        path = exports
    if (known := dialect_of(path)) is not None:
        return [(path, known)]
    if not holds_exports(path) or not path.is_dir():
        return []
    found: list[tuple[Path, str | None]] = []
    for folder in sorted(each for each in path.iterdir() if each.is_dir() and EDITED not in each.name):
        found += exports_at(folder) if holds_exports(folder) else [(folder, dialect_of(folder))]
    return found


def print_faults(exports: Sequence[tuple[Path, str | None]]) -> None:
    """Check exports and print what is wrong with them.

    Raises:
        DataError: something is wrong; its number is said.
    """
    wrong = {}
    for folder, dialect in exports:
        if dialect is None:
            print(f"{folder}: not checked, since no check knows its format")
            continue
        faults = check_export(folder, dialect)
        print(f"{folder}: {dialect}: {counted(len(faults), 'fault') if faults else 'no fault was found'}")
        if not (folder / CHECKSUMS).exists():
            print(f"    it has no {CHECKSUMS}, as an older version made it: changed files are not noticed")
        for fault in faults[:MOST_LINES]:
            print(f"    {fault}")
        if len(faults) > MOST_LINES:
            print(f"    and {counted(len(faults) - MOST_LINES, 'other')}")
        if faults:
            wrong[folder] = len(faults)
    if wrong:
        total = counted(sum(wrong.values()), "fault")
        raise DataError(
            f"{total} in {', '.join(map(str, wrong))}; undo what was changed, or export again by `rpl export`"
        )

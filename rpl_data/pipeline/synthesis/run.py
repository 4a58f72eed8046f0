"""The work of the command: options checked, studio made, images rendered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rpl_data.images import read_pixels
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.ledger import Advance, stamps
from rpl_data.pipeline.synthesis.make import Job, check_target, synthesize
from rpl_data.pipeline.synthesis.studio import studio_of
from rpl_data.pipeline.synthesis.training import Training, training_split
from rpl_data.synthesize.storage import studio_made_of
from rpl_data.synthesize.studio import Plate, Studio
from rpl_data.torch.augmentation import PICTURES
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

SMALLEST_PX = 64


def synthesize_workspace(
    workspace: Workspace,
    out: Path | None,
    *,
    count: int,
    objects: Sequence[str] | None,
    width_px: int | None,
    seed: int,
    backgrounds: Path | None,
    mix: bool,
    again: bool,
    tell: Callable[[str], None],
    advance: Advance,
) -> tuple[Path, list[str]]:
    """Render new views of a workspace's objects; returns the folder and lines for the user.

    Raises:
        DataError: there are no labels, an option is out of its range, or an object is not known.
    """
    if count < 0 or seed < 0 or (width_px is not None and width_px < SMALLEST_PX):
        raise DataError(
            f"--count is {count}, --seed {seed}, --width {width_px}; expected at least 0, 0 and {SMALLEST_PX}"
        )
    if not count and (backgrounds is not None or width_px is not None or objects is not None):
        raise DataError(
            "--objects, --width and --backgrounds are for rendered images, and --count 0 renders none; leave "
            "them out, or ask for images"
        )
    context = context_of(workspace)
    training = training_split(workspace)
    # What would end the command is looked for before a minute is spent on the studio.
    target = workspace.export("synthetic") if out is None else out.expanduser().resolve()
    check_target(target, training)
    _check_objects(training, objects)
    pictures = None if backgrounds is None else pictures_in(backgrounds.expanduser())
    studio = studio_of(context, training, again=again, tell=tell)
    names, lines = _names(studio, training, objects)
    if pictures is not None:
        studio = replace(studio, plates=own_plates(studio, pictures))
    made_of = {
        "studio": studio_made_of(workspace.studio),
        "backgrounds": None if pictures is None else stamps(*pictures),
    }
    job = Job(count, names, width_px, seed, mix)
    return target, [*synthesize(target, workspace.studio, studio, training, job, made_of, advance), *lines]


def _check_objects(training: Training, wanted: Sequence[str] | None) -> None:
    known = training.names()
    unknown = sorted(set(wanted or ()) - set(known))
    if unknown:
        raise DataError(
            f"there is no object {', '.join(unknown)} in the training images; they show {', '.join(known)}"
        )
    if wanted is not None and not wanted:
        raise DataError(f"--objects names none; leave it out, or name some of {', '.join(known)}")


def _names(
    studio: Studio, training: Training, wanted: Sequence[str] | None
) -> tuple[tuple[str, ...], list[str]]:
    """The objects to show, and lines about those that are left out."""
    asked = tuple(name for name in training.names() if wanted is None or name in wanted)
    moved = [name for name in asked if name not in studio.subjects]
    unmade = (
        f"object {', '.join(moved)}: stands still in none of the training scenes "
        f"({', '.join(training.scenes)}), so there is no dense model of them"
    )
    if len(moved) == len(asked) or (moved and wanted is not None):
        raise DataError(f"{unmade}; train on more scenes, or leave it out by --objects")
    asked = tuple(name for name in asked if name not in moved)
    hollow = [name for name in asked if not studio.subjects[name].shown.any()]
    names = tuple(name for name in asked if name not in hollow)
    fault = (
        f"object {', '.join(hollow)}: from no direction the training scenes saw its surface wholly, so no "
        "view of it would be true"
    )
    if not names or (hollow and wanted is not None):
        raise DataError(f"{fault}; film it from more sides, or leave it out by --objects")
    left_out = [unmade] * bool(moved) + [fault] * bool(hollow)
    carved = [name for name in names if studio.subjects[name].carved]
    outlines = (
        f"object {', '.join(carved)}: hardly any depth is measured on it, so its shape is that of its "
        "outlines, and hollows are shown filled"
    )
    return names, [*(f"{why}; it is left out" for why in left_out), *[outlines] * bool(carved)]


def pictures_in(folder: Path) -> list[Path]:
    """The pictures in a folder and in those below it; DataError where there are none, or one is damaged."""
    if not folder.is_dir():
        raise DataError(f"--backgrounds: {folder} is no folder; give one with pictures in it")
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in PICTURES and path.is_file())
    if not files:
        raise DataError(f"--backgrounds: {folder} has no pictures ({', '.join(sorted(PICTURES))})")
    unreadable = [file for file in files if read_pixels(file, reduce=8) is None]
    if unreadable:
        raise DataError(f"--backgrounds: cannot read {unreadable[0]}; remove it from the folder")
    return files


def own_plates(studio: Studio, files: Sequence[Path]) -> tuple[Plate, ...]:
    """Plates of the user's pictures, stretched to the size of recorded images; objects float before them."""
    camera = studio.plates[0].camera
    up = np.array([0.0, -1.0, 0.0])
    return tuple(Plate("", number, file, None, None, camera, up, None) for number, file in enumerate(files))

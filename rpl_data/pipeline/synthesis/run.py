"""The work of the command: options checked, studio made, images rendered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rpl_data.images import read_pixels
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.synthesis.make import Advance, Job, synthesize
from rpl_data.pipeline.synthesis.studio import studio_of
from rpl_data.pipeline.synthesis.training import training_split
from rpl_data.synthesize.storage import studio_made_of
from rpl_data.synthesize.studio import Plate, Studio
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

PICTURES = {".jpg", ".jpeg", ".png", ".bmp", ".webp"}
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
    context = context_of(workspace)
    training = training_split(workspace)
    studio = studio_of(context, training, again=again, tell=tell)
    names, lines = _names(studio, objects)
    if backgrounds is not None:
        studio = replace(studio, plates=own_plates(studio, backgrounds))
    target = out or workspace.export("synthetic")
    made_of = {
        "studio": studio_made_of(workspace.studio),
        "backgrounds": [str(p.color) for p in studio.plates],
    }
    job = Job(count, names, width_px, seed, mix)
    return target, [*synthesize(target, workspace.studio, studio, training, job, made_of, advance), *lines]


def _names(studio: Studio, wanted: Sequence[str] | None) -> tuple[tuple[str, ...], list[str]]:
    """The objects to show, and lines about those that are left out."""
    known = tuple(studio.subjects)
    unknown = sorted(set(wanted or ()) - set(known))
    if unknown:
        raise DataError(
            f"there is no object {', '.join(unknown)} in the training images; they show {', '.join(known)}"
        )
    asked = tuple(name for name in known if wanted is None or name in wanted)
    hollow = [name for name in asked if not studio.subjects[name].shown.any()]
    names = tuple(name for name in asked if name not in hollow)
    fault = (
        f"object {', '.join(hollow)}: from no direction the training scenes saw its surface wholly, so no "
        "view of it would be true"
    )
    if not names or (hollow and wanted is not None):
        raise DataError(f"{fault}; film it from more sides, or leave it out by --objects")
    return names, [f"{fault}; it is left out"] if hollow else []


def own_plates(studio: Studio, folder: Path) -> tuple[Plate, ...]:
    """Plates of the user's pictures, cut to the shape of the recorded images; objects float before them."""
    files = sorted(path for path in folder.expanduser().rglob("*") if path.suffix.lower() in PICTURES)
    if not files:
        raise DataError(f"--backgrounds: {folder} has no pictures ({', '.join(sorted(PICTURES))})")
    camera = studio.plates[0].camera
    unreadable = [file for file in files if read_pixels(file, reduce=8) is None]
    if unreadable:
        raise DataError(f"--backgrounds: cannot read {unreadable[0]}; remove it from the folder")
    up = np.array([0.0, -1.0, 0.0])
    return tuple(Plate("", number, file, None, None, camera, up, None) for number, file in enumerate(files))

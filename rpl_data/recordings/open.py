"""Any recording -> scenes: the readers by the name of their format, and which one a path looks like."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from rpl_data.capture.playback import is_recording, read_realsense
from rpl_data.formats.recordings.bop import is_bop_scene, read_bop
from rpl_data.formats.recordings.elasticfusion import read_klg
from rpl_data.formats.recordings.frame_files import Camera
from rpl_data.formats.recordings.frames import has_frames, read_frames
from rpl_data.formats.recordings.labelfusion import is_log, read_labelfusion
from rpl_data.formats.recordings.rpl import read_rpl
from rpl_data.formats.recordings.tum import is_sequence, read_tum
from rpl_data.formats.recordings.ycb_video import is_ycb_sequence, read_ycb_video
from rpl_data.recordings.mend import Mend, mended
from rpl_data.types import DataError, Recording

READERS: dict[str, Callable[..., list[Recording]]] = {
    "rpl": read_rpl,
    "frames": read_frames,
    "tum": read_tum,
    "bop": read_bop,
    "ycb_video": read_ycb_video,
    "labelfusion": read_labelfusion,
}
"""Formats whose images are files, by name: ``reader(path, *, names, metres_per_unit, camera)``."""

UNPACKERS: dict[str, Callable[..., list[Recording]]] = {
    "klg": read_klg,
    "klg_bgr": partial(read_klg, bgr=True),
    "realsense": read_realsense,
}
"""Formats that keep all images in one file: the same, with ``unpack(scene) -> folder`` for the images."""

SOUND = Mend()

_LOOKS_LIKE: dict[str, Callable[[Path], bool]] = {
    "rpl": lambda folder: (folder / "camera.txt").exists() and any(folder.glob("*/associations.txt")),
    "frames": has_frames,
    "tum": is_sequence,
    "bop": lambda folder: any(map(is_bop_scene, (folder, *folder.glob("*")))),
    "ycb_video": lambda folder: any(
        map(is_ycb_sequence, (folder, *folder.glob("*"), *folder.glob("data/*")))
    ),
    "labelfusion": lambda folder: any(map(is_log, (folder, *folder.glob("*")))),
    "klg": lambda path: path.suffix == ".klg" or any(path.glob("*.klg")),
    "realsense": lambda path: any(map(is_recording, (path, *path.glob("*")))),
}
"""By format name: whether a path looks like that, for the message about a wrong `format`."""


def open_scenes(
    path: Path,
    format: str,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
    registered: bool | None = None,
    unpack: Callable[[str], Path] | None = None,
    mend: Mend = SOUND,
) -> list[Recording]:
    """The recordings found at `path`, read as `format`, a key of `READERS` or `UNPACKERS`.

    Args:
        path: what the format's reader expects, usually a folder.
        format: name of the format.
        names: which scenes to read; all where None.
        metres_per_unit: of the depth images; the format's own where None.
        camera: of the colour images; what the recording says where None.
        registered: whether depth lies on the colour pixels; what the format says where None.
        unpack: an empty folder for the images of a scene, by its name; the formats of `UNPACKERS` need it.
        mend: what to put right.

    Raises:
        DataError: the format is unknown, or the reader cannot read what is there; the message names the
            format it looks like instead.
    """
    known = READERS | UNPACKERS
    if format not in known:
        raise DataError(f"unknown format {format!r} for {path}; expected one of {', '.join(sorted(known))}")
    if format in UNPACKERS and unpack is None:
        raise DataError(f"{path}: recordings of format {format} are unpacked; say where to")
    reader = partial(known[format], unpack=unpack) if format in UNPACKERS else known[format]
    try:
        found = reader(path, names=names, metres_per_unit=metres_per_unit, camera=camera)
    except DataError as error:
        likely = likely_formats(path)
        if not likely or format.startswith(tuple(likely)):
            raise
        raise DataError(f"{error}. It looks like `format: {likely[0]}`") from error
    if registered is not None:
        found = [replace(one, scene=replace(one.scene, registered=registered)) for one in found]
    return [mended(one, mend) for one in found]


def likely_formats(path: Path) -> list[str]:
    """The formats whose marks are found at a path; none for anything unknown."""
    return [name for name, looks_like_it in _LOOKS_LIKE.items() if looks_like_it(path)]

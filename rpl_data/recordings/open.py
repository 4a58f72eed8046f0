"""Open any recording as scenes: the readers by format name, and which formats a path looks like."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from rpl_data.capture.playback import is_recording, read_realsense
from rpl_data.files import decoding
from rpl_data.formats.recordings.bop import is_bop_scene, read_bop
from rpl_data.formats.recordings.elasticfusion import read_klg
from rpl_data.formats.recordings.folders import is_folder_scene, read_folders
from rpl_data.formats.recordings.frame_files import Camera
from rpl_data.formats.recordings.frames import has_frames, read_frames
from rpl_data.formats.recordings.kinect import is_mkv, read_kinect
from rpl_data.formats.recordings.labelfusion import is_log, read_labelfusion
from rpl_data.formats.recordings.nerfstudio import is_nerfstudio, read_nerfstudio
from rpl_data.formats.recordings.oak import is_holistic, refuse_oak
from rpl_data.formats.recordings.polycam import is_polycam, read_polycam
from rpl_data.formats.recordings.record3d import is_record3d, read_record3d
from rpl_data.formats.recordings.ros.read import has_bags, read_ros
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.formats.recordings.rpl import is_rpl_scene, read_rpl
from rpl_data.formats.recordings.scanner_app import is_scanner_app, read_scanner_app
from rpl_data.formats.recordings.scannet import is_sens, read_sens
from rpl_data.formats.recordings.stray import is_stray, read_stray
from rpl_data.formats.recordings.tum import is_sequence, read_tum
from rpl_data.formats.recordings.ycb_video import is_ycb_sequence, read_ycb_video
from rpl_data.formats.recordings.zed import is_zed, read_zed
from rpl_data.recordings.mend import Mend, mended
from rpl_data.types import DataError, Recording

READERS: dict[str, Callable[..., list[Recording]]] = {
    "rpl": read_rpl,
    "frames": read_frames,
    "tum": read_tum,
    "bop": read_bop,
    "ycb_video": read_ycb_video,
    "labelfusion": read_labelfusion,
    "zed": read_zed,
}
"""Readers of formats whose images are files: ``reader(path, *, names, metres_per_unit, camera)``."""

UNPACKERS: dict[str, Callable[..., list[Recording]]] = {
    "klg": read_klg,
    "klg_bgr": partial(read_klg, bgr=True),
    "realsense": read_realsense,
    "ros": read_ros,
    "kinect": read_kinect,
    "scannet": read_sens,
    "record3d": read_record3d,
    "stray": read_stray,
    "polycam": read_polycam,
    "scanner_app": read_scanner_app,
    "nerfstudio": read_nerfstudio,
    "folders": read_folders,
}
"""Readers that may have to write images of their own: of formats that keep all of them in one file, or depth
in other files than 16-bit PNG. They also take ``unpack(scene) -> folder``."""

SOUND = Mend()

_LOOKS_LIKE: dict[str, Callable[[Path], bool]] = {
    "rpl": lambda folder: is_rpl_scene(folder) or any(map(is_rpl_scene, folder.glob("*"))),
    "frames": lambda folder: any(map(has_frames, (folder, *folder.glob("*")))),
    "tum": lambda folder: any(map(is_sequence, (folder, *folder.glob("*")))),
    "bop": lambda folder: any(map(is_bop_scene, (folder, *folder.glob("*")))),
    "ycb_video": lambda folder: any(
        map(is_ycb_sequence, (folder, *folder.glob("*"), *folder.glob("data/*")))
    ),
    "labelfusion": lambda folder: any(map(is_log, (folder, *folder.glob("*")))),
    "klg": lambda path: path.suffix == ".klg" or any(path.glob("*.klg")),
    "realsense": lambda path: any(map(is_recording, (path, *path.glob("*")))),
    "ros": has_bags,
    "kinect": lambda path: any(map(is_mkv, (path, *path.glob("*")))),
    "scannet": lambda path: any(map(is_sens, (path, *path.glob("*")))),
    "zed": is_zed,
    "record3d": is_record3d,
    "stray": lambda folder: any(map(is_stray, (folder, *folder.glob("*")))),
    "polycam": lambda folder: any(map(is_polycam, (folder, *folder.glob("*")))),
    "scanner_app": lambda folder: any(map(is_scanner_app, (folder, *folder.glob("*")))),
    "nerfstudio": lambda folder: any(map(is_nerfstudio, (folder, *folder.glob("*")))),
}
"""Tests whether a path looks like a format, by format name."""

_PLAIN: dict[str, Callable[[Path], bool]] = {
    "folders": lambda folder: any(map(is_folder_scene, (folder, *folder.glob("*")))),
}
"""Layouts so plain that others contain them: only what looks like nothing else is one of these."""


def open_recordings(
    path: str | Path,
    format: str | None = None,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Sequence[float] | None = None,
    registered: bool | None = None,
    unpack: str | Path | None = None,
    mend: Mend = SOUND,
    topics: Topics | None = None,
) -> list[Recording]:
    """The recordings found at a path, one per scene; images stay where they are.

    Each `Recording` has a `scene` (camera, frames with their image files) and a `trajectory` (camera poses,
    scene_from_camera), which is None where the recording has no poses.

    Args:
        path: a folder of scenes, one scene, or a file (.klg, .bag, .mkv, ...).
        format: how they are stored, a name of `docs/recordings.md` such as rpl, tum, folders or record3d;
            found out from the files when left out.
        names: only these scenes; all of them when left out.
        metres_per_unit: metres of one unit of the stored depth; what the format says when left out.
        camera: fx, fy, cx, cy in pixels, then 0, 4, 5 or 8 numbers of OpenCV's lens distortion; what the
            recording says when left out.
        registered: whether depth lies on the pixels of the colour image; what the format says when left out.
        unpack: a folder for images of formats that keep them in one file, or in files few can read; each
            scene gets a folder in it.
        mend: faults to put right while reading; `rpl check` names them.
        topics: which topics of a ROS bag to use; found by their names when left out.

    Raises:
        DataError: there is nothing at the path, its format is not known, or it cannot be read.
    """
    place = Path(path).expanduser()
    folder = None if unpack is None else Path(unpack).expanduser()
    return open_scenes(
        place,
        format or only_format(place),
        names=names,
        metres_per_unit=metres_per_unit,
        camera=None if camera is None else tuple(camera),
        registered=registered,
        unpack=None if folder is None else folder.joinpath,
        mend=mend,
        topics=topics,
    )


def only_format(path: Path) -> str:
    """The format a path looks like; DataError when that is none or several."""
    if not path.exists():
        raise DataError(f"there is no recording {path}; check the path")
    likely = likely_formats(path)
    if not likely or is_holistic(path):
        refuse_oak(path)
    if len(likely) == 1:
        return likely[0]
    known = f"`format` (--format), one of {', '.join(sorted(READERS | UNPACKERS))}"
    if likely:
        raise DataError(f"{path} looks like {' and like '.join(likely)}; give {known}")
    raise DataError(
        f"{path} looks like no format that is known: give the folder or file that a recording is kept in, "
        f"not one in or above it, or give {known}"
    )


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
    topics: Topics | None = None,
) -> list[Recording]:
    """Read the recordings at `path` as `format`, a key of `READERS` or `UNPACKERS`.

    Args:
        path: what the format's reader expects, usually a folder.
        format: name of the format.
        names: which scenes to read; None for all.
        metres_per_unit: unit of the depth images; None for the format's own.
        camera: camera of the colour images; None for what the recording holds.
        registered: whether depth is registered to colour; None for what the format implies.
        unpack: returns an empty folder for the images of a scene, given its name; required by `UNPACKERS`.
        mend: the faults to mend.
        topics: topics of a ROS bag; of no other format.

    Raises:
        DataError: the format is unknown, or the reader cannot read what is there; the message names the
            format it looks like instead.
    """
    known = READERS | UNPACKERS
    if format not in known:
        raise DataError(f"unknown format {format!r} for {path}; expected one of {', '.join(sorted(known))}")
    if format != "ros" and topics is not None:
        raise DataError(
            f"{path}: `topics` are for recordings of format ros, this one's is {format}; leave it out"
        )
    unpacked = unpack or partial(_refuse_to_unpack, path, format)
    reader = partial(known[format], unpack=unpacked) if format in UNPACKERS else known[format]
    reader = partial(reader, topics=topics) if format == "ros" else reader
    try:
        with decoding(path, f"repair it, or check that its format is {format}; `rpl check` may say more"):
            found = reader(path, names=names, metres_per_unit=metres_per_unit, camera=camera)
    except OSError as error:
        raise DataError(f"cannot read {error.filename or path}: {error.strerror or error}") from error
    except DataError as error:
        likely = likely_formats(path)
        if not likely or format.startswith(tuple(likely)):
            raise
        raise DataError(f"{error}. It looks like `format: {likely[0]}`") from error
    if registered is not None:
        found = [replace(one, scene=replace(one.scene, registered=registered)) for one in found]
    return [mended(one, mend) for one in found]


def _refuse_to_unpack(path: Path, format: str, scene: str) -> Path:
    raise DataError(f"{path}: images of scene {scene} (format {format}) are unpacked; say where to: `unpack`")


def likely_formats(path: Path) -> list[str]:
    """Formats whose characteristic files are found at a path; empty for anything unknown."""
    for tests in (_LOOKS_LIKE, _PLAIN):
        if found := [name for name, looks_like_it in tests.items() if looks_like_it(path)]:
            return found
    return []

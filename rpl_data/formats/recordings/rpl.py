"""The dataset tree of RapidPoseLabels, read and written.

::

    <dataset>/camera.txt                 "fx fy cx cy" in pixels, one camera for all scenes; see `camera_file`
    <dataset>/<scene>/associations.txt   one line per frame: "<t> depth/<file> <t> rgb/<file>", or rgb first
                      camera.poses       TUM lines "t tx ty tz qx qy qz qw", scene_from_camera
                      rgb/ depth/        depth: 16-bit images, registered to colour; coarser than colour
                                         only where camera.txt says `depth_px`

The original pairs poses and frames by row; when a tracker drops a frame (ElasticFusion always drops the last)
every later pose is then shifted, so here they are matched by time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import write_text
from rpl_data.formats.recordings.camera_file import read_camera, told_of
from rpl_data.formats.recordings.color_lens import COLOR_LENS
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    check_unit,
    examine,
    match_poses,
    unlisted,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.formats.recordings.pose_lines import (
    finite_numbers,
    nearest,
    read_pose_rows,
    split_words,
    whole_lines,
    write_pose_lines,
)
from rpl_data.formats.recordings.scene_folders import chosen, folders_in
from rpl_data.formats.recordings.times import Clock, clock_beside, clock_of, refuse_jumping
from rpl_data.types import DataError, Recording

DEFAULT_METRES_PER_UNIT = 0.001


@dataclass(frozen=True)
class _Row:
    """A line of associations.txt: `pair` has its two images as listed, `times_s` their times."""

    index: int
    times_s: tuple[float, float]
    pair: tuple[Path, Path]


# Reading ------------------------------------------------------------------------------------------


def read_rpl(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read the scenes of a RapidPoseLabels tree, sorted by name.

    Frames without a pose, without depth or with an unreadable image are left out and named in
    `Recording.skipped`; those that stay keep their row in associations.txt as `Frame.index`. A scene
    without camera.poses has no trajectory (it must be tracked).

    Args:
        path: the folder with camera.txt and the scene folders, or one scene folder below it.
        names: which scenes to read, by folder name; for a single scene folder, the name to give it.
        metres_per_unit: unit of the depth images; when not given, that of camera.txt, else 0.001, which
            `Recording.notes` says.
        camera: used instead of camera.txt.

    Raises:
        DataError: a file is missing or broken, or contradicts another or `metres_per_unit`; a scene has no
            usable frame, its times are none, the images do not fit the camera, or depths are outside
            0.1-10 m, so the depth unit must be wrong.
    """
    path = path.absolute()
    if not path.is_dir():
        raise DataError(f"{path} is not a folder; expected a folder with camera.txt and scene folders")
    if metres_per_unit is not None:
        check_unit(metres_per_unit)
    single = (path / "associations.txt").exists()
    if not single and not (path / "camera.txt").exists() and not _scenes_in(path):
        raise DataError(
            f"{path} holds no recording: neither camera.txt nor a folder with associations.txt; check the "
            "path, and --root, where the relative paths of a recipe start"
        )
    folders = _single_scene(path, names) if single else _scene_folders(path, names)
    return [_read_scene(folder, name, camera, metres_per_unit) for name, folder in folders.items()]


def is_rpl_scene(folder: Path) -> bool:
    """Whether a folder looks like one scene of a RapidPoseLabels tree."""
    camera_files = (folder / "camera.txt", folder.absolute().parent / "camera.txt")
    return (folder / "associations.txt").exists() and any(path.exists() for path in camera_files)


def _single_scene(path: Path, names: Sequence[str] | None) -> dict[str, Path]:
    if names is not None and len(names) != 1:
        raise DataError(f"{path} is one scene, but names has {len(names)} entries: {list(names)}; give one")
    return {path.name if names is None else str(names[0]): path}


def _scenes_in(path: Path) -> dict[str, Path]:
    marks = ("associations.txt", "camera.poses", "rgb", "depth")
    return {p.name: p for p in folders_in(path) if any((p / mark).exists() for mark in marks)}


def _scene_folders(path: Path, names: Sequence[str] | None) -> dict[str, Path]:
    found = _scenes_in(path)
    if not found:
        raise DataError(f"{path} has no scene: none of its folders holds an associations.txt")
    return chosen(found, names, path)


def _read_scene(folder: Path, name: str, camera: Camera | None, metres_per_unit: float | None) -> Recording:
    told = told_of(folder, camera=camera, metres_per_unit=metres_per_unit)
    lens = told.camera or read_camera(folder.parent / "camera.txt").camera  # which says what to write
    rows, clock, lost = _read_associations(folder)
    depth = _depth_column(folder, rows)
    unit_m = DEFAULT_METRES_PER_UNIT if told.metres_per_unit is None else told.metres_per_unit
    pairs = [Pair(row.index, row.times_s[1 - depth], row.pair[1 - depth], row.pair[depth]) for row in rows]
    listing = Listing(
        name,
        folder,
        "rpl",
        pairs,
        lens,
        told.source,
        unit_m,
        assumed_unit=told.metres_per_unit is None,
        depth_camera=None if told.depth_px is None else COLOR_LENS,
        notes=(
            *((clock.note,) if clock.note else ()),
            *unlisted(folder / "associations.txt", [pair.color for pair in pairs]),
        ),
        skipped=lost,
    )
    recording = examine(listing)
    if not (folder / "camera.poses").exists():
        return without_poses(recording, "camera.poses")
    return _with_poses(recording, folder, rows, clock)


def _read_associations(folder: Path) -> tuple[list[_Row], Clock, tuple[str, ...]]:
    """Read the rows, with times in seconds; also their clock, and what was lost of them."""
    path = folder / "associations.txt"
    rows: list[_Row] = []
    lines, lost = whole_lines(path, 4)
    for number, line in lines:
        tokens = split_words(line)
        if len(tokens) != 4:
            raise DataError(f"{path} line {number}: expected <t> depth/<file> <t> rgb/<file>, found {line!r}")
        times = finite_numbers([tokens[0], tokens[2]], path, number)
        rows.append(_Row(len(rows), (times[0], times[1]), (folder / tokens[1], folder / tokens[3])))
    if not rows:
        raise DataError(f"{path} is empty; expected one line per frame: <t> depth/<file> <t> rgb/<file>")
    refuse_jumping([row.times_s[0] for row in rows], path)
    for (number, _), one, two in zip(lines[1:], rows, rows[1:], strict=False):
        if max(two.times_s) < min(one.times_s):
            raise DataError(
                f"{path} line {number} is earlier than the line before it; frames are counted by line, so "
                "clicks would be taken for those of other frames. Sort the lines by time"
            )
    clock = clock_of([row.times_s[0] for row in rows], path)
    first_s, second_s = ([row.times_s[column] * clock.unit_s for row in rows] for column in (0, 1))
    timed = zip(rows, first_s, second_s, strict=True)
    return [replace(row, times_s=(one, two)) for row, one, two in timed], clock, lost


def _depth_column(folder: Path, rows: Sequence[_Row]) -> int:
    """Find which of the two images of a line is depth, from the first line with two complete images."""
    for row in rows:
        first, second = (probe(path) for path in row.pair)
        if first is None or second is None:
            continue
        if first.is_depth == second.is_depth:
            raise DataError(
                f"{folder / 'associations.txt'}: of {row.pair[0].name} and {row.pair[1].name} one should be "
                "depth (16 bit, one channel) and the other colour; correct the names or convert the images"
            )
        return 0 if first.is_depth else 1
    raise DataError(
        f"{folder}: none of {len(rows)} frames has two readable images; the first names {rows[0].pair[0]} "
        f"and {rows[0].pair[1]}; copy the images or correct the paths in associations.txt"
    )


def _with_poses(recording: Recording, folder: Path, rows: Sequence[_Row], clock: Clock) -> Recording:
    """Match the pose nearest in time to each frame, by its row.

    Trackers stamp a pose with the time of colour or of depth; the one that fits better is used.
    """
    path = folder / "camera.poses"
    found = read_pose_rows(path)
    indices = [frame.index for frame in recording.scene.frames]
    stamps_s = np.array([rows[index].times_s for index in indices])
    own = clock_beside(found.times.tolist(), stamps_s[:, 0].tolist(), clock, path)
    times_s = found.times * own.unit_s
    apart_s = [float(np.median(nearest(times_s, stamps_s[:, column])[1])) for column in (0, 1)]
    column = int(np.argmin(apart_s))
    poses = match_poses(times_s, found.poses, indices, stamps_s[:, column], source=str(path))
    notes = (own.note,) if own.note not in ("", clock.note) else ()
    known = replace(recording, notes=(*recording.notes, *notes), skipped=(*recording.skipped, *found.lost))
    return with_poses(known, poses, without="without a pose in camera.poses at their time")


# Writing ------------------------------------------------------------------------------------------


def write_associations(
    scene_folder: Path, timestamps_s: Iterable[float], colors: Iterable[str], depths: Iterable[str]
) -> None:
    """Write associations.txt, depth first; images are named relative to the scene folder (rgb/000000.jpg)."""
    rows = zip(timestamps_s, colors, depths, strict=True)
    write_text(scene_folder / "associations.txt", "".join(association_line(*row) for row in rows))


def association_line(timestamp_s: float, color: str, depth: str) -> str:
    """Format a line of associations.txt."""
    return f"{timestamp_s:.6f} {depth} {timestamp_s:.6f} {color}\n"


def write_poses(
    scene_folder: Path, timestamps_s: Iterable[float], scene_from_camera: Float64[np.ndarray, "n 4 4"]
) -> None:
    """Write camera.poses, one TUM line per pose."""
    write_pose_lines(scene_folder / "camera.poses", timestamps_s, scene_from_camera)

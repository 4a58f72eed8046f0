"""The layout of the TUM RGB-D benchmark, and ICL-NUIM's variant of it.

::

    <scene>/rgb.txt          lines "t rgb/<file>", comments with #
            depth.txt        lines "t depth/<file>"; 16 bit, 1/5000 m, registered to colour
            groundtruth.txt  lines "t tx ty tz qx qy qz qw", scene_from_camera, by a motion capture system
            associations.txt instead of the two lists (ICL-NUIM): "t depth/<file> t rgb/<file>", any order

Colour, depth and poses have clocks of their own: each image is paired with the nearest within 20 ms, as the
benchmark's associate.py does, and poses are interpolated at the time of the colour image.

ICL-NUIM counts frames instead of seconds, and its camera has y up, which it writes as a negative fy: the
scene is then mirrored (y -> -y), the only way to a right-handed scene with OpenCV's camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import write_text
from rpl_data.formats.recordings.camera_file import told_of
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    unlisted,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.formats.recordings.pose_lines import (
    finite_numbers,
    interpolated,
    nearest,
    read_pose_rows,
    split_words,
    whole_lines,
    write_pose_lines,
)
from rpl_data.formats.recordings.scene_folders import chosen_scenes
from rpl_data.formats.recordings.times import Clock, clock_beside, clock_of, refuse_jumping
from rpl_data.types import DataError, Recording
from rpl_data.wording import counted

METRES_PER_UNIT = 1 / 5000
MAX_APART_S = 0.02
"""Largest time between the two images of a pair, as in associate.py."""

MAX_POSE_GAP_S = 0.1
"""Poses farther apart are not interpolated: the motion capture had lost the camera."""

CAMERAS: dict[str, Camera] = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""The benchmark's colour cameras, from its page on file formats; the files do not hold them."""

_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])

Stamped = list[tuple[float, Path]]


def read_tum(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one sequence, or the sequences in the folders of a folder, sorted by name.

    `Frame.index` is the row in rgb.txt. Colour images without a depth image within 20 ms, broken ones and
    those outside the time of the ground truth are left out and named in `Recording.skipped`.

    Args:
        path: a sequence, or a folder of sequences.
        names: which sequences to read, by folder name.
        metres_per_unit: unit of the depth images; when not given, that of camera.txt, else 1/5000, which
            `Recording.notes` says.
        camera: camera of the colour images; when not given, camera.txt of the sequence, or
            the benchmark's own for a folder called ...freiburg1..., 2 or 3. A negative fy means y up.

    Raises:
        DataError: there is no sequence, its lists are broken, no camera is known, no frame is complete or
            none has a pose.
    """
    path = path.absolute()
    scenes = chosen_scenes(path, is_sequence, names, lacks="rgb.txt and depth.txt")
    return [_read_sequence(name, folder, metres_per_unit, camera) for name, folder in scenes.items()]


def is_sequence(folder: Path) -> bool:
    """Whether the folder has the lists of a TUM sequence or of ICL-NUIM's variant."""
    lists = (folder / "rgb.txt").exists() and (folder / "depth.txt").exists()
    return lists or ((folder / "associations.txt").exists() and _truth_file(folder) is not None)


def _read_sequence(name: str, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    told = told_of(folder, camera=camera, metres_per_unit=unit_m)
    lens = told.camera or _benchmark_camera(folder)
    lists, lost = _lists(folder)
    clock, (colors, depths), notes = _timed(folder, lists)
    pairs, skipped = _associate(colors, depths)
    if not pairs:
        raise DataError(f"{folder}: no image of rgb.txt is within {MAX_APART_S:g} s of one of depth.txt")
    listing = Listing(
        name,
        folder,
        "tum",
        [Pair(*pair) for pair in pairs],
        (lens[0], abs(lens[1]), *lens[2:]),
        told.source,
        METRES_PER_UNIT if told.metres_per_unit is None else told.metres_per_unit,
        assumed_unit=told.metres_per_unit is None,
        notes=(*notes, *unlisted(_list_file(folder), [color for _, color in colors])),
        skipped=(*lost, *skipped),
    )
    recording = examine(listing)
    truth = _truth_file(folder)
    if truth is None:
        return without_poses(recording, "groundtruth.txt")
    return _with_poses(recording, truth, clock, mirrored=lens[1] < 0)


def _timed(folder: Path, lists: tuple[Stamped, Stamped]) -> tuple[Clock, list[Stamped], tuple[str, ...]]:
    """Both lists in seconds, each by its own clock; the clock of the colour images, and what was found."""
    names = ("rgb.txt", "depth.txt") if (folder / "rgb.txt").exists() else ("associations.txt",) * 2
    clocks = [
        clock_of([time for time, _ in images], folder / name)
        for name, images in zip(names, lists, strict=True)
    ]
    timed = [
        [(time * clock.unit_s, path) for time, path in images]
        for clock, images in zip(clocks, lists, strict=True)
    ]
    return clocks[0], timed, tuple(dict.fromkeys(clock.note for clock in clocks if clock.note))


def _truth_file(folder: Path) -> Path | None:
    found = [folder / "groundtruth.txt", *sorted(folder.glob("*.freiburg"))]
    return next((path for path in found if path.exists()), None)


def _benchmark_camera(folder: Path) -> Camera:
    """The benchmark's own camera, by the name of the folder; DataError for any other."""
    for name, known in CAMERAS.items():
        if name in folder.name:
            return known
    raise DataError(
        f"{folder}: a TUM sequence does not hold its camera; give `camera: [fx, fy, cx, cy]` in pixels, "
        "or write these four numbers into camera.txt beside rgb.txt"
    )


# Lists --------------------------------------------------------------------------------------------


def _list_file(folder: Path) -> Path:
    """The file that lists the colour images."""
    return folder / ("rgb.txt" if (folder / "rgb.txt").exists() else "associations.txt")


def _lists(folder: Path) -> tuple[tuple[Stamped, Stamped], tuple[str, ...]]:
    """Read times and files of colour and depth; also what was lost of the lists."""
    if (folder / "rgb.txt").exists():
        ((color,), no_color), ((depth,), no_depth) = (
            _read_list(folder / name, 2) for name in ("rgb.txt", "depth.txt")
        )
        return (color, depth), (*no_color, *no_depth)
    (first, second), lost = _read_list(folder / "associations.txt", 4)
    header = next((found for found in (probe(path) for _, path in first) if found is not None), None)
    return ((second, first) if header is None or header.is_depth else (first, second)), lost


def _read_list(path: Path, width: int) -> tuple[list[Stamped], tuple[str, ...]]:
    """Read the columns "t file" of a list with `width` words per line, sorted by time; also what was lost."""
    rows: list[list[tuple[float, Path]]] = []
    lines, lost = whole_lines(path, width)
    for number, line in lines:
        tokens = split_words(line)
        if len(tokens) != width:
            expected = " ".join(["<t> <file>"] * (width // 2))
            raise DataError(f"{path} line {number}: expected {expected}, found {line!r}")
        times = finite_numbers(tokens[::2], path, number)
        rows.append([(t, path.parent / file) for t, file in zip(times, tokens[1::2], strict=True)])
    if not rows:
        raise DataError(f"{path} is empty; expected one line per image")
    refuse_jumping([row[0][0] for row in rows], path)
    rows.sort(key=lambda row: row[0][0])
    return [list(column) for column in zip(*rows, strict=True)], lost


def _associate(
    colors: Stamped, depths: Stamped
) -> tuple[list[tuple[int, float, Path, Path]], tuple[str, ...]]:
    """Pair row, time, colour and depth; the nearest pairs are taken first, and no image twice."""
    color_s, depth_s = (np.array([time for time, _ in images]) for images in (colors, depths))
    rows, apart_s = nearest(depth_s, color_s)
    taken: dict[int, int] = {}
    for row in np.argsort(apart_s, kind="stable").tolist():
        if apart_s[row] <= MAX_APART_S:
            taken.setdefault(int(rows[row]), row)
    pairs = sorted((row, colors[row][0], colors[row][1], depths[depth][1]) for depth, row in taken.items())
    alone = len(colors) - len(pairs)
    lines = (f"{counted(alone, 'colour image')} without a depth image within {MAX_APART_S:g} s of their own",)
    return pairs, lines if alone else ()


def _with_poses(recording: Recording, truth: Path, clock: Clock, *, mirrored: bool) -> Recording:
    """Interpolate the poses of a file at the times of the frames; frames far from any pose are left out."""
    frames, rows = recording.scene.frames, read_pose_rows(truth)
    wanted_s = np.array([frame.timestamp_s for frame in frames])
    own = clock_beside(rows.times.tolist(), wanted_s.tolist(), clock, truth)
    found = interpolated(rows.times * own.unit_s, rows.poses, wanted_s, max_gap_s=MAX_POSE_GAP_S)
    poses = {frame.index: pose for frame, pose in zip(frames, found, strict=True) if pose is not None}
    if mirrored:
        poses = {index: _MIRROR @ pose @ _MIRROR for index, pose in poses.items()}
    notes = (own.note,) if own.note not in ("", clock.note) else ()
    known = replace(recording, notes=(*recording.notes, *notes), skipped=(*recording.skipped, *rows.lost))
    return with_poses(known, poses, without=f"outside the time or in a gap of {truth.name}")


# Writing ------------------------------------------------------------------------------------------


def write_tum(
    folder: Path,
    colors: Iterable[tuple[float, str]],
    depths: Iterable[tuple[float, str]],
    poses: tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 4 4"]] | None = None,
) -> None:
    """Write the lists of a sequence; files are named relative to its folder.

    Args:
        folder: folder of the sequence, with the images in it.
        colors: time and file of every colour image.
        depths: time and file of every depth image, in 1/5000 m.
        poses: times and scene_from_camera.
    """
    for name, images in (("rgb.txt", colors), ("depth.txt", depths)):
        write_text(
            folder / name, "# timestamp filename\n" + "".join(f"{t:.6f} {file}\n" for t, file in images)
        )
    if poses is not None:
        write_pose_lines(folder / "groundtruth.txt", *poses)

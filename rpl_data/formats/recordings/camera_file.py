"""RapidPoseLabels' file camera.txt, which is also ElasticFusion's `-cal` file.

::

    fx fy cx cy
    distortion k1 k2 p1 p2 k3       where the lens has any
    metres_per_unit 0.001           where it is known
    depth_px 256 192                where depth shows the view of colour at fewer pixels, as phones do

The two tools read the first line only; the other lines are ours. `rpl capture` writes them, so that a
recording holds everything that its camera reported. Many tools write the matrix K instead, in three lines of
three numbers or four of four; it is read too. What the file says holds for every format but those of
one file that hold the camera's own calibration; where a phone's app names its camera too, the two must agree.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from rpl_data.files import write_text
from rpl_data.formats.recordings.frame_files import Camera
from rpl_data.formats.recordings.pose_lines import data_lines, split_words
from rpl_data.types import DataError, Intrinsics
from rpl_data.untrusted.numbers import plain_number

WHAT = "one line: fx fy cx cy, in pixels of the colour images, or the 3x3 matrix K"


@dataclass(frozen=True)
class CameraFile:
    """Content of the file.

    Attributes:
        metres_per_unit: of the depth images; None where it is not given.
        depth_px: width and height of depth images that are coarser than colour; None where they are not.
    """

    camera: Camera
    metres_per_unit: float | None = None
    depth_px: tuple[int, int] | None = None


def read_camera(path: Path) -> CameraFile:
    """Read a camera.txt; DataError when it is missing or its numbers are invalid."""
    if not path.exists():
        raise DataError(f"{path} is missing; write it with {WHAT}")
    lines = [line for _, line in data_lines(path)] or [""]
    first, rows = lines[0], _matrix_rows(lines)
    try:
        words = [word for row in lines[:rows] for word in split_words(row)]
        fx, fy, cx, cy = camera_of_matrix([plain_number(float, word) for word in words])
    except ValueError as error:
        raise DataError(f"{path}: expected {WHAT}; found {first!r}") from error
    if not all(map(math.isfinite, (fx, fy, cx, cy))) or fx <= 0 or fy <= 0:
        raise DataError(f"{path}: fx fy cx cy must be finite and fx, fy positive; found {first!r}")
    said = _said(path, lines[rows:])
    unit = said.get("metres_per_unit")
    coarse = said.get("depth_px")
    return CameraFile(
        (fx, fy, cx, cy, *said.get("distortion", ())),
        unit[0] if unit else None,
        (int(coarse[0]), int(coarse[1])) if coarse else None,
    )


def _matrix_rows(lines: Sequence[str]) -> int:
    """Number of lines that hold the camera: 1, or the 3 or 4 rows of its matrix."""
    words = split_words(lines[0])
    if len(words) == 3:
        return 3
    return 4 if len(words) == 4 and len(lines) >= 4 and len(split_words(lines[3])) == 4 else 1


def camera_of_matrix(numbers: Sequence[float]) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of these four numbers, or of the 9 or 16 of a matrix K, row by row.

    Raises:
        ValueError: another number of numbers, or a matrix that is not K.
    """
    if len(numbers) == 4:
        fx, fy, cx, cy = numbers
        return fx, fy, cx, cy
    if len(numbers) not in (9, 16):
        raise ValueError(f"{len(numbers)} numbers are no camera")
    side = math.isqrt(len(numbers))
    rows = [list(numbers[at : at + side]) for at in range(0, len(numbers), side)]
    fx, cx, fy, cy = rows[0][0], rows[0][2], rows[1][1], rows[1][2]
    others = [abs(rows[1][0]), abs(rows[2][0]), abs(rows[2][1]), abs(rows[2][2] - 1)]
    if not max(others) < 1e-6 or not abs(rows[0][1]) < 0.01 * max(fx, 1.0):
        raise ValueError(f"{rows} is no matrix K with rows (fx 0 cx), (0 fy cy), (0 0 1)")
    return fx, fy, cx, cy


# What a recording's files and its recipe say together ---------------------------------------------


@dataclass(frozen=True)
class Told:
    """What was told of a recording's camera and depth, by its files and by whoever reads it.

    Attributes:
        camera: None where nobody told it.
        source: the file that the camera is from, or would be from; for messages.
        metres_per_unit: unit of the depth images; None where nobody told it.
        depth_px: width and height of depth images that are coarser than colour, where camera.txt says so.
    """

    camera: Camera | None
    source: Path
    metres_per_unit: float | None
    depth_px: tuple[int, int] | None = None


def told_of(
    folder: Path,
    *,
    camera: Camera | None,
    metres_per_unit: float | None,
    own: CameraFile | None = None,
    own_source: Path | None = None,
) -> Told:
    """Gather camera and depth unit of a scene: what the reader was given, camera.txt, the format's own file.

    The reader's `camera` is used instead of what files say, and its `metres_per_unit` instead of what a
    format's own file says. Otherwise those who speak must agree.

    Args:
        folder: folder of the scene; its camera.txt, or that of the folder above, is read.
        camera: what the reader was given.
        metres_per_unit: what the reader was given.
        own: what the format's own file says.
        own_source: that file.

    Raises:
        DataError: a camera.txt is invalid, or two of them differ.
    """
    files = [] if own is None or own_source is None else [(own, own_source)]
    places = (folder / "camera.txt", folder.parent / "camera.txt")
    written = [(read_camera(path), path) for path in places if path.is_file()]
    files += [found for found in written if found[1] != own_source]
    for (one, one_path), (other, other_path) in pairwise(files):
        if camera is None:
            refuse_other_camera(one.camera, one_path, other.camera, other_path)
    heard = written if metres_per_unit is not None else files
    units = {str(path): file.metres_per_unit for file, path in heard}
    unit_m = one_unit({**units, RECIPE: metres_per_unit})
    source = files[0][1] if files else folder / "camera.txt"
    coarse = next((file.depth_px for file, _ in written if file.depth_px is not None), None)
    return Told(camera or (files[0][0].camera if files else None), source, unit_m, coarse)


def refuse_other_camera(one: Camera, one_path: Path, other: Camera, other_path: Path) -> None:
    """Raise a DataError when two files of a recording tell of different cameras."""
    if any(abs(a - b) > 0.5 for a, b in zip(one[:4], other[:4], strict=True)):
        said = [" ".join(f"{value:g}" for value in camera[:4]) for camera in (one, other)]
        raise DataError(
            f"{one_path} says fx fy cx cy = {said[0]}, but {other_path} says {said[1]}; correct or delete one"
        )


def one_unit(said: Mapping[str, float | None]) -> float | None:
    """The depth unit that all who name one agree on; None where nobody does.

    Args:
        said: metres per unit, by the file or the option that says it.

    Raises:
        DataError: two of them differ.
    """
    named = {who: unit_m for who, unit_m in said.items() if unit_m is not None}
    if not named:
        return None
    first, unit_m = next(iter(named.items()))
    for who, other in named.items():
        if not math.isclose(other, unit_m, rel_tol=1e-3):
            raise DataError(
                f"{first} says {unit_m:g} m per unit of depth, but {who} says {other:g}; correct or "
                "delete one"
            )
    return unit_m


_MAY_SAY_THE_UNIT = re.compile(r"(\S*|depth\b.*)(unit|scale|factor)")

RECIPE = "metres_per_unit of the recipe or the command"
"""What an error calls the unit that a reader was given."""


def _said(path: Path, lines: Sequence[str]) -> Mapping[str, tuple[float, ...]]:
    """Read our own lines, also with a colon or an equals sign behind the name; other lines are ignored.

    Except one that seems to say the unit of depth in other words: it must not be passed over in silence.
    """
    counts = {"distortion": (4, 5, 8), "metres_per_unit": (1,), "depth_px": (2,)}
    said: dict[str, tuple[float, ...]] = {}
    for line in lines:
        key, *tokens = split_words(re.sub("[:=]", " ", line, count=1)) or [""]
        key = key.lower().replace("meters", "metres")
        if key not in counts:
            if tokens and _MAY_SAY_THE_UNIT.match(line.lower()):
                raise DataError(
                    f"{path}: {line!r} is not understood; write the metres of one unit of depth as "
                    "`metres_per_unit 0.001`, or delete the line"
                )
            continue
        try:
            said[key] = tuple(plain_number(float, token) for token in tokens)
        except ValueError as error:
            raise DataError(f"{path}: {error} in {line!r}; repair or delete the line") from error
        if len(said[key]) not in counts[key]:
            allowed = " or ".join(map(str, counts[key]))
            raise DataError(f"{path}: expected {allowed} numbers after {key}, found {line!r}")
    return said


def write_camera(folder: Path, intrinsics: Intrinsics, metres_per_unit: float | None = None) -> None:
    """Write camera.txt of a dataset folder."""
    write_text(folder / "camera.txt", camera_text(intrinsics, metres_per_unit))


def camera_text(
    intrinsics: Intrinsics, metres_per_unit: float | None = None, depth_px: tuple[int, int] | None = None
) -> str:
    """Text that `write_camera` writes."""
    text = _numbers((intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy))
    if any(intrinsics.distortion):
        text += f"distortion {_numbers(intrinsics.distortion)}"
    if metres_per_unit is not None:
        text += f"metres_per_unit {_numbers([metres_per_unit])}"
    if depth_px is not None:
        text += f"depth_px {depth_px[0]} {depth_px[1]}\n"
    return text


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values) + "\n"

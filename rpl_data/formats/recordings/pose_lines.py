"""Text files with one line per frame: read TUM's pose lines, and match poses to frames by time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial.transform import Rotation, Slerp

from rpl_data.files import read_text, write_text
from rpl_data.geometry import Transform, from_quaternion_xyzw, rigid, to_quaternion_xyzw
from rpl_data.types import DataError
from rpl_data.untrusted.numbers import plain_number
from rpl_data.wording import counted


def data_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line numbers and lines that are neither empty nor a comment."""
    for number, line in enumerate(read_text(path, errors="replace").splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line.strip()


def whole_lines(path: Path, words: int) -> tuple[list[tuple[int, str]], tuple[str, ...]]:
    """Read `data_lines`, without a last line that was cut off in its middle; also what was lost.

    A writer that was killed, or a copy that was interrupted, leaves an incomplete last line: with fewer
    words, or with fewer decimals than all lines before it.

    Args:
        path: the file.
        words: least number of words on a complete line.
    """
    lines = list(data_lines(path))
    if not lines or read_text(path, errors="replace").endswith("\n"):
        return lines, ()
    last, before = split_words(lines[-1][1]), [split_words(line) for _, line in lines[-4:-1]]
    usual = {_decimals(tokens[-1]) for tokens in before}
    fewer = len(usual) == 1 and _decimals(last[-1]) < max(usual)
    words = max(words, min(map(len, before), default=words))
    if len(last) >= words and not fewer and "\0" not in last[-1]:
        return lines, ()
    return lines[:-1], (f"{path.name} was cut off in the middle of line {lines[-1][0]}, which is lost",)


def _decimals(token: str) -> int:
    return len(token.partition(".")[2])


def finite_numbers(tokens: Sequence[str], path: Path, number: int) -> list[float]:
    """Convert the words of a line to numbers; DataError naming the line when one is not a finite number."""
    values = numbers(tokens, path, number)
    if not all(map(math.isfinite, values)):
        found = " ".join(tokens)
        raise DataError(
            f"{path} line {number}: numbers must be finite, found {found}; repair or delete the line"
        )
    return values


def numbers(tokens: Sequence[str], path: Path, number: int) -> list[float]:
    """Convert the words of a line to numbers, NaN and infinity too; DataError naming the line for others."""
    try:
        return [math.nan if _WINDOWS_NAN.fullmatch(token) else plain_number(float, token) for token in tokens]
    except ValueError as error:
        raise DataError(f"{path} line {number}: {error}; repair or delete the line") from error


_WINDOWS_NAN = re.compile(r"-?nan\((?:ind|snan)\)|-?1\.#(?:IND|QNAN|INF)\d*", re.IGNORECASE)
"""What C programs on Windows write for numbers that are none."""


def split_words(line: str) -> list[str]:
    """Split a line into words, at white space or at semicolons.

    Where semicolons separate, a comma within a number is the decimal comma of a table program. Commas between
    words are left: nobody can tell `1,5` from two numbers, and the caller refuses it as no number.
    """
    if ";" not in line:
        return line.split()
    fields = [field.strip() for field in line.rstrip(";").split(";")]
    return [field.replace(",", ".") if _DECIMAL_COMMA.fullmatch(field) else field for field in fields]


_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")


SAME_TIME_S = 0.001
"""Times that are this close are one: those of lists are often rounded to milliseconds."""


@dataclass(frozen=True)
class PoseRows:
    """The poses of a file, sorted by time.

    Attributes:
        times: as they are stored, in the unit of the file.
        poses: a rigid transform per time.
        lost: what was left out, a line per reason with its number.
    """

    times: Float64[np.ndarray, " n"]
    poses: Float64[np.ndarray, "n 4 4"]
    lost: tuple[str, ...]


def read_pose_rows(path: Path) -> PoseRows:
    """Read the lines ``t tx ty tz qx qy qz qw``, which RTAB-Map follows by the number of a node.

    A tracker that was lost writes NaN, infinity or a quaternion of zeros: they are left out and counted.

    Raises:
        DataError: a line has another number of columns or a quaternion that is not of unit length, or there
            is no pose.
    """
    times: list[float] = []
    poses: list[np.ndarray] = []
    lost: list[int] = []
    for number, line in whole_lines(path, 8)[0]:  # a frame whose pose was lost is reported as such
        values = np.array(numbers(_pose_words(path, number, line), path, number))
        length = float(np.linalg.norm(values[4:]))
        if not np.isfinite(values).all() or length == 0:
            lost.append(number)
            continue
        if not 0.9 < length < 1.1:
            raise DataError(f"{path} line {number}: qx qy qz qw is no unit quaternion in {line!r}; delete it")
        times.append(float(values[0]))
        poses.append(from_quaternion_xyzw(values[4:], values[1:4]))
    if not times:
        why = "holds no pose, only lines of a lost tracker" if lost else "is empty (as ElasticFusion leaves "
        why += "" if lost else "it when it is killed)"
        raise DataError(
            f"{path} {why}; track the scene again, or delete the file to have the camera tracked here"
        )
    order = np.argsort(times, kind="stable")
    said = f"{counted(len(lost), 'line')} of {path.name} left out: not finite, or a quaternion of zeros"
    return PoseRows(np.array(times)[order], np.array(poses)[order], (said,) if lost else ())


def _pose_words(path: Path, number: int, line: str) -> list[str]:
    """The 8 words of a pose; DataError for any others, except a whole number after them."""
    words = split_words(line)
    if len(words) == 9 and words[8].isdecimal():
        return words[:8]
    if len(words) != 8:
        raise DataError(f"{path} line {number}: expected 't tx ty tz qx qy qz qw', found {line!r}")
    return words


def read_pose_lines(path: Path) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 4 4"]]:
    """Read times and poses as `read_pose_rows`, where nobody counts what was left out."""
    rows = read_pose_rows(path)
    return rows.times, rows.poses


def write_pose_lines(path: Path, times_s: Iterable[float], poses: Float64[np.ndarray, "n 4 4"]) -> None:
    """Write one line ``t tx ty tz qx qy qz qw`` per pose."""
    lines = []
    for t, pose in zip(times_s, poses, strict=True):
        values = " ".join(f"{value:.9f}" for value in (*pose[:3, 3], *to_quaternion_xyzw(pose)))
        lines.append(f"{t:.6f} {values}\n")
    write_text(path, "".join(lines))


def nearest(
    times_s: Float64[np.ndarray, " n"], wanted_s: Float64[np.ndarray, " m"]
) -> tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Row of the sorted `times_s` nearest to each wanted time, and its distance in seconds."""
    after = np.searchsorted(times_s, wanted_s).clip(0, len(times_s) - 1)
    before = (after - 1).clip(0)
    row = np.where(np.abs(times_s[before] - wanted_s) <= np.abs(times_s[after] - wanted_s), before, after)
    return row.astype(np.int64), np.abs(times_s[row] - wanted_s)


def interpolated(
    times_s: Float64[np.ndarray, " n"],
    poses: Float64[np.ndarray, "n 4 4"],
    wanted_s: Float64[np.ndarray, " m"],
    *,
    max_gap_s: float,
) -> list[Transform | None]:
    """Pose at each wanted time: linear in position, slerp in rotation between its two neighbours.

    None before the first pose, after the last, and between two that are more than `max_gap_s` apart, unless
    one of them is within `SAME_TIME_S`: in a slow recording with a pose per frame, all are far apart.

    Args:
        times_s: times of the poses, sorted.
        poses: a_from_b at each of them.
        wanted_s: times in any order.
        max_gap_s: a longer gap is not bridged.
    """
    kept = np.flatnonzero(np.diff(times_s, prepend=-math.inf) > 0)
    times_s, poses = times_s[kept], poses[kept]
    after = np.searchsorted(times_s, wanted_s).clip(0, len(times_s) - 1)
    before = np.where(times_s[after] > wanted_s, after - 1, after)  # equals `after` at a pose's own time
    inside = (wanted_s >= times_s[0]) & (wanted_s <= times_s[-1])
    at_a_pose = nearest(times_s, wanted_s)[1] <= SAME_TIME_S
    known = at_a_pose | (inside & (times_s[after] - times_s[before.clip(0)] <= max_gap_s))
    if len(times_s) == 1:
        return [poses[0] if found else None for found in known]
    at_s = wanted_s.clip(times_s[0], times_s[-1])
    rotations = Slerp(times_s, Rotation.from_matrix(poses[:, :3, :3]))(at_s).as_matrix()
    positions = np.stack([np.interp(at_s, times_s, poses[:, axis, 3]) for axis in range(3)], axis=1)
    return [rigid(rotations[i], positions[i]) if known[i] else None for i in range(len(wanted_s))]

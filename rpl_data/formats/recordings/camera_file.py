"""RapidPoseLabels' file camera.txt, which is also ElasticFusion's `-cal` file.

::

    fx fy cx cy
    distortion k1 k2 p1 p2 k3       where the lens has any
    metres_per_unit 0.001           where it is known

The two tools read the first line only; the other lines are ours. `rpl capture` writes them, so that a
recording holds everything that its camera reported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rpl_data.files import read_text, write_text
from rpl_data.formats.recordings.frame_files import Camera
from rpl_data.types import DataError, Intrinsics

WHAT = "one line: fx fy cx cy, in pixels of the colour images"


@dataclass(frozen=True)
class CameraFile:
    """Content of the file; `metres_per_unit` of the depth images is None where it is not given."""

    camera: Camera
    metres_per_unit: float | None = None


def read_camera(path: Path) -> CameraFile:
    """Read a camera.txt; DataError when it is missing or its numbers are invalid."""
    if not path.exists():
        raise DataError(f"{path} is missing; write it with {WHAT}")
    first, *others = read_text(path).strip().splitlines() or [""]
    try:
        fx, fy, cx, cy = (float(token) for token in first.split())
    except ValueError as error:
        raise DataError(f"{path}: expected {WHAT}; found {first!r}") from error
    if not all(map(math.isfinite, (fx, fy, cx, cy))) or fx <= 0 or fy <= 0:
        raise DataError(f"{path}: fx fy cx cy must be finite and fx, fy positive; found {first!r}")
    said = _said(path, others)
    unit = said.get("metres_per_unit")
    return CameraFile((fx, fy, cx, cy, *said.get("distortion", ())), unit[0] if unit else None)


def _said(path: Path, lines: Sequence[str]) -> Mapping[str, tuple[float, ...]]:
    """Read our own lines; unknown lines are ignored."""
    counts = {"distortion": (4, 5, 8), "metres_per_unit": (1,)}
    said: dict[str, tuple[float, ...]] = {}
    for line in lines:
        key, *tokens = line.split() or [""]
        if key not in counts:
            continue
        try:
            said[key] = tuple(float(token) for token in tokens)
        except ValueError as error:
            raise DataError(f"{path}: {error} in {line!r}; repair or delete the line") from error
        if len(said[key]) not in counts[key]:
            allowed = " or ".join(map(str, counts[key]))
            raise DataError(f"{path}: expected {allowed} numbers after {key}, found {line!r}")
    return said


def write_camera(folder: Path, intrinsics: Intrinsics, metres_per_unit: float | None = None) -> None:
    """Write camera.txt of a dataset folder."""
    write_text(folder / "camera.txt", camera_text(intrinsics, metres_per_unit))


def camera_text(intrinsics: Intrinsics, metres_per_unit: float | None = None) -> str:
    """Text that `write_camera` writes."""
    text = _numbers((intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy))
    if any(intrinsics.distortion):
        text += f"distortion {_numbers(intrinsics.distortion)}"
    if metres_per_unit is not None:
        text += f"metres_per_unit {_numbers([metres_per_unit])}"
    return text


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values) + "\n"

"""The dataset tree of RapidPoseLabels, read and written.

::

    <dataset>/camera.txt                 "fx fy cx cy" in pixels, one camera for all scenes, no distortion
    <dataset>/<scene>/associations.txt   a line a frame: "<t> depth/<file> <t> rgb/<file>", or rgb first
                      camera.poses       TUM lines "t tx ty tz qx qy qz qw", scene_from_camera
                      rgb/ depth/        depth: 16-bit images, registered to colour

The original pairs poses and frames by row; a tracker that drops a frame (ElasticFusion always drops
the last) then shifts every pose behind it, so here they are matched by time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import read_text, write_text
from rpl_data.formats.image_files import ImageHeader, probe
from rpl_data.formats.plausibility import SATURATED, median_depth_m, principal_point_notes
from rpl_data.formats.pose_lines import (
    data_lines,
    finite_numbers,
    nearest,
    read_pose_lines,
    write_pose_lines,
)
from rpl_data.types import DataError, Frame, Intrinsics, Recording, Scene, Trajectory

DEFAULT_METRES_PER_UNIT = 0.001

Headers = Mapping[Path, ImageHeader | None]


@dataclass(frozen=True)
class _Row:
    """A line of associations.txt; `pair` are its two images as listed, `times_s` their times."""

    index: int
    times_s: tuple[float, float]
    pair: tuple[Path, Path]


@dataclass(frozen=True)
class _Layout:
    """What all lines of a scene share: which of the two images is depth, and their size."""

    depth: int
    color: int
    width: int
    height: int


# Reading ------------------------------------------------------------------------------------------


def read_rpl(
    path: Path, *, names: Sequence[str] | None = None, metres_per_unit: float | None = None
) -> list[Recording]:
    """The scenes of a RapidPoseLabels tree, sorted by name.

    Frames without a pose, without depth or with an unreadable image are left out and named in
    `Recording.skipped`; those that stay keep their row in associations.txt as `Frame.index`. A scene
    without camera.poses has no trajectory (it must be tracked).

    Args:
        path: the folder with camera.txt and the scene folders, or one scene folder below it.
        names: which scenes to read, by folder name; for a single scene folder, what to call it.
        metres_per_unit: of the depth images; 0.001 where not given, said in `Recording.notes`.

    Raises:
        DataError: a file is missing or broken, a scene has no usable frame, the images do not fit
            the camera, or depths are outside 0.1-10 m, so the depth unit must be wrong.
    """
    path = path.absolute()
    if not path.is_dir():
        raise DataError(f"{path} is not a folder; expected a folder with camera.txt and scene folders")
    if metres_per_unit is not None and not 0 < metres_per_unit < math.inf:
        raise DataError(f"metres_per_unit must be positive, got {metres_per_unit}; 0.001 means millimetres")
    single = (path / "associations.txt").exists()
    camera_file = (path.parent if single and not (path / "camera.txt").exists() else path) / "camera.txt"
    camera = _read_camera(camera_file)
    folders = _single_scene(path, names) if single else _scene_folders(path, names)
    return [
        _read_scene(folder, name, camera, camera_file, metres_per_unit) for name, folder in folders.items()
    ]


def _single_scene(path: Path, names: Sequence[str] | None) -> dict[str, Path]:
    if names is not None and len(names) != 1:
        raise DataError(f"{path} is one scene, but names has {len(names)} entries: {list(names)}; give one")
    return {path.name if names is None else str(names[0]): path}


def _scene_folders(path: Path, names: Sequence[str] | None) -> dict[str, Path]:
    marks = ("associations.txt", "camera.poses", "rgb", "depth")
    found = {p.name: p for p in sorted(path.iterdir()) if any((p / mark).exists() for mark in marks)}
    if not found:
        raise DataError(f"{path} has no scene: none of its folders holds an associations.txt")
    unknown = [name for name in names or [] if name not in found]
    if unknown:
        raise DataError(f"{path} has no scene {', '.join(map(str, unknown))}; it has {', '.join(found)}")
    return found if names is None else {name: found[name] for name in sorted(names)}


def _read_camera(path: Path) -> tuple[float, float, float, float]:
    what = "one line: fx fy cx cy, in pixels of the colour images"
    if not path.exists():
        raise DataError(f"{path} is missing; write it with {what}")
    line = (read_text(path).strip().splitlines() or [""])[0]
    try:
        fx, fy, cx, cy = (float(token) for token in line.split())
    except ValueError as error:
        raise DataError(f"{path}: expected {what}; found {line!r}") from error
    if not all(map(math.isfinite, (fx, fy, cx, cy))) or fx <= 0 or fy <= 0:
        raise DataError(f"{path}: fx fy cx cy must be finite and fx, fy positive; found {line!r}")
    return fx, fy, cx, cy


def _read_scene(
    folder: Path,
    name: str,
    camera: tuple[float, float, float, float],
    camera_file: Path,
    metres_per_unit: float | None,
) -> Recording:
    rows = _read_associations(folder)
    headers = {path: probe(path) for row in rows for path in row.pair}
    layout = _find_layout(folder, rows, headers)
    intrinsics = Intrinsics(*camera, layout.width, layout.height)
    notes = principal_point_notes(camera_file, intrinsics)
    frames, skipped = _whole_frames(rows, headers, layout)
    trajectory: Trajectory | None = None
    if (folder / "camera.poses").exists():
        trajectory = _match_poses(folder, rows, frames, color=layout.color)
        posed = set(trajectory.frames.tolist())
        unposed = [frame.index for frame in frames if frame.index not in posed]
        frames = [frame for frame in frames if frame.index in posed]
        skipped += _group(unposed, "without a pose in camera.poses at their time")
    else:
        notes.append("no camera.poses: the camera must be tracked")
    if not frames:
        raise DataError(
            f"scene {name} ({folder}): none of {len(rows)} frames is usable: {'; '.join(skipped)}"
        )
    unit_m = DEFAULT_METRES_PER_UNIT if metres_per_unit is None else metres_per_unit
    scene = Scene(
        name, intrinsics, unit_m, tuple(frames), no_depth_units=(SATURATED,), source=f"rpl: {folder}"
    )
    median_m = median_depth_m(scene)
    if metres_per_unit is None:
        notes.append(
            f"metres_per_unit not given, assumed {unit_m:g}: the median depth is then {median_m:.2f} m"
        )
    return Recording(scene, trajectory, tuple(skipped), tuple(notes))


def _read_associations(folder: Path) -> list[_Row]:
    path = folder / "associations.txt"
    rows: list[_Row] = []
    for number, line in data_lines(path):
        tokens = line.split()
        if len(tokens) != 4:
            raise DataError(f"{path} line {number}: expected <t> depth/<file> <t> rgb/<file>, found {line!r}")
        times = finite_numbers([tokens[0], tokens[2]], path, number)
        rows.append(_Row(len(rows), (times[0], times[1]), (folder / tokens[1], folder / tokens[3])))
    if not rows:
        raise DataError(f"{path} is empty; expected a line a frame: <t> depth/<file> <t> rgb/<file>")
    return rows


def _find_layout(folder: Path, rows: Sequence[_Row], headers: Headers) -> _Layout:
    """The layout that the first line with two whole images shows."""
    for row in rows:
        first, second = (headers[path] for path in row.pair)
        if first is None or second is None:
            continue
        if first.is_depth == second.is_depth:
            raise DataError(
                f"{folder / 'associations.txt'}: of {row.pair[0].name} and {row.pair[1].name} one should be "
                "depth (16 bit, one channel) and the other colour; correct the names or convert the images"
            )
        if (first.width, first.height) != (second.width, second.height):
            raise DataError(
                f"{folder}: depth and colour images differ in size ({first.width}x{first.height} and "
                f"{second.width}x{second.height}): depth must be registered to colour when recording"
            )
        depth = 0 if first.is_depth else 1
        return _Layout(depth, 1 - depth, first.width, first.height)
    raise DataError(
        f"{folder}: none of {len(rows)} frames has two readable images; the first names {rows[0].pair[0]} "
        f"and {rows[0].pair[1]}; copy the images or correct the paths in associations.txt"
    )


def _whole_frames(rows: Sequence[_Row], headers: Headers, layout: _Layout) -> tuple[list[Frame], list[str]]:
    """Frames with two good images and a time of their own, and a line for each reason to leave some out."""
    frames: list[Frame] = []
    left_out: dict[str, list[int]] = {}
    times: set[float] = set()
    for row in rows:
        color, depth, time_s = row.pair[layout.color], row.pair[layout.depth], row.times_s[layout.color]
        defect = _defect("colour", color, headers[color], layout) or _defect(
            "depth", depth, headers[depth], layout
        )
        if defect is None and time_s in times:
            defect = "with the timestamp of an earlier frame"
        if defect is None:
            times.add(time_s)
            frames.append(Frame(row.index, time_s, color, depth))
        else:
            left_out.setdefault(defect, []).append(row.index)
    return frames, [line for reason, indices in left_out.items() for line in _group(indices, reason)]


def _defect(kind: str, path: Path, header: ImageHeader | None, layout: _Layout) -> str | None:
    if not path.exists():
        return f"without {kind} (no such file)"
    if header is None:
        return f"with an unreadable or truncated {kind} image"
    if header.is_depth != (kind == "depth"):
        return f"with a {kind} image of another type"
    if (header.width, header.height) != (layout.width, layout.height):
        return f"with a {kind} image of another size"
    return None


def _group(indices: Sequence[int], reason: str, *, listed: int = 12) -> list[str]:
    """One line for frames left out for one reason; none for no frames."""
    if not indices:
        return []
    more = ", ..." if len(indices) > listed else ""
    plural = "frame" if len(indices) == 1 else "frames"
    return [f"{len(indices)} {plural} {reason}: {', '.join(map(str, indices[:listed]))}{more}"]


def _match_poses(
    folder: Path, rows: Sequence[_Row], frames: Sequence[Frame], *, color: int, max_apart_s: float = 0.02
) -> Trajectory:
    """The pose nearest in time of each frame that has one within half a frame interval.

    Trackers stamp a pose with the colour's or the depth's time; the one that fits better is used.
    """
    times_s, poses = read_pose_lines(folder / "camera.poses")
    indices = np.array([frame.index for frame in frames], dtype=np.int64)
    if not frames:
        return Trajectory(indices, np.empty((0, 4, 4)))
    stamps_s = np.array([rows[frame.index].times_s for frame in frames])
    candidates = [nearest(times_s, stamps_s[:, column]) for column in (color, 1 - color)]
    row, apart_s = min(candidates, key=lambda candidate: float(np.median(candidate[1])))
    steps_s = np.diff(np.unique([r.times_s[color] for r in rows]))
    interval_s = float(np.median(steps_s)) if len(steps_s) else math.inf
    matched = apart_s <= min(max_apart_s, interval_s / 2)
    if not matched.any():
        raise DataError(
            f"{folder}: no pose in camera.poses ({times_s[0]:.6f} to {times_s[-1]:.6f} s) "
            f"is at the time of a frame ({stamps_s.min():.6f} to {stamps_s.max():.6f} s); both files "
            "must use the same clock, in seconds"
        )
    return Trajectory(indices[matched], poses[row[matched]])


# Writing ------------------------------------------------------------------------------------------


def write_camera(folder: Path, intrinsics: Intrinsics) -> None:
    """Write camera.txt of a dataset folder; DataError for a lens with distortion, which it cannot hold."""
    if any(intrinsics.distortion):
        raise DataError(f"camera.txt in {folder} cannot hold lens distortion; undistort the images first")
    values = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    write_text(folder / "camera.txt", " ".join(repr(float(value)) for value in values) + "\n")


def write_associations(
    scene_folder: Path, timestamps_s: Iterable[float], colors: Iterable[str], depths: Iterable[str]
) -> None:
    """Write associations.txt, depth first; images are named relative to the scene folder (rgb/000000.jpg)."""
    rows = zip(timestamps_s, colors, depths, strict=True)
    lines = [f"{t:.6f} {depth} {t:.6f} {color}\n" for t, color, depth in rows]
    write_text(scene_folder / "associations.txt", "".join(lines))


def write_poses(
    scene_folder: Path, timestamps_s: Iterable[float], scene_from_camera: Float64[np.ndarray, "n 4 4"]
) -> None:
    """Write camera.poses, a TUM line a pose."""
    write_pose_lines(scene_folder / "camera.poses", timestamps_s, scene_from_camera)

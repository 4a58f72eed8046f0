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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.files import read_text, write_text
from rpl_data.formats.image_files import ImageHeader, probe
from rpl_data.geometry import from_quaternion_xyzw, to_quaternion_xyzw
from rpl_data.types import DataError, Frame, Intrinsics, Recording, Scene, Trajectory

DEFAULT_METRES_PER_UNIT = 0.001
SATURATED = 65535
"""What a Kinect writes where it saw nothing; no 16-bit depth reaches it otherwise."""


@dataclass(frozen=True)
class _Row:
    """A line of associations.txt; `pair` are its two images as listed, `times_s` their times."""

    index: int
    times_s: tuple[float, float]
    pair: tuple[Path, Path]


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
        raise DataError(
            f"metres_per_unit must be a positive number, got {metres_per_unit}; 0.001 means millimetres"
        )
    if (path / "associations.txt").exists():
        folders = _single_scene(path, names)
        camera = path / "camera.txt" if (path / "camera.txt").exists() else path.parent / "camera.txt"
    else:
        camera = path / "camera.txt"
    focal_and_centre = _read_camera(camera)
    if not (path / "associations.txt").exists():
        folders = _scene_folders(path, names)
    return [_read_scene(folder, name, focal_and_centre, metres_per_unit) for name, folder in folders.items()]


def _single_scene(path: Path, names: Sequence[str] | None) -> dict[str, Path]:
    if names is not None and len(names) != 1:
        raise DataError(
            f"{path} is a single scene, but names has {len(names)} entries: {list(names)}; give one"
        )
    return {path.name if names is None else str(names[0]): path}


def _scene_folders(path: Path, names: Sequence[str] | None) -> dict[str, Path]:
    found = {p.parent.name: p.parent for p in sorted(path.glob("*/associations.txt"))}
    if not found:
        raise DataError(f"{path} has no scene: no folder in it has an associations.txt")
    unknown = [name for name in names or [] if name not in found]
    if unknown:
        raise DataError(f"{path} has no scene {', '.join(map(str, unknown))}; it has {', '.join(found)}")
    return found if names is None else {name: found[name] for name in sorted(names)}


def _read_camera(path: Path) -> tuple[float, float, float, float]:
    if not path.exists():
        raise DataError(
            f"{path} is missing; write one line into it: fx fy cx cy, in pixels of the colour images"
        )
    line = (read_text(path).strip().splitlines() or [""])[0]
    try:
        fx, fy, cx, cy = (float(token) for token in line.split())
    except ValueError as error:
        raise DataError(f"{path}: the first line must be four numbers fx fy cx cy, found {line!r}") from error
    if not all(map(math.isfinite, (fx, fy, cx, cy))) or fx <= 0 or fy <= 0:
        raise DataError(
            f"{path}: fx fy cx cy must be finite and fx, fy positive, found {line!r}; calibrate again"
        )
    return fx, fy, cx, cy


def _read_scene(
    folder: Path, name: str, camera: tuple[float, float, float, float], metres_per_unit: float | None
) -> Recording:
    rows = _read_associations(folder)
    headers = {path: probe(path) for row in rows for path in row.pair}
    depth_column = _depth_column(folder, rows, headers)
    frames, skipped = _whole_frames(rows, headers, depth_column)
    notes: list[str] = []
    trajectory: Trajectory | None = None
    if (folder / "camera.poses").exists():
        rows_left = [rows[frame.index] for frame in frames]
        trajectory, unposed = _match_poses(
            folder, rows_left, interval_s=_interval_s(rows), color=1 - depth_column
        )
        frames = [frame for frame in frames if frame.index not in set(unposed)]
        skipped += _group(unposed, "without a pose in camera.poses at their time")
    else:
        notes.append("no camera.poses: the camera must be tracked")
    if not frames:
        raise DataError(f"scene {name} ({folder}) has no usable frame of {len(rows)}: {'; '.join(skipped)}")
    first = headers[frames[0].color]
    assert first is not None  # frames that stay have a header
    intrinsics = Intrinsics(*camera, first.width, first.height)
    notes += _check_principal_point(folder, intrinsics)
    scene = Scene(
        name,
        intrinsics,
        DEFAULT_METRES_PER_UNIT if metres_per_unit is None else metres_per_unit,
        tuple(frames),
        no_depth_units=(SATURATED,),
        source=f"rpl: {folder}",
    )
    median_m = _median_depth_m(scene)
    if metres_per_unit is None:
        notes.append(
            f"depth unit not given, assumed {scene.metres_per_unit:g} m: the median depth is then {median_m:.2f} m; "
            "set metres_per_unit if that is wrong"
        )
    return Recording(scene, trajectory, tuple(skipped), tuple(notes))


def _read_associations(folder: Path) -> list[_Row]:
    path = folder / "associations.txt"
    rows: list[_Row] = []
    for number, line in _data_lines(path):
        tokens = line.split()
        if len(tokens) != 4:
            raise DataError(
                f"{path} line {number}: expected '<t> depth/<file> <t> rgb/<file>', found {line!r}"
            )
        times = _numbers([tokens[0], tokens[2]], path, number)
        rows.append(_Row(len(rows), (times[0], times[1]), (folder / tokens[1], folder / tokens[3])))
    if not rows:
        raise DataError(f"{path} is empty; expected a line a frame: <t> depth/<file> <t> rgb/<file>")
    return rows


def _data_lines(path: Path) -> Iterable[tuple[int, str]]:
    """Line numbers and lines that are neither empty nor a comment."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line.strip()


def _numbers(tokens: Sequence[str], path: Path, number: int) -> list[float]:
    try:
        values = [float(token) for token in tokens]
    except ValueError as error:
        raise DataError(f"{path} line {number}: {error}; repair or delete the line") from error
    if not all(map(math.isfinite, values)):
        raise DataError(
            f"{path} line {number}: numbers must be finite, found {' '.join(tokens)}; repair or delete it"
        )
    return values


def _depth_column(folder: Path, rows: Sequence[_Row], headers: dict[Path, ImageHeader | None]) -> int:
    """0 or 1: which image of a line is the depth image; the first line with two whole images tells."""
    for row in rows:
        first, second = (headers[path] for path in row.pair)
        if first is None or second is None:
            continue
        if first.is_depth == second.is_depth:
            raise DataError(
                f"{folder / 'associations.txt'}: of {row.pair[0].name} and {row.pair[1].name} exactly one should be "
                "a 16-bit image of one channel (depth); the other one colour"
            )
        if (first.width, first.height) != (second.width, second.height):
            raise DataError(
                f"{folder}: depth and colour images differ in size ({first.width}x{first.height} and "
                f"{second.width}x{second.height}): depth must be registered to colour; align it when recording"
            )
        return 0 if first.is_depth else 1
    raise DataError(
        f"{folder}: no line of associations.txt names two readable images; the first names {rows[0].pair[0]} and "
        f"{rows[0].pair[1]}; copy the images or correct the paths"
    )


def _whole_frames(
    rows: Sequence[_Row], headers: dict[Path, ImageHeader | None], depth_column: int
) -> tuple[list[Frame], list[str]]:
    """Frames with two good images and a time of their own, and a line for each reason to leave some out."""
    frames: list[Frame] = []
    reasons: dict[str, list[int]] = {}
    times: set[float] = set()
    size: tuple[int, int] | None = None
    for row in rows:
        depth, color = row.pair[depth_column], row.pair[1 - depth_column]
        reason = _defect(color, headers[color], size, "colour") or _defect(
            depth, headers[depth], size, "depth"
        )
        time_s = row.times_s[1 - depth_column]
        if reason is None and time_s in times:
            reason = "with the timestamp of an earlier frame"
        if reason is not None:
            reasons.setdefault(reason, []).append(row.index)
            continue
        header = headers[color]
        size = size or (None if header is None else (header.width, header.height))
        times.add(time_s)
        frames.append(Frame(row.index, time_s, color, depth))
    return frames, [line for reason, indices in reasons.items() for line in _group(indices, reason)]


def _defect(path: Path, header: ImageHeader | None, size: tuple[int, int] | None, kind: str) -> str | None:
    if header is None:
        return (
            f"without {kind} (no such file)"
            if not path.exists()
            else f"with an unreadable or truncated {kind} image"
        )
    if header.is_depth != (kind == "depth"):
        return f"with a {kind} image of another type"
    if size is not None and (header.width, header.height) != size:
        return f"with a {kind} image of another size"
    return None


def _group(indices: Sequence[int], reason: str, *, listed: int = 12) -> list[str]:
    """One line for frames left out for one reason; none for no frames."""
    if not indices:
        return []
    more = ", ..." if len(indices) > listed else ""
    plural = "frame" if len(indices) == 1 else "frames"
    return [f"{len(indices)} {plural} {reason}: {', '.join(map(str, indices[:listed]))}{more}"]


def _interval_s(rows: Sequence[_Row]) -> float:
    """Median time between frames; infinite for one frame."""
    times = np.unique([row.times_s[0] for row in rows])
    return float(np.median(np.diff(times))) if len(times) > 1 else math.inf


def _read_poses(path: Path) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 4 4"]]:
    """Times, sorted, and scene_from_camera of camera.poses."""
    times: list[float] = []
    poses: list[np.ndarray] = []
    for number, line in _data_lines(path):
        tokens = line.split()
        if len(tokens) != 8:
            raise DataError(f"{path} line {number}: expected 't tx ty tz qx qy qz qw', found {line!r}")
        values = np.array(_numbers(tokens, path, number))
        if not 0.9 < np.linalg.norm(values[4:]) < 1.1:
            raise DataError(
                f"{path} line {number}: qx qy qz qw is not a unit quaternion: {line!r}; repair or delete it"
            )
        times.append(values[0])
        poses.append(from_quaternion_xyzw(values[4:], values[1:4]))
    if not times:
        raise DataError(
            f"{path} is empty (ElasticFusion writes it when it exits, not when it is killed); track the scene again, "
            "or delete the file to have the camera tracked here"
        )
    order = np.argsort(times, kind="stable")
    return np.array(times)[order], np.array(poses)[order]


def _match_poses(
    folder: Path, rows: Sequence[_Row], *, interval_s: float, color: int, max_apart_s: float = 0.02
) -> tuple[Trajectory, list[int]]:
    """The pose of each row nearest in time, and the rows that have none within half a frame interval.

    Trackers stamp a pose with the colour's or the depth's time; the one that fits better is used.
    """
    times_s, poses = _read_poses(folder / "camera.poses")
    distances = []
    for column in (color, 1 - color):
        t = np.array([row.times_s[column] for row in rows])
        right = np.clip(np.searchsorted(times_s, t), 1, max(1, len(times_s) - 1))
        near = np.stack([np.minimum(right, len(times_s) - 1), right - 1])
        best = near[np.abs(times_s[near] - t).argmin(axis=0), np.arange(len(t))]
        distances.append((np.abs(times_s[best] - t), best))
    apart_s, nearest = min(distances, key=lambda pair: float(np.median(pair[0])) if len(rows) else 0.0)
    matched = apart_s <= min(max_apart_s, interval_s / 2)
    if len(rows) and not matched.any():
        t0, t1 = rows[0].times_s[color], rows[-1].times_s[color]
        raise DataError(
            f"{folder}: no pose of camera.poses ({times_s[0]:.6f} to {times_s[-1]:.6f} s) is at the time of a frame "
            f"({t0:.6f} to {t1:.6f} s); both files must use the same clock, in seconds"
        )
    indices = np.array([row.index for row in rows], dtype=np.int64)
    return Trajectory(indices[matched], poses[nearest[matched]].reshape(-1, 4, 4)), indices[~matched].tolist()


# Plausibility -------------------------------------------------------------------------------------


def _check_principal_point(folder: Path, intrinsics: Intrinsics) -> list[str]:
    """A note when the principal point is off the centre by 10 % of the image; DataError at 20 %."""
    off = max(
        abs(intrinsics.cx / intrinsics.width - 0.5),
        abs(intrinsics.cy / intrinsics.height - 0.5),
    )
    what = (
        f"camera.txt has its principal point at ({intrinsics.cx:.1f}, {intrinsics.cy:.1f}), but the images of {folder} "
        f"are {intrinsics.width}x{intrinsics.height}: is it of another resolution?"
    )
    if off > 0.2:
        raise DataError(f"{what} Write fx fy cx cy of these images into camera.txt")
    return [what] if off > 0.1 else []


def _median_depth_m(scene: Scene, *, frames: int = 5) -> float:
    """Median depth of a few frames; DataError when it cannot be that of a hand-held recording."""
    picked = [scene.frames[i] for i in np.unique(np.linspace(0, len(scene.frames) - 1, frames).astype(int))]
    images = [cv2.imread(str(frame.depth), cv2.IMREAD_UNCHANGED) for frame in picked]
    raw = np.concatenate([np.ravel(image) for image in images if image is not None] or [np.zeros(0)])
    raw = raw[(raw > 0) & (raw < SATURATED)]
    if len(raw) == 0:
        raise DataError(
            f"scene {scene.name}: the depth images hold no depth, looked at frames {[f.index for f in picked]}"
        )
    median_m = float(np.median(raw)) * scene.metres_per_unit
    if not 0.1 <= median_m <= 10:
        likely = min(
            (1e-3, 2e-4, 1e-4, 2.5e-4), key=lambda unit: abs(math.log(float(np.median(raw)) * unit / 0.8))
        )
        raise DataError(
            f"scene {scene.name}: with {scene.metres_per_unit:g} m a depth unit the median depth is {median_m:.3g} m; "
            f"expected 0.1 to 10 m. Set metres_per_unit, probably to {likely:g}"
        )
    return median_m


# Writing ------------------------------------------------------------------------------------------


def write_camera(folder: Path, intrinsics: Intrinsics) -> None:
    """Write camera.txt of a dataset folder; DataError for a lens with distortion, which it cannot hold."""
    if any(intrinsics.distortion):
        raise DataError(f"camera.txt in {folder} cannot hold lens distortion; undistort the images first")
    write_text(
        folder / "camera.txt", f"{intrinsics.fx!r} {intrinsics.fy!r} {intrinsics.cx!r} {intrinsics.cy!r}\n"
    )


def write_associations(
    scene_folder: Path, timestamps_s: Iterable[float], colors: Iterable[str], depths: Iterable[str]
) -> None:
    """Write associations.txt, depth first; images are named relative to the scene folder (rgb/000000.jpg)."""
    rows = zip(timestamps_s, colors, depths, strict=True)
    write_text(
        scene_folder / "associations.txt",
        "".join(f"{t:.6f} {depth} {t:.6f} {color}\n" for t, color, depth in rows),
    )


def write_poses(
    scene_folder: Path, timestamps_s: Iterable[float], scene_from_camera: Float64[np.ndarray, "n 4 4"]
) -> None:
    """Write camera.poses, a TUM line a pose."""
    lines = []
    for t, pose in zip(timestamps_s, scene_from_camera, strict=True):
        values = " ".join(f"{value:.9f}" for value in (*pose[:3, 3], *to_quaternion_xyzw(pose)))
        lines.append(f"{t:.6f} {values}\n")
    write_text(scene_folder / "camera.poses", "".join(lines))

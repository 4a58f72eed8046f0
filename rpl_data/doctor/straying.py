"""Tell drift of the poses from constant faults, and measure it.

A wrong depth unit and wrong intrinsics make depth images disagree much as drift does. But once a constant
fault is corrected, the poses fit the images; poses that drift do not fit them under any constant correction.
So the relative poses of some frames are computed from brightness and depth (`reconstruct.path_correction`),
and the given ones are compared with them, before and after the correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float32

from rpl_data.doctor.consistency import Geometry, choose_pairs, differences
from rpl_data.doctor.findings import Finding
from rpl_data.drift.drift import MAX_DRIFT_MM, Drift, cut, measure_drift
from rpl_data.drift.reprojection import spread_rows
from rpl_data.geometry import rays
from rpl_data.images import read_grey
from rpl_data.types import (
    DataError,
    DepthImage,
    Frame,
    Intrinsics,
    ReadDepth,
    Scene,
    Trajectory,
    posed_frames,
)

Depths = Float32[np.ndarray, "n height width"]

SURE = 0.9

MOST_FRAMES, MOST_IN_STRETCH = 24, 12
"""Frames that are aligned to one another: of a whole recording, however long it is, and of a stretch."""

EXPLAINED = 0.2
"""A constant fault that leaves more than this share of the drift does not explain it, unless what it leaves
is surely within the limit."""


def drift_findings(
    scene: Scene,
    trajectory: Trajectory,
    read_depth: ReadDepth,
    advance: Callable[[int, int], None],
    *,
    by_images: bool,
) -> tuple[str, list[Finding]]:
    """Measure how far the poses drift over a recording: what to say of it, and a finding if it is too far.

    Args:
        read_depth: reads a depth image; all 0 where it is damaged.
        advance: called with the number of images read and of all images.
        by_images: compare the poses with a path computed from colour and depth, too.
    """
    if by_images:
        drift, _ = _drift(scene, trajectory, read_depth, MOST_FRAMES, advance)
    else:
        drift = measure_drift(scene, trajectory, read_depth, advance=advance)
    said = (
        f"over the recording the poses drift by {1000 * drift.whole_m:.0f} mm, beyond the "
        f"{1000 * drift.noise_m:.0f} mm that neighbouring depth images differ by"
    )
    sure = drift.sure_beyond(MAX_DRIFT_MM / 1000)
    if sure < SURE:
        return said, []
    spans = cut(drift, max_drift_m=MAX_DRIFT_MM / 1000)
    what = f"the poses drift by {1000 * drift.whole_m:.0f} mm over the recording, and so would labels"
    todo = "too fast for cutting to mend it: record again, more slowly, or have the camera tracked"
    if spans is not None:
        todo = (
            f"`rpl build` cuts the recording into {len(spans)} scenes when each has clicks on 4 keypoints "
            "(frames "
            f"{', '.join(f'{first} to {last}' for first, last in spans)}); the limit is "
            f"`reconstruct: {{max_drift_mm: {MAX_DRIFT_MM:.0f}}}`"
        )
    return said, [Finding("drift", what, sure, todo)]


def explains(
    corrected: Geometry,
    given: Geometry,
    *,
    scene: Scene,
    stretches: tuple[tuple[Frame, ...], ...],
    depths_m: Depths,
) -> bool:
    """Whether constant faults explain what the images say of the poses, so that drift is not needed.

    They do where the poses of each stretch surely fit its images under the corrected geometry, or at least
    five times as well as under the given one (a gross fault with drift beside it is mended first), and where
    depth agrees no better on the path by the images. Frames of a stretch are near in time and drift little.

    Args:
        corrected: the geometry after the corrections.
        given: the geometry as recorded.
        stretches: stretches of consecutive frames; their depth images follow one another in `depths_m`.
    """
    first = 0
    for frames in stretches:
        rows = slice(first, first + len(frames))
        first += len(frames)
        left, _ = _in_stretch(scene, frames, _rows_of(corrected, rows), depths_m[rows])
        if 1 - left.sure_beyond(MAX_DRIFT_MM / 1000) >= SURE:
            continue
        before, path = _in_stretch(scene, frames, _rows_of(given, rows), depths_m[rows])
        if path is None or left.whole_m <= EXPLAINED * before.whole_m:
            continue
        if _agrees_better(path, frames, _rows_of(given, rows), _rows_of(corrected, rows), depths_m[rows]):
            return False
    return True


def _agrees_better(
    path: Trajectory, frames: tuple[Frame, ...], given: Geometry, corrected: Geometry, depths_m: Depths
) -> bool:
    """Whether depth agrees better on the path, all else as given, than under the corrected geometry."""
    used = np.flatnonzero(np.isin([frame.index for frame in frames], path.frames))
    compared = choose_pairs(depths_m[used], [(0, len(used))])
    by_images = differences(compared, replace(given, scene_from_camera=path.scene_from_camera))
    by_fault = differences(compared, replace(corrected, scene_from_camera=corrected.scene_from_camera[used]))
    both = np.isfinite(by_images) & np.isfinite(by_fault)
    return bool(both.any() and by_images[both].mean() < by_fault[both].mean())


def _rows_of(geometry: Geometry, rows: slice) -> Geometry:
    return replace(geometry, scene_from_camera=geometry.scene_from_camera[rows])


def _in_stretch(
    scene: Scene,
    frames: tuple[Frame, ...],
    geometry: Geometry,
    depths_m: Depths,
) -> tuple[Drift, Trajectory | None]:
    """Drift of the poses within a stretch under some geometry, and the path by the images."""
    posed = np.isfinite(geometry.scene_from_camera).all(axis=(1, 2))
    indices = np.array([frame.index for frame in frames], dtype=np.int64)
    depth_of = dict(zip(indices.tolist(), depths_m, strict=True))
    factor = geometry.metres_factor * np.ones((), np.float32)
    if geometry.along_ray:
        factor = factor / _ray_lengths(geometry.intrinsics)
    return _drift(
        replace(scene, frames=frames, intrinsics=geometry.intrinsics),
        Trajectory(indices[posed], geometry.scene_from_camera[posed]),
        lambda frame: (depth_of[frame.index] * factor).astype(np.float32),
        MOST_IN_STRETCH,
        lambda done, total: None,
    )


def _ray_lengths(camera: Intrinsics) -> Float32[np.ndarray, "height width"]:
    """Length of each pixel's ray to the plane at depth 1."""
    v, u = np.mgrid[: camera.height, : camera.width]
    directions = rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    lengths: Float32[np.ndarray, " pixels"] = np.linalg.norm(directions, axis=1).astype(np.float32)
    return lengths.reshape(camera.height, camera.width)


def _drift(
    scene: Scene,
    trajectory: Trajectory,
    read_depth: ReadDepth,
    most: int,
    advance: Callable[[int, int], None],
) -> tuple[Drift, Trajectory | None]:
    """Drift by depth and by the path that the images of `most` frames give, and that path."""
    read_depth = cache(read_depth)  # the same images serve the path and the measurement
    frames = posed_frames(scene, trajectory, with_depth=True)
    chosen = [frames[row] for row in spread_rows(len(frames), most)]  # those that `measure_drift` reads
    corrected = _path_by_images(scene, trajectory, chosen, read_depth)
    drift = measure_drift(
        scene, trajectory, read_depth, corrected=corrected, most_frames=most, advance=advance
    )
    return drift, corrected


def _path_by_images(
    scene: Scene, trajectory: Trajectory, frames: list[Frame], read_depth: ReadDepth
) -> Trajectory | None:
    """Poses of some frames by their images; only of those that aligned pairs connect, None where none are."""
    from rpl_data.reconstruct.path_correction import correct_path
    from rpl_data.reconstruct.view import REDUCE, Viewer

    readable: dict[int, tuple[np.ndarray, DepthImage]] = {}
    for frame in frames:
        try:
            grey, depth_m = read_grey(frame, reduce=REDUCE), read_depth(frame)
        except DataError:  # already a finding where it was examined; the drift is measured without it
            continue
        if depth_m.any():
            readable[frame.index] = grey, depth_m
    used = [frame for frame in frames if frame.index in readable]
    if len(used) < 2:
        return None
    poses = np.array([trajectory.at(frame.index) for frame in used])
    path = Trajectory(np.array([frame.index for frame in used], dtype=np.int64), poses)
    viewer = Viewer(scene.intrinsics)
    found = correct_path(
        replace(scene, frames=tuple(used)), path, lambda frame: viewer.look(*readable[frame.index])
    )
    if found.tied.sum() < 2:
        return None
    return Trajectory(found.trajectory.frames[found.tied], found.trajectory.scene_from_camera[found.tied])

"""Examine a scene: read some stretches of it, run every check, and collect the findings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64

from rpl_data.doctor import image_faults, timing
from rpl_data.doctor.alignment import Alignment, align
from rpl_data.doctor.consistency import ComparedImages, Geometry, choose_pairs, differences
from rpl_data.doctor.corrections import faults, shifted
from rpl_data.doctor.depth_unit import by_the_numbers, with_turned_bits
from rpl_data.doctor.edges import FrameEdges, edges_of
from rpl_data.doctor.findings import Diagnosis, Finding
from rpl_data.doctor.pairing import SURE, decide_what_lags, lag_findings, lag_of, misregistered
from rpl_data.doctor.straying import drift_findings, explains
from rpl_data.doctor.tags import orientation_tags
from rpl_data.images import read_color, read_depth_m
from rpl_data.types import DataError, DepthImage, Frame, Recording, Scene, Trajectory
from rpl_data.wording import counted

UNSURE_FRAMES, UNSURE_PX = 1.0, 8.0
LEFT_OUT = "copy these images again, or remove them from the list; they are not used"
STILL_M, STILL_RAD = 0.02, 0.05
"""A camera that moves and turns less than this within a stretch says nothing about its poses."""


@dataclass(frozen=True)
class _Sample:
    """The frames that were read of a scene.

    Attributes:
        positions: their positions in `Scene.frames`.
        runs: stretches of consecutive frames: (first, last + 1) row numbers of the fields here.
    """

    positions: tuple[int, ...]
    runs: tuple[tuple[int, int], ...]
    depths_m: Float32[np.ndarray, "n height width"]
    edges: tuple[FrameEdges, ...]
    sharpness: tuple[float, ...]


def examine(recording: Recording, *, progress: Callable[[int, int], None] | None = None) -> Diagnosis:
    """Find what is wrong with a scene. About 90 of its frames are read, however long it is.

    Args:
        recording: the recording, as its reader returns it.
        progress: called with the number of frames read and the total.
    """
    scene, trajectory = recording.scene, recording.trajectory
    sample, unreadable = _read_sample(scene, progress)
    findings = [Finding("left out", line, 1.0, LEFT_OUT) for line in recording.skipped]
    if unreadable:
        what = f"{len(unreadable)} of the images examined cannot be read; the first: {unreadable[0]}"
        findings.append(Finding("unreadable", what, 1.0, "record again, or remove them from the list"))
    findings += timing.odd_times(scene) + timing.dropped_frames(scene, recording.left_out)
    findings += orientation_tags(scene)
    facts = [_summary(scene, sample), *recording.notes]
    if not len(sample.depths_m):
        return Diagnosis(scene.name, tuple(facts), tuple(findings))
    findings += image_faults.repeated(_repeats(scene, sample), len(sample.positions))
    findings += image_faults.blur(sample.sharpness)
    findings += image_faults.missing_depth(
        [image_faults.missing_share(depth_m) for depth_m in sample.depths_m]
    )
    aligned = align(dict(zip(sample.positions, sample.edges, strict=True)))
    unjudged = [] if _shows_alignment(aligned) else ["lag and registration (too few common edges)"]
    facts.append(_alignment_fact(aligned))
    lag, misplaced = lag_of(aligned), misregistered(scene, aligned)
    why = _why_unjudged(scene, trajectory, sample)
    found: list[Finding] = []
    if trajectory is None or why:
        unjudged.append(f"depth unit, intrinsics and poses ({why})")
        facts.append(
            f"{why}: depth unit, intrinsics and poses could not be judged; let `rpl build` track first"
        )
        found = by_the_numbers(scene, sample.depths_m)
    else:
        judged = _geometry(scene, trajectory, sample, lag.whole)
        facts.append(judged.said)
        lag, found = decide_what_lags(aligned, lag, judged.found)
        if not lag.whole:
            said, found = _with_drift(
                scene, trajectory, sample, judged, found, progress, by_images=not misplaced
            )
            facts += said
        found = timing.pose_jumps(scene, trajectory) + found
    findings += lag_findings(lag) + misplaced + _after_mending(misplaced, found)
    return Diagnosis(scene.name, tuple(facts), tuple(findings), tuple(unjudged))


# Reading ------------------------------------------------------------------------------------------


def stretches(frames: int, *, count: int = 2, length: int = 45) -> list[range]:
    """Choose stretches of frames at the start and the end of the recording; all of a short one."""
    if frames <= count * length:
        return [range(frames)]
    starts = np.linspace(0, frames - length, count).astype(int)
    return [range(start, start + length) for start in starts.tolist()]


def _read_sample(scene: Scene, progress: Callable[[int, int], None] | None) -> tuple[_Sample, list[str]]:
    """Read the stretches; images that cannot be read are left out, and their errors returned."""
    chosen = stretches(len(scene.frames))
    total, done = sum(map(len, chosen)), 0
    positions: list[int] = []
    runs: list[tuple[int, int]] = []
    depths: list[DepthImage] = []
    edges: list[FrameEdges] = []
    sharpness: list[float] = []
    unreadable: list[str] = []
    for stretch in chosen:
        first = len(positions)
        for at in stretch:
            done += 1
            if progress is not None:
                progress(done, total)
            try:
                color, depth_m = read_color(scene.frames[at]), read_depth_m(scene, scene.frames[at])
            except DataError as error:
                unreadable.append(str(error))
                continue
            positions.append(at)
            depths.append(depth_m)
            edges.append(edges_of(color, depth_m))
            sharpness.append(image_faults.sharpness(color))
        runs.append((first, len(positions)))
    size = (0, scene.intrinsics.height, scene.intrinsics.width)
    stack = np.stack(depths) if depths else np.zeros(size, np.float32)
    return _Sample(tuple(positions), tuple(runs), stack, tuple(edges), tuple(sharpness)), unreadable


def _repeats(scene: Scene, sample: _Sample) -> list[int]:
    numbers = [scene.frames[at].index for at in sample.positions]
    found = [image_faults.repeats(list(sample.depths_m[a:b]), numbers[a:b]) for a, b in sample.runs]
    return [number for numbers_of_run in found for number in numbers_of_run]


# Judging ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Judged:
    """What the depth images say of the geometry as recorded.

    Attributes:
        said: how well they agree under it, as a fact.
        found: its constant faults.
        given, corrected: the geometry, and as those faults correct it.
    """

    said: str
    found: list[Finding]
    given: Geometry
    corrected: Geometry


def _geometry(scene: Scene, trajectory: Trajectory, sample: _Sample, lag: int) -> _Judged:
    """Judge poses, depth unit and intrinsics, given that depth is `lag` frames late."""
    poses = _poses_of(scene, trajectory, sample)  # the depth image of frame t is at t + lag, its pose at t
    poses = shifted(poses, sample.runs, -lag)
    compared = choose_pairs(sample.depths_m, sample.runs)
    given = Geometry(scene.intrinsics, poses)
    fit = _agreement(compared, given)
    found, corrected = faults(compared, given)
    said = f"depth images agree to {fit:.1%} of the depth under the given poses"
    if not np.isfinite(fit):
        said = "no two depth images show the same place under the given poses"
    return _Judged(said, with_turned_bits(scene, sample.depths_m, found), given, corrected)


def _with_drift(
    scene: Scene,
    trajectory: Trajectory,
    sample: _Sample,
    judged: _Judged,
    found: list[Finding],
    progress: Callable[[int, int], None] | None,
    *,
    by_images: bool,
) -> tuple[list[str], list[Finding]]:
    """Measure drift unless constant faults explain it; a path that surely drifts explains their findings.

    Args:
        by_images: whether colour and depth lie on one another, so that a path can be computed from both.
    """
    frames = [scene.frames[at] for at in sample.positions]
    stretches_read = tuple(tuple(frames[first:behind]) for first, behind in sample.runs)
    if any(finding.sure >= SURE for finding in found) and (
        not by_images
        or explains(
            judged.corrected, judged.given, scene=scene, stretches=stretches_read, depths_m=sample.depths_m
        )
    ):
        return [], found

    def depth_m(frame: Frame) -> DepthImage:
        try:
            return read_depth_m(scene, frame)
        except DataError:  # already a finding
            return np.zeros((scene.intrinsics.height, scene.intrinsics.width), np.float32)

    said, strays = drift_findings(
        scene, trajectory, depth_m, progress or (lambda done, total: None), by_images=by_images
    )
    return [said], strays or found


def _after_mending(misplaced: list[Finding], found: list[Finding]) -> list[Finding]:
    """Intrinsics are judged on depth as it is stored; of another field of view, it has others than colour."""
    if not any(finding.mend is not None and finding.mend.depth_zoom != 1 for finding in misplaced):
        return found
    todo = "mend the registration first and check again: until then these are the depth camera's"
    return [
        replace(finding, sure=min(finding.sure, 0.5), todo=todo) if finding.kind == "intrinsics" else finding
        for finding in found
    ]


def _why_unjudged(scene: Scene, trajectory: Trajectory | None, sample: _Sample) -> str:
    """Why poses cannot judge the geometry; empty where they can."""
    if trajectory is None:
        return "no poses"
    poses = _poses_of(scene, trajectory, sample)
    return "the camera hardly moves" if _still(poses, sample.runs) else ""


def _agreement(compared: ComparedImages, geometry: Geometry) -> float:
    found = differences(compared, geometry)
    return float(np.nanmean(found)) if np.isfinite(found).any() else float("nan")


def _poses_of(scene: Scene, trajectory: Trajectory, sample: _Sample) -> Float64[np.ndarray, "n 4 4"]:
    """Pose of each frame that was read; NaN where it has none."""
    row_of = {int(index): row for row, index in enumerate(trajectory.frames)}
    poses = np.full((len(sample.positions), 4, 4), np.nan)
    for row, at in enumerate(sample.positions):
        index = scene.frames[at].index
        if index in row_of:
            poses[row] = trajectory.scene_from_camera[row_of[index]]
    return poses


def _still(poses: Float64[np.ndarray, "n 4 4"], runs: tuple[tuple[int, int], ...]) -> bool:
    """Whether the camera neither moves nor turns in any stretch."""
    for first, behind in runs:
        whole = poses[first:behind][np.isfinite(poses[first:behind]).all(axis=(1, 2))]
        if len(whole) < 2:
            continue
        moved_m = np.ptp(whole[:, :3, 3], axis=0).max()
        turned_rad = np.linalg.norm(whole[:, :3, :3] - whole[0, :3, :3], axis=(1, 2)).max() / np.sqrt(2)
        if moved_m > STILL_M or turned_rad > STILL_RAD:
            return False
    return True


# Facts --------------------------------------------------------------------------------------------


def _summary(scene: Scene, sample: _Sample) -> str:
    camera, interval_s = scene.intrinsics, timing.interval_s(scene)
    rate = f" at {1 / interval_s:.3g} Hz" if interval_s > 0 else ""
    size = f"{camera.width} x {camera.height}, f = {camera.fx:.0f} px"
    text = f"{counted(len(scene.frames), 'frame')}{rate}, {size}"
    some = sample.depths_m[:, ::4, ::4]
    measured = some[some > 0]
    if not len(measured):
        return f"{text}, no depth"
    near, middle, far = np.percentile(measured[:: max(1, len(measured) // 100_000)], (2, 50, 98))
    return f"{text}, depth {near:.2f} - {middle:.2f} - {far:.2f} m (2nd, 50th, 98th percentile)"


def _shows_alignment(aligned: Alignment) -> bool:
    return aligned.lag_sigma <= UNSURE_FRAMES and aligned.shift_sigma_px <= UNSURE_PX


def _alignment_fact(aligned: Alignment) -> str:
    if not _shows_alignment(aligned):
        return "too few edges common to colour and depth: lag and registration could not be judged"
    du, dv = aligned.shift_px
    zoom = "" if aligned.zoom == 1 else f"zoom {aligned.zoom:.3f} +- {aligned.zoom_sigma:.3f}, "
    return (
        f"colour and depth edges match at lag {aligned.lag_frames:+.1f} +- {aligned.lag_sigma:.1f} frames, "
        f"{zoom}shift ({du:+.0f}, {dv:+.0f}) +- {aligned.shift_sigma_px:.0f} px"
    )

"""Faults of a recording that are mended while it is read; `rpl check` names those that apply."""

from __future__ import annotations

import filecmp
import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.geometry import OPENGL_AXES, invert
from rpl_data.types import DataError, DepthCoding, DepthWarp, Recording, Scene, Trajectory
from rpl_data.wording import counted


@dataclass(frozen=True)
class Mend:
    """The faults to mend; by default none.

    Attributes:
        wxyz_quaternions: the poses' quaternions are stored as w x y z.
        inverted_poses: the poses are camera_from_scene.
        opengl_cameras: the poses are those of cameras that look along -z with y up.
        pose_factor: positions of the camera are multiplied by this, for poses of a tool that knows no metres.
        pose_lag: the pose of frame n is stored at frame n + pose_lag.
        depth_lag: the depth image of frame n is stored at frame n + depth_lag.
        depth_zoom: depth images are enlarged by this about their centre,
        depth_shift_px: and then moved this far right and down, to coincide with the colour images. Right at
            one distance only, so it is for a recording that cannot be made again with registered depth.
        no_repeats: leave out frames whose depth image repeats the one before.
        depth_factor: depths are multiplied by this.
        depth_bits_turned: the 16 bits of stored depth are turned left by 3, as SUN3D's are.
        depth_along_ray: stored depth is the distance along each pixel's ray, not along the optical axis.
    """

    wxyz_quaternions: bool = False
    inverted_poses: bool = False
    opengl_cameras: bool = False
    pose_factor: float = 1.0
    pose_lag: int = 0
    depth_lag: int = 0
    depth_zoom: float = 1.0
    depth_shift_px: tuple[float, float] = (0.0, 0.0)
    no_repeats: bool = False
    depth_factor: float = 1.0
    depth_bits_turned: bool = False
    depth_along_ray: bool = False

    def __post_init__(self) -> None:
        """Refuse a factor that leaves nothing."""
        for name in ("depth_zoom", "depth_factor", "pose_factor"):
            if not 0 < getattr(self, name) < math.inf:
                raise DataError(
                    f"mend.{name} is {getattr(self, name)}; expected a positive factor, 1 = unchanged"
                )


def mended(recording: Recording, mend: Mend) -> Recording:
    """Return the recording with its poses converted, and its images and poses paired anew.

    Frames whose partner lies beyond an end of the recording are left out; notes say what was done.

    Raises:
        DataError: a lag leaves no frame.
    """
    if mend == Mend():
        return recording
    scene = _with_true_depth(_on_color(recording.scene, mend), mend)
    scene, left_out = _with_depth_of(scene, mend.depth_lag)
    repeats = 0
    if mend.no_repeats:
        scene, repeats = _without_repeats(scene)
    trajectory = recording.trajectory
    if trajectory is not None:
        poses = mended_poses(trajectory.scene_from_camera, mend)
        scene, trajectory, unposed = _with_pose_of(scene, Trajectory(trajectory.frames, poses), mend.pose_lag)
        left_out += unposed
    if not scene.frames:
        raise DataError(f"scene {scene.name}: with {mend} no frames are left; lags are given in frames")
    lines = [f"read with `{in_recipe(mend)}`"]
    lines += [f"{counted(left_out, 'frame')} left out: no partner after mending a lag"] if left_out else []
    repeated = f"{counted(repeats, 'frame')} left out: the depth image repeats the one before"
    lines += [repeated] if repeats else []
    kept = {frame.index for frame in scene.frames}
    gone = tuple(frame.index for frame in recording.scene.frames if frame.index not in kept)
    return replace(
        recording,
        scene=scene,
        trajectory=trajectory,
        notes=(*recording.notes, *lines),
        left_out=(*recording.left_out, *gone),
    )


def in_recipe(mend: Mend) -> str:
    """Write the recipe's field, with what differs from the default."""
    return f"mend: {{{', '.join(f'{key}: {json.dumps(value)}' for key, value in changed(mend).items())}}}"


def changed(mend: Mend) -> dict[str, Any]:
    """The fields that differ from the default."""
    return {key: value for key, value in asdict(mend).items() if value != getattr(Mend(), key)}


def mended_poses(poses: Float64[np.ndarray, "n 4 4"], mend: Mend) -> Float64[np.ndarray, "n 4 4"]:
    """Convert poses that were read without mending to `scene_from_camera`; NaN stays NaN."""
    result = poses.copy()
    whole = np.isfinite(poses).all(axis=(1, 2))
    if mend.wxyz_quaternions and whole.any():
        read = Rotation.from_matrix(poses[whole, :3, :3]).as_quat()
        result[whole, :3, :3] = Rotation.from_quat(np.roll(read, -1, axis=1)).as_matrix()
    if mend.inverted_poses:
        result = invert(result)
    if mend.opengl_cameras:
        result = result @ OPENGL_AXES
    result[:, :3, 3] *= mend.pose_factor
    return result


def _on_color(scene: Scene, mend: Mend) -> Scene:
    """Warp the scene's depth onto its colour images, which makes it registered."""
    warp = DepthWarp(mend.depth_zoom, mend.depth_shift_px)
    return scene if warp == DepthWarp() else replace(scene, depth_warp=warp, registered=True)


def _with_true_depth(scene: Scene, mend: Mend) -> Scene:
    """Read the scene's depth images in another unit, or from another coding."""
    coding = DepthCoding(mend.depth_bits_turned, mend.depth_along_ray)
    unit_m = scene.metres_per_unit * mend.depth_factor
    return replace(scene, metres_per_unit=unit_m, depth_coding=coding)


def _with_depth_of(scene: Scene, lag: int) -> tuple[Scene, int]:
    """Take every frame's depth image from `lag` frames later; also the number of frames lost."""
    depth_of = {frame.index: frame.depth for frame in scene.frames}
    kept = [
        replace(frame, depth=depth_of[frame.index + lag])
        for frame in scene.frames
        if frame.index + lag in depth_of
    ]
    return replace(scene, frames=tuple(kept)), len(scene.frames) - len(kept)


def _without_repeats(scene: Scene) -> tuple[Scene, int]:
    """Drop frames whose depth file equals that of the frame before; also their number."""
    kept = [
        frame
        for frame, before in zip(scene.frames, (None, *scene.frames), strict=False)
        if before is None or not _same_file(frame.depth, before.depth)
    ]
    return replace(scene, frames=tuple(kept)), len(scene.frames) - len(kept)


def _same_file(one: Path | None, other: Path | None) -> bool:
    """Whether both exist and hold the same bytes; quick, since their sizes nearly always differ."""
    if one is None or other is None or not (one.exists() and other.exists()):
        return False
    return filecmp.cmp(one, other, shallow=False)


def _with_pose_of(scene: Scene, trajectory: Trajectory, lag: int) -> tuple[Scene, Trajectory, int]:
    """Give every frame the pose of `lag` frames later; frames without one are dropped."""
    row_of = {int(index): row for row, index in enumerate(trajectory.frames)}
    kept = tuple(frame for frame in scene.frames if frame.index + lag in row_of)
    rows = [row_of[frame.index + lag] for frame in kept]
    paired = Trajectory(
        np.array([frame.index for frame in kept], dtype=np.int64), trajectory.scene_from_camera[rows]
    )
    return replace(scene, frames=kept), paired, len(scene.frames) - len(kept)

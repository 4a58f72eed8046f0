"""Camera poses of a scene as TUM lines `t tx ty tz qx qy qz qw`, scene_from_camera, and back."""

from __future__ import annotations

import numpy as np

from rpl_data.geometry import from_quaternion_xyzw, to_quaternion_xyzw
from rpl_data.types import Scene, Trajectory

HEADING = "# t_s tx_m ty_m tz_m qx qy qz qw  scene_from_camera"


def trajectory_to_text(scene: Scene, trajectory: Trajectory) -> str:
    """One line per pose, in full precision; the time is that of the frame."""
    times = {frame.index: frame.timestamp_s for frame in scene.frames}
    lines = [HEADING]
    for index, pose in zip(trajectory.frames, trajectory.scene_from_camera, strict=True):
        values = [times[int(index)], *pose[:3, 3], *to_quaternion_xyzw(pose)]
        lines.append(" ".join(repr(float(value)) for value in values))
    return "\n".join(lines) + "\n"


def trajectory_from_text(scene: Scene, text: str) -> Trajectory:
    """The poses of `trajectory_to_text`; lines whose time is that of no frame of the scene are left out.

    Raises:
        ValueError: a line has other than eight finite numbers.
    """
    rows = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = np.array(rows, dtype=float).reshape(-1, 8)
    if not np.isfinite(values).all():
        raise ValueError("a number is not finite")
    index_of = {frame.timestamp_s: frame.index for frame in scene.frames}
    known = [row for row in values if float(row[0]) in index_of]
    frames = np.array([index_of[float(row[0])] for row in known], dtype=np.int64)
    poses = np.array([from_quaternion_xyzw(row[4:], row[1:4]) for row in known]).reshape(-1, 4, 4)
    return Trajectory(frames, poses)

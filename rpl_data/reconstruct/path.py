"""Collect tracked frames to a trajectory, and tell the user which frames were lost."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rpl_data.reconstruct.tracking import Tracked
from rpl_data.types import DataError, Scene, Trajectory


@dataclass(frozen=True)
class Track:
    """The tracked path of the camera in a recording.

    Attributes:
        trajectory: poses of the tracked frames.
        lost: `Frame.index` of the other frames.
    """

    trajectory: Trajectory
    lost: tuple[int, ...]


def collected(scene: Scene, tracked: Iterable[Tracked]) -> Track:
    """Collect the tracked frames of a recording.

    Raises:
        DataError: fewer than two frames could be tracked.
    """
    found = [(item.frame.index, item.scene_from_camera) for item in tracked]
    good = [(index, pose) for index, pose in found if pose is not None]
    if len(good) < 2:
        raise DataError(
            f"scene {scene.name}: the camera could not be tracked in any of its {len(found)} frames; "
            "expected depth and something to hold on to (edges, print, several objects) in every view, and a "
            "camera that moves less than a tenth of the image from frame to frame; record it again, or give "
            "it poses"
        )
    trajectory = Trajectory(
        np.array([index for index, _ in good], dtype=np.int64), np.array([pose for _, pose in good])
    )
    return Track(trajectory, tuple(index for index, pose in found if pose is None))


def losses(scene: Scene, track: Track) -> list[str]:
    """Lines for the user about lost frames: those in between, and those after the track was lost for good."""
    last = int(track.trajectory.frames[-1])
    rest = [index for index in track.lost if index > last]
    between = [index for index in track.lost if index < last]
    total = len(scene.frames)
    lines = []
    if between:
        listed = ", ".join(map(str, between[:12])) + (", ..." if len(between) > 12 else "")
        lines.append(f"{len(between)} of {total} frames could not be tracked and are left out: {listed}")
    if rest:
        lines.append(
            f"the track was lost for good after frame {last}: the last {len(rest)} of {total} frames are "
            "left out; move the camera more slowly there, or record that part as a scene of its own"
        )
    return lines

"""Collect tracked frames to a trajectory, and tell the user which frames were lost and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from rpl_data.reconstruct.tracking import Loss, Tracked
from rpl_data.types import DataError, Frame, Scene, Trajectory
from rpl_data.wording import counted

REMEDIES = {
    Loss.NO_DEPTH: "keep the lens free and the camera at the distance its maker gives",
    Loss.DARK: "keep the lens free and the light on, and have something with edges or print in every view",
    Loss.PLAIN: "have something to hold on to in every view: edges, print, several objects",
    Loss.UNLIKE: "put the frames in the order they were taken in, with none left out, or record that part as "
    "a scene of its own",
}
"""What to do about a loss."""

MOST_NAMED = 12


@dataclass(frozen=True)
class Track:
    """The tracked path of the camera in a recording.

    Attributes:
        trajectory: poses of the tracked frames.
        losses: why each of the other frames was lost, by `Frame.index`.
    """

    trajectory: Trajectory
    losses: Mapping[int, Loss]

    @property
    def lost(self) -> tuple[int, ...]:
        """`Frame.index` of the frames without a pose."""
        return tuple(self.losses)


def collected(scene: Scene, tracked: Iterable[Tracked]) -> Track:
    """Collect the tracked frames of a recording; of a frame that comes twice, the last word counts.

    Raises:
        DataError: fewer than two frames could be tracked.
    """
    found = {item.frame.index: item for item in tracked}
    poses = {index: item.scene_from_camera for index, item in found.items()}
    good = [(index, pose) for index, pose in poses.items() if pose is not None]
    losses = {index: item.loss for index, item in found.items() if item.loss is not None}
    if len(good) < 2:
        raise DataError(
            f"scene {scene.name}: the camera could not be tracked: of {counted(len(found), 'frame')}, "
            f"{_told(scene, losses) or 'none could be compared with another'}; or give it poses"
        )
    trajectory = Trajectory(
        np.array([index for index, _ in good], dtype=np.int64), np.array([pose for _, pose in good])
    )
    return Track(trajectory, losses)


def losses(scene: Scene, track: Track) -> list[str]:
    """Lines for the user about lost frames: those in between, and those after the track was lost for good."""
    last = int(track.trajectory.frames[-1])
    rest = {index: loss for index, loss in track.losses.items() if index > last}
    between = {index: loss for index, loss in track.losses.items() if index < last}
    total = len(scene.frames)
    lines = []
    if between:
        lines.append(
            f"{len(between)} of {total} frames could not be tracked and are left out: {_told(scene, between)}"
        )
    if rest:
        lines.append(
            f"the track was lost for good after frame {last}: the last {len(rest)} of {total} frames are "
            f"left out: {_told(scene, rest)}"
        )
    return lines


def _told(scene: Scene, losses: Mapping[int, Loss]) -> str:
    """Which frames were lost for which reason, and what to do about each reason."""
    frames = {frame.index: frame for frame in scene.frames}
    parts = []
    for loss in Loss:
        named = [frames[index] for index, why in losses.items() if why is loss]
        if named:
            listed = ", ".join(map(_name, named[:MOST_NAMED])) + (", ..." if len(named) > MOST_NAMED else "")
            who = f"frame {listed}" if len(named) == 1 else f"each of {listed}"
            parts.append(f"{who} {loss.value} ({REMEDIES[loss]})")
    return "; ".join(parts)


def _name(frame: Frame) -> str:
    return f"{frame.index} ({frame.color.name})"

"""True poses of objects that come with a dataset; used for evaluation only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rpl_data.geometry import Transform, invert
from rpl_data.types import Recording, Trajectory

STILL_M = 0.02
"""If an object's annotated poses move by more than this in a static scene, a note says so."""

LESS_MOVEMENT_RATIO = 3.0
"""If inverting the camera's poses makes objects this many times stiller, they are called inverted."""


def with_true_poses(recording: Recording, poses: Mapping[str, Mapping[int, Transform]]) -> Recording:
    """Add `camera_from_object` by object name and `Frame.index`, for the frames that were kept.

    Objects stand still in a scene. Where the camera's poses contradict that, a note says so, with the remedy.
    """
    kept = {frame.index for frame in recording.scene.frames}
    known = {
        name: {index: pose for index, pose in of_frame.items() if index in kept}
        for name, of_frame in sorted(poses.items())
    }
    known = {name: of_frame for name, of_frame in known.items() if of_frame}
    notes = [] if recording.trajectory is None else _movement(recording.trajectory, known)
    return replace(recording, notes=(*recording.notes, *notes), true_poses=known)


def _movement(trajectory: Trajectory, poses: Mapping[str, Mapping[int, Transform]]) -> list[str]:
    inverted = replace(trajectory, scene_from_camera=invert(trajectory.scene_from_camera))
    notes = []
    for name, of_frame in poses.items():
        moved_m, inverted_m = (_moved_m(one, of_frame) for one in (trajectory, inverted))
        if moved_m > STILL_M:
            hint = "; the camera's poses look inverted: set `mend: {inverted_poses: true}`"
            notes.append(
                f"by the camera's poses, {name} moves by {1000 * moved_m:.0f} mm (median) in the scene"
                + (hint if moved_m > LESS_MOVEMENT_RATIO * inverted_m else "")
            )
    return notes


def _moved_m(trajectory: Trajectory, camera_from_object: Mapping[int, Transform]) -> float:
    """Median distance of an object's positions in the scene from their median."""
    at = np.array(
        [(trajectory.at(index) @ pose)[:3, 3] for index, pose in camera_from_object.items()], dtype=np.float64
    )
    return float(np.median(np.linalg.norm(at - np.median(at, axis=0), axis=1)))

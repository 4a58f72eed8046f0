"""How fast objects pass through the image of a moving camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import invert, transform
from rpl_data.label.alone import SceneObject
from rpl_data.raycast import PixelTable
from rpl_data.types import Scene, Trajectory

LONGEST_GAP_S = 0.5
"""Poses farther apart in time say nothing of the speed between them."""


@dataclass(frozen=True)
class Motion:
    """A camera path with its times, one per row of the trajectory."""

    trajectory: Trajectory
    times_s: Float64[np.ndarray, " n"]

    def _of_path(self, path: Trajectory) -> Motion:
        """The same times along another path, which may lack frames of this one."""
        times_s = dict(zip(self.trajectory.frames.tolist(), self.times_s, strict=True))
        return Motion(path, np.array([times_s.get(k, np.nan) for k in path.frames.tolist()]))

    @staticmethod
    def of(scene: Scene, trajectory: Trajectory) -> Motion:
        """The path of a scene."""
        times_s = {frame.index: frame.timestamp_s for frame in scene.frames}
        return Motion(trajectory, np.array([times_s.get(k, np.nan) for k in trajectory.frames.tolist()]))

    def speed_px_s(self, camera: PixelTable, frame: int, item: SceneObject) -> float:
        """Speed of the middle of an object in the image, from the poses before and after; 0 if unknown."""
        if item.path is not None:
            return self._of_path(item.path).speed_px_s(
                camera, frame, replace(item, path=None, scene_from_object=np.eye(4))
            )
        row = int(np.searchsorted(self.trajectory.frames, frame))
        middle = item.model.points_object[item.model.known].mean(axis=0, keepdims=True)
        rows = [k for k in (row - 1, row, row + 1) if 0 <= k < len(self.times_s)]
        camera_from_object = invert(self.trajectory.scene_from_camera[rows]) @ item.scene_from_object
        uv_px = camera.project(np.concatenate([transform(pose, middle) for pose in camera_from_object]))
        gaps_s = np.diff(self.times_s[rows])
        near = (gaps_s > 0) & (gaps_s <= LONGEST_GAP_S)
        steps_px = np.linalg.norm(np.diff(uv_px, axis=0), axis=1)
        speeds = steps_px[near] / gaps_s[near]
        speeds = speeds[np.isfinite(speeds)]
        return float(speeds.mean()) if len(speeds) else 0.0

"""How fast objects pass through the image of a moving camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import invert
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
        rows = [k for k in (row - 1, row, row + 1) if 0 <= k < len(self.times_s)]
        between = self._between_px_s(camera, rows, item)
        speeds = between[np.isfinite(between)]
        return float(speeds.mean()) if len(speeds) else 0.0

    def speeds_px_s(self, camera: PixelTable, item: SceneObject) -> dict[int, float]:
        """The speed in every frame of the path, as `speed_px_s` has it for one."""
        if item.path is not None:
            standing = replace(item, path=None, scene_from_object=np.eye(4))
            return self._of_path(item.path).speeds_px_s(camera, standing)
        between = np.full(len(self.times_s) + 1, np.nan)
        between[1:-1] = self._between_px_s(camera, list(range(len(self.times_s))), item)
        known = np.isfinite(between)
        between[~known] = 0
        count = np.maximum(known[1:].astype(int) + known[:-1], 1)
        speeds = (between[1:] + between[:-1]) / count
        return dict(zip(self.trajectory.frames.tolist(), speeds.tolist(), strict=True))

    def _between_px_s(
        self, camera: PixelTable, rows: list[int], item: SceneObject
    ) -> Float64[np.ndarray, " m"]:
        """Speed of the middle of an object from each of these poses to the next; NaN where it is unknown."""
        middle = item.model.points_object[item.model.known].mean(axis=0)
        camera_from_object = invert(self.trajectory.scene_from_camera[rows]) @ item.scene_from_object
        uv_px = camera.project(camera_from_object[:, :3, :3] @ middle + camera_from_object[:, :3, 3])
        gaps_s = np.diff(self.times_s[rows])
        gaps_s[~((gaps_s > 0) & (gaps_s <= LONGEST_GAP_S))] = np.nan
        speeds: Float64[np.ndarray, " m"] = np.linalg.norm(np.diff(uv_px, axis=0), axis=1) / gaps_s
        return speeds

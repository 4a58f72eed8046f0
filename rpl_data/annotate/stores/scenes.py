"""Scenes for the page: a few are kept in memory, with the depth of the most recent frames."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32

from rpl_data.geometry import to_quaternion_xyzw
from rpl_data.types import Click, DataError, DepthImage, Frame, Scene, Trajectory
from rpl_data.types.instances import instance_of, scene_of
from rpl_data.untrusted.names import checked_name
from rpl_data.workspace.workspace import Workspace

SCENES_KEPT = 6
"""Number of scenes kept in memory; one of 9,000 frames takes some 20 MB."""
DEPTHS_KEPT = 8


@dataclass(frozen=True)
class PosedScene:
    """A scene, its trajectory, and the frames that have a pose, by index."""

    scene: Scene
    trajectory: Trajectory
    frames: dict[int, Frame]

    def frame(self, index: int) -> Frame:
        """The frame with this index; DataError when it does not exist or has no pose."""
        if index not in self.frames:
            raise DataError(f"scene {self.scene.name} has no frame {index} with a camera pose")
        return self.frames[index]


class SceneStore:
    """Reads scenes and depth of a workspace, and caches the most recently used."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._scene = lru_cache(SCENES_KEPT)(self._read_scene)
        self._reading = threading.Lock()
        self._depth = lru_cache(DEPTHS_KEPT)(self._read_depth)

    def names(self) -> list[str]:
        """Names of the scenes in the workspace."""
        return self.workspace.scene_names()

    def forget(self) -> None:
        """Clear the cache, since a build may have cut scenes."""
        self._scene.cache_clear()
        self._depth.cache_clear()

    def depth_m(self, scene: str, frame: int) -> DepthImage:
        """Depth of a frame in metres; callers must not change it."""
        return self._depth(scene, frame)

    def get(self, name: str) -> PosedScene:
        """Return a scene of the workspace; DataError when it does not exist.

        Args:
            name: of the scene, or of an instance's place in it.
        """
        if instance := instance_of(name):
            checked_name(instance, "instance")
        name = scene_of(name)
        with self._reading:  # a page requests several things at once; only the first request reads the scene
            return self._scene(name)

    def _read_scene(self, name: str) -> PosedScene:
        if name not in self.workspace.scene_names():
            raise DataError(f"there is no scene {name!r}")
        scene = self.workspace.load_scene(name)
        trajectory = self.workspace.load_trajectory(scene)
        posed = set(trajectory.frames.tolist())
        return PosedScene(scene, trajectory, {f.index: f for f in scene.frames if f.index in posed})

    def _read_depth(self, scene: str, frame: int) -> DepthImage:
        posed = self.get(scene)
        return self.workspace.depth_reader(posed.scene)(posed.frame(frame))

    def refuse_outside(self, click: Click) -> None:
        """Raise a DataError when a click's frame does not exist or the click is outside its image."""
        posed = self.get(click.scene)
        posed.frame(click.frame)
        size = posed.scene.intrinsics
        if not (-0.5 <= click.u_px < size.width - 0.5 and -0.5 <= click.v_px < size.height - 0.5):
            raise DataError(
                f"({click.u_px:.2f}, {click.v_px:.2f}) px is outside the image of "
                f"{size.width} x {size.height} px; click on the image"
            )


def poses_table(posed: PosedScene) -> Float32[np.ndarray, "n 8"]:
    """One row per posed frame: index, translation (m) and quaternion x y z w of `scene_from_camera`."""
    index, poses = posed.trajectory.frames, posed.trajectory.scene_from_camera
    if not len(index):
        return np.zeros((0, 8), dtype=np.float32)
    table = np.column_stack([index, poses[:, :3, 3], to_quaternion_xyzw(poses)]).astype(np.float32)
    return table[np.isin(index, list(posed.frames))]

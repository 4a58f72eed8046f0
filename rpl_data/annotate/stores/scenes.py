"""Scenes as the page needs them: a few parsed at a time, depth of the last frames kept."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32

from rpl_data.geometry import to_quaternion_xyzw
from rpl_data.types import Click, DataError, DepthImage, Frame, Scene, Trajectory
from rpl_data.workspace.workspace import Workspace

SCENES_KEPT = 6
"""A scene of 9,000 frames takes some 20 MB."""
DEPTHS_KEPT = 8


@dataclass(frozen=True)
class PosedScene:
    """A scene, its trajectory, and the frames that have a pose, by index."""

    scene: Scene
    trajectory: Trajectory
    frames: dict[int, Frame]

    def frame(self, index: int) -> Frame:
        """The frame with that index; DataError when it is not there or has no pose."""
        if index not in self.frames:
            raise DataError(f"scene {self.scene.name} has no frame {index} with a camera pose")
        return self.frames[index]


class SceneStore:
    """Reads scenes and depth of a workspace and keeps what was used last."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._scene = lru_cache(SCENES_KEPT)(self._read_scene)
        self._reading = threading.Lock()
        self._depth = lru_cache(DEPTHS_KEPT)(self._read_depth)

    def names(self) -> list[str]:
        """Scenes of the workspace."""
        return self.workspace.scene_names()

    def forget(self) -> None:
        """Read everything again when it is next asked for: a build may have cut scenes."""
        self._scene.cache_clear()
        self._depth.cache_clear()

    def depth_m(self, scene: str, frame: int) -> DepthImage:
        """Depth of a frame, metres; not to be changed."""
        return self._depth(scene, frame)

    def get(self, name: str) -> PosedScene:
        """A scene of the workspace; DataError when there is no such one."""
        with self._reading:  # a page asks for several things of a scene at once: it is read for the first
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
        """DataError when a click is in no frame of ours or outside its image."""
        posed = self.get(click.scene)
        posed.frame(click.frame)
        size = posed.scene.intrinsics
        if not (-0.5 <= click.u_px < size.width - 0.5 and -0.5 <= click.v_px < size.height - 0.5):
            raise DataError(
                f"({click.u_px:.2f}, {click.v_px:.2f}) px is outside the image of "
                f"{size.width} x {size.height} px; click on the image"
            )


def poses_table(posed: PosedScene) -> Float32[np.ndarray, "n 8"]:
    """A row a posed frame: index, translation (m) and quaternion x y z w of `scene_from_camera`."""
    index, poses = posed.trajectory.frames, posed.trajectory.scene_from_camera
    if not len(index):
        return np.zeros((0, 8), dtype=np.float32)
    table = np.column_stack([index, poses[:, :3, 3], to_quaternion_xyzw(poses)]).astype(np.float32)
    return table[np.isin(index, list(posed.frames))]

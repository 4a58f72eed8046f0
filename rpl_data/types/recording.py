"""Recordings: cameras, frames, scenes, trajectories."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.types.errors import DataError
from rpl_data.types.images import DepthImage, Window
from rpl_data.wording import counted

Item = TypeVar("Item")


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with OpenCV's lens distortion.

    Attributes:
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels; the centre of the top-left pixel is (0, 0).
        width, height: image size in pixels.
        distortion: OpenCV's coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]); empty = none.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()

    @property
    def matrix(self) -> Float64[np.ndarray, "3 3"]:
        """The 3x3 camera matrix K."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=float)


@dataclass(frozen=True)
class Frame:
    """One colour image and its depth image, as files.

    Attributes:
        index: number in the recording: that of its files if they have one, else the position from 0;
            frames that were left out keep their number.
        timestamp_s: time of the colour image.
        color: path of the colour image.
        depth: path of the depth image; None where the recording has none for this frame.
    """

    index: int
    timestamp_s: float
    color: Path
    depth: Path | None


@dataclass(frozen=True)
class DepthWarp:
    """Map from a depth image that was not registered to the pixels of the colour image.

    With the centre m of the image: colour pixel = m + zoom * (depth pixel - m) + shift. The shift counts
    pixels of the colour image, also where depth has a size of its own. The shift of two cameras side by side
    depends on the distance, so this is right at one distance only.
    """

    zoom: float = 1.0
    shift_px: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class DepthCoding:
    """How the numbers of depth images differ from depth along the optical axis in the scene's unit.

    Attributes:
        bits_turned: the 16 bits are turned left by 3, as SUN3D stores them (Xiao et al., ICCV 2013). Depth
            below 8192 units is then simply multiplied by 8, as Kinect's own driver stores it.
        along_ray: the distance is that from the camera's centre along the ray of the pixel, as many
            simulators write it.
    """

    bits_turned: bool = False
    along_ray: bool = False


@dataclass(frozen=True)
class DepthCamera:
    """The camera of depth images that have another size than the colour images, or were taken beside them.

    Attributes:
        intrinsics: of the depth images, with their size.
        color_from_depth: 4x4, row by row, metres: takes points of this camera to the colour camera; None
            where both images come through one lens.
    """

    intrinsics: Intrinsics
    color_from_depth: tuple[float, ...] | None = None

    @property
    def matrix(self) -> Float64[np.ndarray, "4 4"] | None:
        """`color_from_depth` as a matrix; None where both images come through one lens."""
        return None if self.color_from_depth is None else np.array(self.color_from_depth).reshape(4, 4)


@dataclass(frozen=True)
class Scene:
    """One RGB-D video (the paper's U_s); its images stay in their files.

    Attributes:
        name: unique in a workspace; a folder name.
        metres_per_unit: ``depth_m = raw * metres_per_unit``.
        registered: whether depth pixels coincide with colour pixels; labelling refuses other scenes.
        no_depth_units: raw depth values that mean "no depth", besides 0.
        depth_warp: maps depth images to the colour images while they are read; None = not needed.
        depth_coding: what is undone while depth images are read.
        depth_camera: looks depth up at the colour pixels while it is read; None where depth images already
            have the pixels of the colour images.
        source: what the scene was read from, for the report.
    """

    name: str
    intrinsics: Intrinsics
    metres_per_unit: float
    frames: tuple[Frame, ...]
    registered: bool = True
    no_depth_units: tuple[int, ...] = ()
    source: str = ""
    depth_warp: DepthWarp | None = None
    depth_coding: DepthCoding = DepthCoding()
    depth_camera: DepthCamera | None = None

    @property
    def depth_intrinsics(self) -> Intrinsics:
        """The camera of the stored depth images."""
        return self.intrinsics if self.depth_camera is None else self.depth_camera.intrinsics

    @property
    def depth_size(self) -> tuple[int, int]:
        """Height and width of the stored depth images, in pixels."""
        return self.depth_intrinsics.height, self.depth_intrinsics.width

    def frame(self, index: int) -> Frame:
        """The frame with this index in the recording; DataError when the scene has none."""
        for candidate in self.frames:
            if candidate.index == index:
                return candidate
        raise DataError(
            f"scene {self.name} has no frame {index}: it has {counted(len(self.frames), 'frame')}, "
            f"{self.frames[0].index} to {self.frames[-1].index}; frames without colour, depth or "
            "pose are left out when a recording is read"
        )


@dataclass(frozen=True)
class Trajectory:
    """Camera poses of a scene (the paper's C_s^(t)), in the order of the frames.

    Attributes:
        frames: `Frame.index` of each row.
        scene_from_camera: one rigid transform per row, metres.
    """

    frames: Int64[np.ndarray, " n"]
    scene_from_camera: Float64[np.ndarray, "n 4 4"]

    def at(self, frame: int) -> Float64[np.ndarray, "4 4"]:
        """`scene_from_camera` of the frame with this index; DataError when it has no pose."""
        row = int(np.searchsorted(self.frames, frame))
        if row == len(self.frames) or self.frames[row] != frame:
            raise DataError(f"the trajectory has no pose for frame {frame}; choose another frame")
        pose: Float64[np.ndarray, "4 4"] = self.scene_from_camera[row]
        return pose


def posed_frames(scene: Scene, trajectory: Trajectory, *, with_depth: bool = False) -> list[Frame]:
    """The frames of a scene that have a pose, in their order; of these, all or only those with depth."""
    posed = set(trajectory.frames.tolist())
    found = [frame for frame in scene.frames if frame.index in posed]
    return [frame for frame in found if frame.depth is not None] if with_depth else found


def spread_evenly(items: Sequence[Item], most: int) -> list[Item]:
    """At most so many of some frames, or of whatever comes one after the other, evenly spread over them."""
    rows = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).astype(int))
    return [items[row] for row in rows.tolist()]


@dataclass(frozen=True)
class Recording:
    """What a reader returns: a scene, the trajectory it came with, and what was left out.

    Attributes:
        trajectory: None when the recording has no poses (the camera must be tracked first).
        skipped: one line per reason for which frames were left out, with their number.
        notes: what was assumed, for example the depth unit of a format that does not state it.
        left_out: `Frame.index` of the frames that were dropped as they have no pose, or when faults were
            mended, so that the doctor does not count them as lost by the recorder.
        true_poses: camera_from_object by object name and `Frame.index`, where a dataset provides it: the
            truth for evaluation. No labelling stage receives it.
        moving: whether the objects are moved while the scene is filmed: each frame has its own pose.
    """

    scene: Scene
    trajectory: Trajectory | None
    skipped: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple[int, ...] = ()
    true_poses: Mapping[str, Mapping[int, Float64[np.ndarray, "4 4"]]] = field(default_factory=dict)
    moving: bool = False


Span = tuple[int, int]
"""First and last frame (`Frame.index`)."""

ReadDepth = Callable[[Frame], DepthImage]
"""Reads the depth image of a frame in metres, 0 = none, from a workspace's cache or from the recording."""

ReadDepthInto = Callable[[Frame, Window, DepthImage], None]
"""Reads a window of the depth image of a frame, in metres, into the same window of an image."""

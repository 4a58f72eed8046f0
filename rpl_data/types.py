"""The data types of rpl_data: what stages take and return.

Every stage takes and returns the frozen dataclasses below; most of them
are also files that `rpl_data/workspace/workspace.py` reads and writes. Conventions (frames, pixels, units)
are in `rpl_data/geometry.py`.

A missing value is absent, ``None``, or NaN in an array of numbers; never -1 or 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypedDict

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8, UInt16

from rpl_data.wording import counted

DepthImage = Float32[np.ndarray, "height width"]
"""Metres along the optical axis; 0 = no depth."""
ColorImage = UInt8[np.ndarray, "height width 3"]
"""RGB."""
GreyImage = UInt8[np.ndarray, "rows columns"]
"""Brightness."""


class DataError(ValueError):
    """An error that the user can mend.

    The message says what is wrong, where, what was expected, what was found and what to do.
    """


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

    With the centre m of the image: colour pixel = m + zoom * (depth pixel - m) + shift. The shift of two
    cameras side by side depends on the distance, so this is right at one distance only.
    """

    zoom: float = 1.0
    shift_px: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Scene:
    """One RGB-D video (the paper's U_s); its images stay in their files.

    Attributes:
        name: unique in a workspace; a folder name.
        metres_per_unit: ``depth_m = raw * metres_per_unit``.
        registered: whether depth pixels coincide with colour pixels; labelling refuses other scenes.
        no_depth_units: raw depth values that mean "no depth", besides 0.
        depth_warp: maps depth images to the colour images while they are read; None = not needed.
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


@dataclass(frozen=True)
class Recording:
    """What a reader returns: a scene, the trajectory it came with, and what was left out.

    Attributes:
        trajectory: None when the recording has no poses (the camera must be tracked first).
        skipped: one line per reason for which frames were left out, with their number.
        notes: what was assumed, for example the depth unit of a format that does not state it.
        left_out: `Frame.index` of the frames that were dropped when faults were mended, so that the doctor
            does not count them as lost by the recorder.
        true_poses: camera_from_object by object name and `Frame.index`, where a dataset provides it: the
            truth for evaluation. No labelling stage receives it.
    """

    scene: Scene
    trajectory: Trajectory | None
    skipped: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple[int, ...] = ()
    true_poses: Mapping[str, Mapping[int, Float64[np.ndarray, "4 4"]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Click:
    """A mark that a person set: keypoint number `keypoint` of `object`, at (u_px, v_px) of a frame."""

    object: str
    keypoint: int
    scene: str
    frame: int
    u_px: float
    v_px: float


@dataclass(frozen=True)
class Observation:
    """A click lifted to 3D: a ray, and the depths that the sensor measured around it.

    Attributes:
        ray_camera: direction of the ray with z = 1, lens distortion removed; a point on it at
            depth d is ``d * ray_camera`` in the camera frame.
        scene_from_camera: pose of the clicked frame.
        depths_m: candidate depths from the neighbourhood, nearest surface first; may be empty.
        depth_sigmas_m: standard deviation of each candidate as the depth of the clicked point.
        pixel_rad: angle of one pixel there, 1 / focal length.
        depth_slopes_m: how each candidate's surface is tilted: the derivative of its depth by x and y of
            the ray, in metres per unit; None = every surface faces the camera.
    """

    click: Click
    ray_camera: Float64[np.ndarray, "3"]
    scene_from_camera: Float64[np.ndarray, "4 4"]
    depths_m: Float64[np.ndarray, " candidates"]
    depth_sigmas_m: Float64[np.ndarray, " candidates"]
    pixel_rad: float
    depth_slopes_m: Float64[np.ndarray, "candidates 2"] | None = None


@dataclass(frozen=True)
class KeypointModel:
    """The sparse model Q of an object.

    Attributes:
        name: the object's name.
        keypoints: names, in order.
        points_object: one row per keypoint, metres, object frame; NaN where it was never clicked.
        skeleton: pairs of keypoint numbers to draw a line between.
    """

    name: str
    keypoints: tuple[str, ...]
    points_object: Float64[np.ndarray, "k 3"]
    skeleton: tuple[tuple[int, int], ...] = ()

    @property
    def known(self) -> np.ndarray:
        """Which keypoints have a position; bool, shape (k,)."""
        known: np.ndarray = np.isfinite(self.points_object).all(axis=1)
        return known


DepthState = Literal["agrees", "other surface", "rejected", "none"]
"""What was decided about a click's depth: the candidate at the click agrees; another candidate of the
neighbourhood was chosen; none of the candidates fits; there was no candidate."""


@dataclass(frozen=True)
class ClickResidual:
    """How well the solution explains one click.

    Attributes:
        error_px: distance of the click from the projected keypoint.
        error_m: distance of the keypoint from the lifted click; None when no depth was used.
        depth_m: the chosen depth; None where none of the candidates fits.
        outlier: whether the click itself, not only its depth, is wrong.
        reason: one line for the user, also for a click that may be the wrong one of several; empty when all
            is well.
    """

    click: Click
    error_px: float
    error_m: float | None
    depth_m: float | None
    depth_state: DepthState
    outlier: bool = False
    reason: str = ""


StatementKind = Literal[
    "swapped", "wrong name", "wrong place", "disagree", "whole scene", "everything", "unchecked",
    "weak scene",
]  # fmt: skip
"""What is wrong with clicks: two keypoints of a scene exchanged; a keypoint marked where another one is;
marked somewhere else; clicks of which one is wrong and nothing tells which; a scene that contradicts all
others; so many contradictions that none can be trusted; a click that no other click checks; a scene that
its clicks place badly."""


@dataclass(frozen=True)
class Statement:
    """What clicks say about one another, for a person.

    Attributes:
        clicks: the wrong ones; for `disagree`, all those of which one is wrong.
        text: one line: what is wrong, where, and what to do.
        evidence: fall of the squared error, in units of the click noise, when the mistake is undone.
    """

    kind: StatementKind
    clicks: tuple[Click, ...]
    text: str
    evidence: float = 0.0

    @property
    def blames(self) -> bool:
        """Whether these very clicks are wrong, not only one among them."""
        return self.kind in ("swapped", "wrong name", "wrong place", "whole scene")


@dataclass(frozen=True)
class NextClick:
    """A further click and what it should bring.

    Attributes:
        gain_mm: by how much the expected error falls, mean over all scenes and keypoints.
        left_mm: the expected error of this scene's keypoints afterwards, mean.
    """

    scene: str
    frame: int
    keypoint: int
    gain_mm: float
    left_mm: float


@dataclass(frozen=True)
class Solution:
    """The solution of Eq. 2: the sparse model and the object's pose in every scene.

    Attributes:
        model: the sparse model in the object frame (centroid of the keypoints, axes of the first
            scene).
        covariance: one 3x3 covariance per keypoint, in m^2, in the object frame: how well the shape is
            known. NaN where the keypoint was never clicked.
        scene_from_object: one rigid transform per scene, by scene name. The paper's T_s.
        residuals: one per click, in the order of the clicks.
        warnings: lines for the user.
        covariance_in_scene: one 3x3 covariance per keypoint of its position in each scene, in m^2, in that
            scene's frame: shape and pose together, so it is what a label can be off by. A scene is absent
            in solutions written before this was computed.
        click_sigma_px: standard deviation of a click per axis, estimated from the residuals; None when
            it was not.
        depth_sigma_ratio: by how much the errors of the depths exceed what was stated for them; None
            when it was not estimated.
        statements: which clicks contradict the others or are checked by none, the worst first.
        next_clicks: further clicks in frames that have some, the most useful first.
    """

    model: KeypointModel
    covariance: Float64[np.ndarray, "k 3 3"]
    scene_from_object: Mapping[str, Float64[np.ndarray, "4 4"]]
    residuals: tuple[ClickResidual, ...] = ()
    warnings: tuple[str, ...] = ()
    covariance_in_scene: Mapping[str, Float64[np.ndarray, "k 3 3"]] = field(default_factory=dict)
    click_sigma_px: float | None = None
    depth_sigma_ratio: float | None = None
    statements: tuple[Statement, ...] = ()
    next_clicks: tuple[NextClick, ...] = ()

    @property
    def expected_mm(self) -> dict[str, float]:
        """Expected error of the keypoints in each scene, in space: root mean square over the keypoints."""
        return {
            name: 1e3 * float(np.sqrt(np.nanmean(np.trace(found, axis1=1, axis2=2))))
            for name, found in self.covariance_in_scene.items()
        }

    def covariance_at(self, scene: str) -> Float64[np.ndarray, "k 3 3"]:
        """Covariance of each keypoint's position in that scene, in m^2, along the axes of the object frame.

        Where it was not computed, that of the shape alone.
        """
        found = self.covariance_in_scene.get(scene)
        if found is None:
            return self.covariance
        turn = self.scene_from_object[scene][:3, :3]
        turned: Float64[np.ndarray, "k 3 3"] = turn.T @ found @ turn
        return turned


@dataclass(frozen=True)
class Mesh:
    """Triangles, counter-clockwise seen from outside; metres.

    Attributes:
        colors: RGB of every vertex; None when unknown.
    """

    vertices: Float64[np.ndarray, "n 3"]
    triangles: Int64[np.ndarray, "m 3"]
    colors: UInt8[np.ndarray, "n 3"] | None = None


@dataclass(frozen=True)
class PointCloud:
    """Points with unit normals pointing out of the surface; metres."""

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"] | None = None


class Rle(TypedDict):
    """A mask in COCO's compressed run-length encoding, JSON-ready (`counts` is ASCII text)."""

    size: list[int]
    counts: str


@dataclass(frozen=True)
class SquareBox:
    """The paper's box b = (x, y, h): an upright square around the keypoints, scaled by 1.5."""

    cx_px: float
    cy_px: float
    side_px: float


Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels with COCO's edges: a mask of the one pixel (u, v) has box
(u, v, u + 1, v + 1)."""


@dataclass(frozen=True)
class InstanceLabel:
    """One object in one frame.

    Attributes:
        keypoints_px: projected keypoints, possibly outside the image; NaN where the keypoint has
            no position or lies behind the camera.
        visibility: COCO's v of each keypoint: 0 not labelled, 1 hidden, 2 seen.
        sigma_px: standard deviation of each projected keypoint; NaN where v = 0.
        box: box of the visible mask; None when nothing is visible.
        box_full: box of the full mask, clipped to the image.
        mask: visible pixels.
        mask_full: all pixels that the object would cover if nothing hid it.
        visib_fract: visible share of the full mask's pixels.
        truncated: whether the object extends beyond the image.
        quality: 0 (bad) to 1 (depth agrees with the model wherever it was measured).
    """

    object: str
    camera_from_object: Float64[np.ndarray, "4 4"]
    keypoints_px: Float64[np.ndarray, "k 2"]
    visibility: Int64[np.ndarray, " k"]
    sigma_px: Float64[np.ndarray, " k"]
    square_box: SquareBox
    box: Box | None
    box_full: Box
    mask: Rle
    mask_full: Rle
    visib_fract: float
    truncated: bool
    quality: float


@dataclass(frozen=True)
class FrameLabel:
    """The labels of one frame; objects that are not in the image have no instance."""

    scene: str
    frame: int
    timestamp_s: float
    instances: tuple[InstanceLabel, ...] = field(default=())


@dataclass(frozen=True)
class QualityRow:
    """Errors of an object's model and labels relative to the truth: one row of the printed table.

    NaN where nothing could be measured. 2D errors are means over the labelled keypoints of a frame;
    mean, median and 95th percentile are over frames, as the means and the worst of the IoU are.

    Attributes:
        keypoints_known: how many of the `keypoints` have a position.
        position_mm, rotation_deg: mean pose error after the one rigid alignment of the two models.
        frames: how many of the `truth_frames` have a label.
        missed: labelled frames without this object although the truth has it.
        invented: labelled frames with this object although the truth does not have it.
    """

    object: str
    keypoints: int
    keypoints_known: int
    error_3d_mean_mm: float
    error_3d_max_mm: float
    error_2d_mean_px: float
    error_2d_median_px: float
    error_2d_p95_px: float
    iou_full_mean: float
    iou_full_worst: float
    iou_visible_mean: float
    iou_visible_worst: float
    position_mm: float
    rotation_deg: float
    frames: int
    truth_frames: int
    missed: int
    invented: int


DepthUnits = UInt16[np.ndarray, "height width"]

Span = tuple[int, int]
"""First and last frame (`Frame.index`)."""

ReadDepth = Callable[[Frame], DepthImage]
"""Reads the depth image of a frame in metres, 0 = none, from a workspace's cache or from the recording."""

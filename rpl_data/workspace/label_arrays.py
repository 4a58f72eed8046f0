"""The labels of one object as NumPy arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.types import DataError, FrameLabel, InstanceLabel
from rpl_data.wording import counted


@dataclass(frozen=True, repr=False)
class LabelArrays:
    """All labels of one object: n rows, one per labelled frame that shows it.

    Attributes:
        object: the object's name.
        scenes: name of the recording of each row.
        frames: `Frame.index` of each row: the number of the frame in its recording.
        timestamps_s: time of each colour image, seconds.
        camera_from_object: one rigid transform per row; it takes points of the object frame to the camera
            frame, metres.
        keypoints_px: projected keypoints (u, v) in pixels of the colour image, possibly outside of it; NaN
            where a keypoint has no position or lies behind the camera.
        visibility: of each keypoint: 0 never clicked or outside the image, 1 hidden, 2 seen.
        boxes_px: x0, y0, x1, y1 of the visible mask with COCO's edges; NaN where nothing is visible.
        visib_fract: visible share of the object's pixels, 0 to 1.
        quality: from 1 (certain) to 0: 1 / (1 + e / 5 px), where e is the label's expected error.
    """

    object: str
    scenes: tuple[str, ...]
    frames: Int64[np.ndarray, " n"]
    timestamps_s: Float64[np.ndarray, " n"]
    camera_from_object: Float64[np.ndarray, "n 4 4"]
    keypoints_px: Float64[np.ndarray, "n k 2"]
    visibility: Int64[np.ndarray, "n k"]
    boxes_px: Float64[np.ndarray, "n 4"]
    visib_fract: Float64[np.ndarray, " n"]
    quality: Float64[np.ndarray, " n"]

    def __repr__(self) -> str:
        scenes, keypoints = len(set(self.scenes)), self.keypoints_px.shape[1]
        return (
            f"LabelArrays of {self.object}: {counted(len(self), 'label')} in {counted(scenes, 'scene')}, "
            f"{counted(keypoints, 'keypoint')}"
        )

    def __len__(self) -> int:
        """Number of labels."""
        return len(self.frames)


def label_arrays(object_name: str, labels: Iterable[FrameLabel]) -> LabelArrays:
    """Collect the labels of an object from some frames, in their order.

    Raises:
        DataError: the object is in none of the frames.
    """
    rows = [(label, item) for label in labels for item in label.instances if item.object == object_name]
    if not rows:
        raise DataError(
            f"object {object_name} has no label in these scenes; see the report for why, and label again"
        )
    items = [item for _, item in rows]
    return LabelArrays(
        object=object_name,
        scenes=tuple(label.scene for label, _ in rows),
        frames=np.array([label.frame for label, _ in rows], dtype=np.int64),
        timestamps_s=np.array([label.timestamp_s for label, _ in rows], dtype=np.float64),
        camera_from_object=np.stack([item.camera_from_object for item in items]),
        keypoints_px=np.stack([item.keypoints_px for item in items]),
        visibility=np.stack([item.visibility for item in items]),
        boxes_px=np.array([_box(item) for item in items], dtype=np.float64),
        visib_fract=np.array([item.visib_fract for item in items], dtype=np.float64),
        quality=np.array([item.quality for item in items], dtype=np.float64),
    )


def _box(item: InstanceLabel) -> tuple[float, ...]:
    return (np.nan,) * 4 if item.box is None else item.box

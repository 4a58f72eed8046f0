"""Cameras of a bag: sensor_msgs/CameraInfo, and how the depth camera stands to the colour camera.

Source: sensor_msgs/CameraInfo's own comments; realsense2_camera_msgs/Extrinsics: rotation column by column.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.formats.recordings.frame_files import intrinsics_of
from rpl_data.formats.recordings.ros.topics import ImageTopic
from rpl_data.geometry import Transform, is_rotation, rigid
from rpl_data.types import DataError, Intrinsics

_MODELS = ("", "plumb_bob", "rational_polynomial", "none")


def camera_of(info: Any, size: tuple[int, int], topic: ImageTopic, where: str) -> Intrinsics:
    """The camera of a topic's images.

    Images whose name says "rect" were rectified: their camera is P, without a lens. All others have K and D.

    Args:
        info: a decoded CameraInfo.
        size: width and height of the images.
        topic: the images' topic.
        where: the topic of `info`, for messages.

    Raises:
        DataError: the camera is not calibrated, or its lens is not OpenCV's, or its images have another size.
    """
    width, height = size
    if (info.width, info.height) != size and info.width and info.height:
        raise DataError(
            f"{where} is for images of {info.width} x {info.height} px, those of {topic.name} have "
            f"{width} x {height}; give their camera: `camera: [fx, fy, cx, cy]`"
        )
    k, p, lens = (np.array(_field(info, name), float).tolist() for name in "kpd")
    last = topic.base.rpartition("/")[2]
    if "rect" in last.split("_") and p[0] > 0:
        return intrinsics_of((p[0], p[5], p[2], p[6]), width, height)
    if not k[0] > 0:
        raise DataError(f"{where} says that the camera is not calibrated; give `camera: [fx, fy, cx, cy]`")
    return intrinsics_of((k[0], k[4], k[2], k[5], *_lens(info, lens, where)), width, height)


def _field(info: Any, name: str) -> Any:
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def _lens(info: Any, lens: list[float], where: str) -> tuple[float, ...]:
    """OpenCV's distortion: 4, 5 or 8 numbers, or none."""
    if not any(lens):
        return ()
    if info.distortion_model not in _MODELS or any(lens[8:]):
        raise DataError(
            f"{where}: a lens of model {info.distortion_model} with {len(lens)} numbers cannot be read; "
            "record rectified images (image_rect_color of image_proc), or give `camera: [fx, fy, cx, cy]`"
        )
    count = next(number for number in (4, 5, 8) if number >= min(len(lens), 8))
    return (*lens[:count], *[0.0] * (count - len(lens)))


def from_extrinsics(message: Any) -> Transform | None:
    """`color_from_depth` of a realsense-ros extrinsics message; None when it is not rigid."""
    rotation = np.array(message.rotation, float).reshape(3, 3, order="F")
    place_m = np.array(message.translation, float)
    return rigid(rotation, place_m) if is_rotation(rotation) and np.isfinite(place_m).all() else None

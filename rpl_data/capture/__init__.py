"""Cameras: record from those of five makers, and read the files that RealSense's own tools record."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Literal

from rpl_data.capture.camera import CameraStreams, Wanted
from rpl_data.capture.k4a import open_k4a
from rpl_data.capture.oak import open_oak
from rpl_data.capture.orbbec import open_orbbec
from rpl_data.capture.phone import open_phone
from rpl_data.capture.realsense import open_realsense

CameraName = Literal["realsense", "oak", "orbbec", "k4a", "phone"]

CAMERAS: dict[CameraName, Callable[[Wanted], AbstractContextManager[CameraStreams]]] = {
    "realsense": open_realsense,
    "oak": open_oak,
    "orbbec": open_orbbec,
    "k4a": open_k4a,
    "phone": open_phone,
}
"""How each kind of camera is opened."""

"""The calibration that an Azure Kinect (or an Orbbec Femto) puts into its recordings, calibration.json.

Cameras are stored for the whole sensor, in units of its width and height; (0, 0) is the corner of a pixel.
A mode bins the sensor and crops it: focal length in pixels = stored * binned size, principal point = stored *
binned size - crop - 0.5. A lens is cx, cy, fx, fy, k1 to k6, codx, cody, p2, p1 (Brown-Conrady, OpenCV's
rational model). Rt takes points from a common frame to the camera, in metres.
Sources: Azure-Kinect-Sensor-SDK, src/calibration/calibration.c, src/transformation/
mode_specific_calibration.c and extrinsic_transformation.c.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rpl_data.files import decoding
from rpl_data.geometry import Transform, invert, is_rotation, rigid
from rpl_data.types import DataError, Intrinsics


@dataclass(frozen=True)
class Mode:
    """How images come from the sensor.

    Attributes:
        binned: width and height of the whole sensor after binning.
        crop: columns and rows that are then cut off at the left and at the top.
        size: width and height of the images.
    """

    binned: tuple[int, int]
    crop: tuple[int, int]
    size: tuple[int, int]


DEPTH_MODES = {
    "NFOV_2X2BINNED": Mode((512, 512), (96, 90), (320, 288)),
    "NFOV_UNBINNED": Mode((1024, 1024), (192, 180), (640, 576)),
    "WFOV_2X2BINNED": Mode((512, 512), (0, 0), (512, 512)),
    "WFOV_UNBINNED": Mode((1024, 1024), (0, 0), (1024, 1024)),
}
COLOR_MODES = {
    "720P": Mode((1280, 960), (0, 120), (1280, 720)),
    "1080P": Mode((1920, 1440), (0, 180), (1920, 1080)),
    "1440P": Mode((2560, 1920), (0, 240), (2560, 1440)),
    "1536P": Mode((2048, 1536), (0, 0), (2048, 1536)),
    "2160P": Mode((3840, 2880), (0, 360), (3840, 2160)),
    "3072P": Mode((4096, 3072), (0, 0), (4096, 3072)),
}


@dataclass(frozen=True)
class K4aCalibration:
    """The two cameras in their modes, and how they stand to one another."""

    color: Intrinsics
    depth: Intrinsics
    color_from_depth: Transform


def k4a_calibration(content: bytes, depth_mode: Mode, color_mode: Mode, *, source: str) -> K4aCalibration:
    """Read calibration.json for two modes.

    Raises:
        DataError: it is damaged, lacks a camera, or has a lens of another model.
    """
    with decoding(source, "record it again"):
        cameras = json.loads(content)["CalibrationInformation"]["Cameras"]
        found = {str(camera["Location"]).rpartition("Location")[2]: camera for camera in cameras}
        depth, color = found["D0"], found["PV0"]
        color_from_depth = _camera_from_common(color) @ invert(_camera_from_common(depth))
        lenses = _intrinsics(color, color_mode, source), _intrinsics(depth, depth_mode, source)
        return K4aCalibration(*lenses, color_from_depth)


def _intrinsics(camera: Mapping[str, Any], mode: Mode, source: str) -> Intrinsics:
    model = str(camera["Intrinsics"]["ModelType"])
    values = [float(value) for value in camera["Intrinsics"]["ModelParameters"]]
    if not model.endswith("BrownConrady") or len(values) < 14 or any(values[10:12]):
        raise DataError(f"{source}: a lens of model {model} cannot be read; expected BrownConrady")
    if camera["SensorWidth"] * 9 == camera["SensorHeight"] * 16:  # early ones; 16:9 lies amid the 4:3 sensor
        values[1], values[3] = values[1] * 0.75 + 0.125, values[3] * 0.75
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = values[:14]
    if not np.isfinite(values).all() or min(fx, fy) <= 0:
        raise DataError(f"{source}: {' '.join(map(str, values[:4]))} is no camera; record it again")
    (width, height), (left, top) = mode.binned, mode.crop
    lens = (k1, k2, p1, p2, k3, k4, k5, k6)
    return Intrinsics(
        fx * width, fy * height, cx * width - left - 0.5, cy * height - top - 0.5, *mode.size, lens
    )


def _camera_from_common(camera: Mapping[str, Any]) -> Transform:
    rotation = np.array(camera["Rt"]["Rotation"], float).reshape(3, 3)
    place_m = np.array(camera["Rt"]["Translation"], float).reshape(3)
    if not is_rotation(rotation) or not np.isfinite(place_m).all() or np.abs(place_m).max() > 10:
        raise ValueError("Rt is no place of a camera")
    return rigid(rotation, place_m)

"""Sensor errors of an RGB-D camera such as the RealSense D435, applied to a perfect image.

Every effect is a field of `Sensor` with its own switch, so that a recipe can turn it off
(`twin: {sensor: {depth: {bleed_px: 0}}}`) and a test can measure it alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from rpl_data.twin.sensor.color import PERFECT_COLOR, ColorSensor, measure_color
from rpl_data.twin.sensor.depth import PERFECT_DEPTH, DepthSensor, PerfectView, measure_depth, shifted

__all__ = [
    "PERFECT_COLOR",
    "PERFECT_DEPTH",
    "ColorSensor",
    "DepthSensor",
    "PerfectView",
    "Sensor",
    "measure_color",
    "measure_depth",
    "shifted",
]


@dataclass(frozen=True)
class Sensor:
    """A camera: errors of its depth image, of its colour image, and of how they fit together.

    Attributes:
        depth, color: errors of each image.
        lag_frames: the depth image is this many frames older than the colour image it is stored with.
            About half a frame in hand-held D435 recordings whose streams are not synchronised.
        shift_px: the depth image is shifted by this to the right and down, relative to the colour image; one
            pixel is usual in a D435 whose calibration has aged.
    """

    depth: DepthSensor = field(default_factory=DepthSensor)
    color: ColorSensor = field(default_factory=ColorSensor)
    lag_frames: float = 0.0
    shift_px: tuple[float, float] = (0.0, 0.0)

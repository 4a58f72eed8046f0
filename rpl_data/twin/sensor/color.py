"""The colour image of a hand-held camera with a rolling shutter."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from rpl_data.twin.sensor.motion import row_delay_s
from rpl_data.types import ColorImage

GAMMA = 2.2
Flow = Float32[np.ndarray, "height width 2"]
"""Velocity of every pixel's content to the right and down, in pixels per second."""


@dataclass(frozen=True)
class ColorSensor:
    """Errors of the colour image; set a number to 0 to switch its effect off.

    Attributes:
        blur_px: blur by lens, Bayer pattern and sharpening; standard deviation of a Gaussian.
        exposure_s: time for which a pixel collects light while the camera moves; a RealSense on automatic
            takes 5 to 16 ms indoors.
        readout_s: time between the exposure of the first and of the last row. The image's time and pose are
            those of its middle row. About 17 ms in a D435's colour camera, whose shutter rolls (D400 series
            datasheet); 0 by default, since otherwise clicks and labels of a fast frame are truly off.
        noise: standard deviation in dark parts, grey levels.
        shot_noise: standard deviation that is added at white, grey levels: the variance grows with the
            light (EMVA standard 1288, the linear model).
        exposure_spread: standard deviation of the brightness from frame to frame, relative.
        jpeg_quality: 1 to 100.
    """

    blur_px: float = 0.55
    exposure_s: float = 0.006
    readout_s: float = 0.0
    noise: float = 1.2
    shot_noise: float = 2.0
    exposure_spread: float = 0.02
    jpeg_quality: int = 92


PERFECT_COLOR = ColorSensor(blur_px=0.0, exposure_s=0.0, noise=0.0, shot_noise=0.0, exposure_spread=0.0)
"""No effect before compression; add single effects with `dataclasses.replace`."""


def measure_color(
    color: ColorImage, sensor: ColorSensor, *, flow_px_s: Flow | None, rng: np.random.Generator
) -> ColorImage:
    """Apply motion blur, lens blur, exposure and noise to the colour image; compression comes later.

    Args:
        flow_px_s: velocity of every pixel; None when the camera stands still.
    """
    image = color.astype(np.float32)
    if flow_px_s is not None:
        image = _moved(image, flow_px_s, sensor)
    if sensor.blur_px > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sensor.blur_px), dtype=np.float32)
    image *= np.float32(1 + sensor.exposure_spread * rng.standard_normal())
    sigma = np.sqrt(np.float32(sensor.noise**2) + np.float32(sensor.shot_noise**2) / 255 * image.clip(0, 255))
    image += sigma * rng.standard_normal(image.shape, dtype=np.float32)
    return np.round(image).clip(0, 255).astype(np.uint8)


def _moved(image: Float32[np.ndarray, "height width 3"], flow_px_s: Flow, sensor: ColorSensor) -> np.ndarray:
    """Mean light over the exposure: the image warped to several moments, one per pixel of motion."""
    height, width = image.shape[:2]
    fastest_px_s = float(np.abs(flow_px_s).max())
    if fastest_px_s * max(sensor.exposure_s, sensor.readout_s) < 0.1:
        return image
    moments = int(np.clip(np.ceil(fastest_px_s * sensor.exposure_s), 1, 9))
    v, u = np.mgrid[:height, :width].astype(np.float32)
    delay_s = row_delay_s(v, height, sensor.readout_s).astype(np.float32)
    light = np.power(image / 255, np.float32(GAMMA))
    total = np.zeros_like(light)
    for moment in range(moments):
        later_s = delay_s + np.float32(sensor.exposure_s * ((moment + 0.5) / moments - 0.5))
        at = u - flow_px_s[..., 0] * later_s, v - flow_px_s[..., 1] * later_s
        total += cv2.remap(light, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return 255 * np.power(total / moments, np.float32(1 / GAMMA))

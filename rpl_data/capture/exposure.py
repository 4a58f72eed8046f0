"""Lock exposure and white balance of the colour camera at what the automatic control had chosen.

A keypoint that is clicked in one frame must look the same in the next; automatic exposure changes it with
every white wall. The colour sensor of a D400 does not report what its automatic chose (librealsense issues
2549, 5035, 9437: option and metadata show the last manual value), so this is searched again manually:
exposure,
and gain where the frame rate allows no more time, until the image is as bright as before; then the white
balance, until red and blue have the same ratio as before.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

TRIES = 12
CLOSE = 0.06
"""Relative difference of brightness that is not corrected."""

UNLIKE = 0.25
"""Relative difference that is too large: the automatic control is switched on again."""

LARGEST_STEP = 4.0
GAMMA = 1.8
"""Brightness is about the light to the power of 1 / this."""

MeanColor = Callable[[], Float64[np.ndarray, "3"]]
"""Mean red, green and blue, 0-255, of the next images taken with the present settings."""


@dataclass(frozen=True)
class Range:
    """Values that an option of the sensor allows."""

    low: float
    high: float
    step: float

    def nearest(self, value: float) -> float:
        """The allowed value nearest to `value`."""
        inside = min(max(value, self.low), self.high)
        return self.low + round((inside - self.low) / self.step) * self.step if self.step else inside


def steady_rate(sensor: Any) -> None:
    """Forbid the automatic control to take fewer frames per second in dim light."""
    import pyrealsense2 as rs

    if sensor.supports(rs.option.auto_exposure_priority):
        with suppress(RuntimeError):  # some firmware refuses; then the rate drops in the dark
            sensor.set_option(rs.option.auto_exposure_priority, 0)


def lock(sensor: Any, mean_color: MeanColor, *, rate_hz: int) -> tuple[str, ...]:
    """Switch the automatic controls off, keep the images as they were, and return lines about the result.

    Args:
        sensor: sensor of the colour camera.
        mean_color: measures the next images.
        rate_hz: frames per second, which limits the exposure time.
    """
    before = mean_color()
    wanted_red = float((before[0] + 1) / (before[2] + 1))
    try:
        return (
            _lock_exposure(sensor, lambda: float(mean_color().mean()), float(before.mean()), rate_hz),
            _lock_white_balance(sensor, mean_color, wanted_red),
        )
    except RuntimeError as error:
        return (f"the camera refused to hold exposure or white balance: {error}",)


def _lock_exposure(sensor: Any, brightness: Callable[[], float], wanted: float, rate_hz: int) -> str:
    import pyrealsense2 as rs

    automatic = rs.option.enable_auto_exposure
    if not (sensor.supports(automatic) and sensor.supports(rs.option.exposure)):
        return "exposure cannot be locked on this camera"
    sensor.set_option(automatic, 0)
    found = _match_brightness(sensor, brightness, wanted, rate_hz)
    if abs(found - wanted) > UNLIKE * wanted:
        sensor.set_option(automatic, 1)
        return (
            f"exposure stays automatic: locked, the images would have brightness {found:.0f} instead of "
            f"{wanted:.0f} of 255; more light helps"
        )
    values = [f"{key} {sensor.get_option(getattr(rs.option, key)):g}" for key in _keys(sensor)]
    return f"locked {', '.join(values)}: brightness {found:.0f} of 255, under the automatic {wanted:.0f}"


def _keys(sensor: Any) -> list[str]:
    """The options that make an image brighter, in order of use: exposure first, since gain adds noise."""
    import pyrealsense2 as rs

    return [key for key in ("exposure", "gain") if sensor.supports(getattr(rs.option, key))]


def _match_brightness(sensor: Any, brightness: Callable[[], float], wanted: float, rate_hz: int) -> float:
    """Change one option after the other until the brightness is right; returns the brightness reached."""
    import pyrealsense2 as rs

    found = brightness()
    for key in _keys(sensor):
        option = getattr(rs.option, key)
        allowed = _range(sensor, option)
        if key == "exposure":
            allowed = _within_a_frame(allowed, rate_hz)
        for _ in range(TRIES):
            if abs(found - wanted) <= CLOSE * wanted:
                return found
            now = sensor.get_option(option)
            factor = ((wanted + 1) / (found + 1)) ** GAMMA
            new = allowed.nearest(max(now, 1.0) * min(max(factor, 1 / LARGEST_STEP), LARGEST_STEP))
            if new == now:
                break
            sensor.set_option(option, new)
            found = brightness()
    return found


def _within_a_frame(allowed: Range, rate_hz: int) -> Range:
    """Exposure times that do not lower the frame rate.

    Colour sensors count in units of 0.1 ms and reach 1 s, which is 10,000; stereo sensors count microseconds
    and go further.
    """
    unit_s = 1e-4 if allowed.high <= 10_000 else 1e-6
    return Range(allowed.low, min(allowed.high, 1 / rate_hz / unit_s), allowed.step)


def _lock_white_balance(sensor: Any, mean_color: MeanColor, wanted_red: float) -> str:
    """Search colour temperatures by bisection; a higher one makes the image redder."""
    import pyrealsense2 as rs

    automatic, option = rs.option.enable_auto_white_balance, rs.option.white_balance
    if not (sensor.supports(automatic) and sensor.supports(option)):
        return "white balance cannot be locked on this camera"
    allowed = _range(sensor, option)
    low, high, red = allowed.low, allowed.high, 0.0
    sensor.set_option(automatic, 0)
    for _ in range(TRIES):
        middle = allowed.nearest((low + high) / 2)
        sensor.set_option(option, middle)
        color = mean_color()
        red = float((color[0] + 1) / (color[2] + 1))
        if abs(red - wanted_red) <= CLOSE / 3 * wanted_red or high - low <= 2 * allowed.step:
            break
        low, high = (middle, high) if red < wanted_red else (low, middle)
    if abs(red - wanted_red) > UNLIKE * wanted_red:
        sensor.set_option(automatic, 1)
        return "white balance stays automatic: no fixed value gives the same colours"
    return f"locked white balance {sensor.get_option(option):g} K"


def _range(sensor: Any, option: Any) -> Range:
    found = sensor.get_option_range(option)
    return Range(found.min, found.max, found.step)

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
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

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


Key = Literal["auto_exposure", "exposure", "gain", "auto_white_balance", "white_balance"]
"""Controls of a colour camera; the automatic ones are 1 (on) or 0 (off)."""


@runtime_checkable
class Controls(Protocol):
    """The controls of a camera, by one name for each whoever made it."""

    @property
    def refusals(self) -> tuple[type[Exception], ...]:
        """What the maker's package raises when the camera refuses a value."""

    def supports(self, key: Key) -> bool:
        """Whether the camera has this control."""

    def get(self, key: Key) -> float:
        """The value of a control."""

    def set(self, key: Key, value: float) -> None:
        """Set a control."""

    def range(self, key: Key) -> Range:
        """The values that a control allows."""


def lock(controls: Controls, mean_color: MeanColor, *, rate_hz: int) -> tuple[str, ...]:
    """Switch the automatic controls off, keep the images as they were, and return lines about the result.

    Args:
        controls: those of the colour camera.
        mean_color: measures the next images.
        rate_hz: frames per second, which limits the exposure time.
    """
    before = mean_color()
    wanted_red = float((before[0] + 1) / (before[2] + 1))
    try:
        return (
            _lock_exposure(controls, lambda: float(mean_color().mean()), float(before.mean()), rate_hz),
            _lock_white_balance(controls, mean_color, wanted_red),
        )
    except controls.refusals as error:
        return (f"the camera refused to hold exposure or white balance: {error}",)


def _lock_exposure(controls: Controls, brightness: Callable[[], float], wanted: float, rate_hz: int) -> str:
    if not (controls.supports("auto_exposure") and controls.supports("exposure")):
        return "exposure cannot be locked on this camera"
    controls.set("auto_exposure", 0.0)
    found = _match_brightness(controls, brightness, wanted, rate_hz)
    if abs(found - wanted) > UNLIKE * wanted:
        controls.set("auto_exposure", 1.0)
        return (
            f"exposure stays automatic: locked, the images would have brightness {found:.0f} instead of "
            f"{wanted:.0f} of 255; more light helps"
        )
    values = [f"{key} {controls.get(key):g}" for key in _keys(controls)]
    return f"locked {', '.join(values)}: brightness {found:.0f} of 255, under the automatic {wanted:.0f}"


def _keys(controls: Controls) -> list[Key]:
    """The controls that make an image brighter, in order of use: exposure first, since gain adds noise."""
    brighter: tuple[Key, ...] = ("exposure", "gain")
    return [key for key in brighter if controls.supports(key)]


def _match_brightness(
    controls: Controls, brightness: Callable[[], float], wanted: float, rate_hz: int
) -> float:
    """Change one control after the other until the brightness is right; returns the brightness reached."""
    found = brightness()
    for key in _keys(controls):
        allowed = controls.range(key)
        if key == "exposure":
            allowed = _within_a_frame(allowed, rate_hz)
        for _ in range(TRIES):
            if abs(found - wanted) <= CLOSE * wanted:
                return found
            now = controls.get(key)
            factor = ((wanted + 1) / (found + 1)) ** GAMMA
            new = allowed.nearest(max(now, 1.0) * min(max(factor, 1 / LARGEST_STEP), LARGEST_STEP))
            if new == now:
                break
            controls.set(key, new)
            found = brightness()
    return found


def _within_a_frame(allowed: Range, rate_hz: int) -> Range:
    """Exposure times that do not lower the frame rate.

    Colour sensors count in units of 0.1 ms and reach 1 s, which is 10,000; stereo sensors count microseconds
    and go further.
    """
    unit_s = 1e-4 if allowed.high <= 10_000 else 1e-6
    return Range(allowed.low, min(allowed.high, 1 / rate_hz / unit_s), allowed.step)


def _lock_white_balance(controls: Controls, mean_color: MeanColor, wanted_red: float) -> str:
    """Search colour temperatures by bisection; a higher one makes the image redder."""
    if not (controls.supports("auto_white_balance") and controls.supports("white_balance")):
        return "white balance cannot be locked on this camera"
    allowed = controls.range("white_balance")
    low, high, red = allowed.low, allowed.high, 0.0
    controls.set("auto_white_balance", 0.0)
    for _ in range(TRIES):
        middle = allowed.nearest((low + high) / 2)
        controls.set("white_balance", middle)
        color = mean_color()
        red = float((color[0] + 1) / (color[2] + 1))
        if abs(red - wanted_red) <= CLOSE / 3 * wanted_red or high - low <= 2 * allowed.step:
            break
        low, high = (middle, high) if red < wanted_red else (low, middle)
    if abs(red - wanted_red) > UNLIKE * wanted_red:
        controls.set("auto_white_balance", 1.0)
        return "white balance stays automatic: no fixed value gives the same colours"
    return f"locked white balance {controls.get('white_balance'):g} K"

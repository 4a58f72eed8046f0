"""`pyk4a` made of software, as far as the capture uses it.

Depth is at the colour pixels only where the SDK moved it there (`transformed_depth`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from functools import lru_cache
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

NAMES = (
    "connected_device_count", "PyK4A.open", "PyK4A.close", "PyK4A.start", "PyK4A.stop", "PyK4A.get_capture",
    "PyK4A.serial", "PyK4A.calibration", "PyK4A.exposure", "PyK4A.exposure_mode_auto", "PyK4A.gain",
    "PyK4A.whitebalance", "PyK4A.whitebalance_mode_auto", "Config.__init__", "K4AException",
    "K4ATimeoutException", "ColorResolution.RES_720P", "ColorResolution.RES_1080P",
    "ColorResolution.RES_1440P", "ColorResolution.RES_1536P", "ColorResolution.RES_2160P",
    "ColorResolution.RES_3072P", "FPS.FPS_5", "FPS.FPS_15", "FPS.FPS_30", "ImageFormat.COLOR_BGRA32",
    "DepthMode.NFOV_UNBINNED", "CalibrationType.COLOR", "Calibration.get_camera_matrix",
    "Calibration.get_distortion_coefficients", "PyK4ACapture.color", "PyK4ACapture.depth",
    "PyK4ACapture.transformed_depth", "PyK4ACapture.color_timestamp_usec",
    "PyK4ACapture.color_exposure_usec", "PyK4ACapture.color_white_balance",
)  # fmt: skip
"""What of the package is imitated; a test looks for each name where the package is installed."""

SIZE = (1280, 720)
K = np.array([[605.5, 0, 638.25], [0, 605.25, 366.5], [0, 0, 1]])
LENS = np.array([0.5, -2.5, 0.001, 0.002, 1.5, 0.25, -2.25, 1.25])


class K4AException(Exception):
    pass


class K4ATimeoutException(K4AException):
    pass


@lru_cache(maxsize=60)
def color_bgra(number: int) -> np.ndarray:
    """Red says which image it is."""
    pixels = np.zeros((SIZE[1], SIZE[0], 4), np.uint8)
    pixels[..., 2], pixels[:, : SIZE[0] // 2, 1], pixels[..., 3] = 5 * number, 200, 255
    return pixels


@lru_cache(maxsize=60)
def depth_mm(number: int) -> np.ndarray:
    """A wall, a box before it, and a part that the depth camera does not see."""
    pixels = np.full((SIZE[1], SIZE[0]), 900 + number, np.uint16)
    pixels[200:400, 500:800] = 700
    pixels[:, :40] = 0
    return pixels


class SoftwareKinect:
    """An Azure Kinect, as a module `pyk4a`."""

    def __init__(
        self,
        *,
        serials: tuple[str, ...] = ("000123",),
        until: int = 10**9,
        lost: Callable[[int], bool] = lambda number: False,
    ) -> None:
        self.serials, self.until, self.lost = serials, until, lost
        self.number = self.calls = 0
        self.devices: list[Any] = []
        self.module = self._module()

    def _module(self) -> ModuleType:
        k4a: Any = ModuleType("pyk4a")
        k4a.K4AException, k4a.K4ATimeoutException = K4AException, K4ATimeoutException
        k4a.ColorResolution = Enum("ColorResolution", "RES_720P RES_1080P")
        k4a.ImageFormat = Enum("ImageFormat", "COLOR_MJPG COLOR_BGRA32")
        k4a.DepthMode = Enum("DepthMode", "NFOV_UNBINNED WFOV_2X2BINNED")
        k4a.FPS = Enum("FPS", "FPS_5 FPS_15 FPS_30")
        k4a.CalibrationType = Enum("CalibrationType", "DEPTH COLOR")
        k4a.Config = lambda **settings: SimpleNamespace(**settings)
        k4a.connected_device_count = lambda: len(self.serials)
        k4a.PyK4A = lambda config, device_id: Kinect(self, config, device_id)
        return k4a


class Kinect:
    def __init__(self, maker: SoftwareKinect, config: Any, number: int) -> None:
        self._maker, self.config, self.serial = maker, config, maker.serials[number]
        self.opened = self.is_running = False
        self.exposure_mode_auto, self._exposure = True, 0
        self.whitebalance_mode_auto, self._balance, self.gain = True, 0, 64
        maker.devices.append(self)

    def open(self) -> None:
        if self.serial == "busy":
            raise K4AException
        self.opened = True

    def start(self) -> None:
        assert self.opened
        if self.serial == "without power":
            raise K4AException
        self.is_running = True

    def stop(self) -> None:
        self.close()
        self.is_running = False

    def close(self) -> None:
        self.opened = False

    @property
    def exposure(self) -> int:
        return self._exposure

    @exposure.setter
    def exposure(self, value: int) -> None:
        if not 500 <= value <= 133_330:
            raise K4AException
        self._exposure, self.exposure_mode_auto = value, False

    @property
    def whitebalance(self) -> int:
        return self._balance

    @whitebalance.setter
    def whitebalance(self, value: int) -> None:
        self._balance, self.whitebalance_mode_auto = value, False

    @property
    def calibration(self) -> Any:
        def known(matrix: np.ndarray) -> Callable[[Any], np.ndarray]:
            return lambda kind: matrix if kind.name == "COLOR" else np.zeros_like(matrix)

        return SimpleNamespace(get_camera_matrix=known(K), get_distortion_coefficients=known(LENS))

    def get_capture(self, timeout: int) -> Any:
        maker = self._maker
        time.sleep(0.002)
        maker.calls += 1
        if maker.calls % 7 == 0:  # as when the computer is busy
            raise K4ATimeoutException
        while maker.lost(maker.number):
            maker.number += 1
        if maker.number >= maker.until:
            raise K4AException
        number, maker.number = maker.number, maker.number + 1
        assert self.config.color_format.name == "COLOR_BGRA32" and self.config.synchronized_images_only
        return SimpleNamespace(
            color=color_bgra(number % 50),
            depth=np.zeros((576, 640), np.uint16),
            transformed_depth=depth_mm(number % 50),
            color_timestamp_usec=round(1e6 * (1 + number / 30)) + number % 3,
            color_exposure_usec=8330,
            color_white_balance=3600,
        )

"""`record3d` made of software, as far as the capture uses it.

As in the package, each image is written into the same memory as the one before, and `on_new_frame` is called
by a thread of its own; an exception there would end the program.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

NAMES = (
    "Record3DStream.get_connected_devices", "Record3DStream.connect", "Record3DStream.disconnect",
    "Record3DStream.on_new_frame", "Record3DStream.on_stream_stopped", "Record3DStream.get_rgb_frame",
    "Record3DStream.get_depth_frame", "Record3DStream.get_confidence_frame",
    "Record3DStream.get_intrinsic_mat", "Record3DStream.get_device_type", "DeviceInfo.udid",
    "IntrinsicMatrixCoeffs.fx", "IntrinsicMatrixCoeffs.fy", "IntrinsicMatrixCoeffs.tx",
    "IntrinsicMatrixCoeffs.ty",
)  # fmt: skip
"""What of the package is imitated; a test looks for each name where the package is installed."""

COLOR_PX, DEPTH_PX = (96, 128), (24, 32)
FOCAL_PX = 100.0


def depth_m(number: int) -> np.ndarray:
    """Noise that no two images share, and a hole."""
    found = np.random.default_rng(number).uniform(0.6, 0.9, DEPTH_PX[::-1]).astype(np.float32)
    found[3, 4] = np.nan
    return found


class SoftwarePhone:
    """A phone, as a module `record3d`."""

    def __init__(
        self,
        *,
        serials: tuple[str, ...] = ("00008101-A",),
        until: int = 10**9,
        lost: Callable[[int], bool] = lambda number: False,
        streams: bool = True,
        device_type: int = 1,
        depth_px: tuple[int, int] = DEPTH_PX,
        refocus_px: float = 0.0,
    ) -> None:
        self.serials, self.until, self.lost, self.streams = serials, until, lost, streams
        self.device_type, self.depth_px, self.refocus_px = device_type, depth_px, refocus_px
        self.failure: Exception | None = None
        self.module: Any = ModuleType("record3d")
        self.module.Record3DStream = lambda: Stream(self)
        self.module.Record3DStream.get_connected_devices = lambda: [
            SimpleNamespace(udid=serial, product_id=1) for serial in self.serials
        ]


class Stream:
    def __init__(self, phone: SoftwarePhone) -> None:
        self._phone, self._stop, self.number = phone, threading.Event(), 0
        self._color = np.zeros((*COLOR_PX[::-1], 3), np.uint8)
        self._depth = np.zeros(phone.depth_px[::-1], np.float32)
        self._thread = threading.Thread(target=self._run)
        self.on_new_frame: Callable[[], None] = lambda: None
        self.on_stream_stopped: Callable[[], None] = lambda: None

    def connect(self, device: Any) -> bool:
        if self._phone.streams:
            self._thread.start()
        return self._phone.streams

    def disconnect(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self.on_stream_stopped()

    def _run(self) -> None:
        try:
            while not self._stop.wait(0.005) and self.number < self._phone.until:
                self._color[..., 0] = 5 * (self.number % 50)
                if self._depth.shape == DEPTH_PX[::-1]:
                    self._depth[:] = depth_m(self.number % 50)
                self.on_new_frame()
                self._color[:], self._depth[:] = 255, 9.0  # the next image arrives
                self.number += 1
        except Exception as error:
            self._phone.failure = error
        if not self._stop.is_set():
            self.on_stream_stopped()

    def get_rgb_frame(self) -> np.ndarray:
        if self._phone.lost(self.number):
            raise ValueError("cannot reshape array of size 0 into shape (128,96,3)")
        return self._color

    def get_depth_frame(self) -> np.ndarray:
        return self._depth

    def get_confidence_frame(self) -> np.ndarray:
        levels = np.full(self._phone.depth_px[::-1], 2, np.uint8)
        levels[10, 11] = 0
        return levels

    def get_intrinsic_mat(self) -> Any:
        focal = FOCAL_PX + self._phone.refocus_px * (self.number % 3 - 1)
        return SimpleNamespace(fx=focal, fy=focal + 1, tx=47.5, ty=63.25)

    def get_device_type(self) -> int:
        return self._phone.device_type

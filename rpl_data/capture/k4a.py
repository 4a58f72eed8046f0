"""The Azure Kinect, by the package `pyk4a` over Microsoft's Azure Kinect Sensor SDK.

The depth camera stands 32 mm beside the colour camera; the SDK moves depth onto the pixels of the colour
image, with its lens distortion. Tested against a software device only.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rpl_data.capture.camera import (
    POLL_S,
    Shot,
    StreamCamera,
    StreamCounts,
    UnpluggedError,
    Wanted,
    chosen_serial,
    first_of,
    needed,
    until_unplugged,
)
from rpl_data.capture.exposure import Key, MeanColor, Range, lock
from rpl_data.capture.lens import opencv_camera
from rpl_data.types import DataError

INSTALL = (
    "install Microsoft's Azure Kinect Sensor SDK with its headers, then run: pip install 'rpl-data[k4a]'"
)
SIZES_PX = {
    (1280, 720): "RES_720P",
    (1920, 1080): "RES_1080P",
    (2560, 1440): "RES_1440P",
    (2048, 1536): "RES_1536P",
    (3840, 2160): "RES_2160P",
    (4096, 3072): "RES_3072P",
}
USUAL_SIZE_PX = (1280, 720)
RATES_HZ = {5: "FPS_5", 15: "FPS_15", 30: "FPS_30"}
METRES_PER_UNIT = 0.001
"""Depth is in millimetres (k4a_image_format_t, K4A_IMAGE_FORMAT_DEPTH16)."""

RANGES = {
    "exposure": Range(500.0, 133_330.0, 1.0),
    "gain": Range(0.0, 255.0, 1.0),
    "white_balance": Range(2500.0, 12_500.0, 10.0),
}
"""What the controls allow (k4a_color_control_command_t): microseconds, no unit, kelvin."""


@contextmanager
def open_k4a(wanted: Wanted) -> Iterator[KinectStreams]:
    """Open the connected Azure Kinect while the block lasts.

    Raises:
        DataError: pyk4a is not installed, there is no camera, or it has no such streams.
    """
    pyk4a = needed("pyk4a", cameras="Azure Kinects", install=INSTALL)
    config = _config(pyk4a, wanted)
    kinect = _opened(pyk4a, config, wanted.serial)
    try:
        yield _started(pyk4a, kinect, wanted)
    finally:
        with suppress(pyk4a.K4AException):  # one that was unplugged cannot be stopped
            end = kinect.stop if kinect.is_running else kinect.close
            end()


def _started(pyk4a: Any, kinect: Any, wanted: Wanted) -> KinectStreams:
    """Start the cameras, and wait for the first pair."""
    try:
        kinect.start()
        streams = KinectStreams(pyk4a, kinect, f"Azure Kinect {kinect.serial}", wanted)
    except pyk4a.K4AException as error:
        reason = str(error) or "the SDK does not say why"
        raise DataError(
            f"cannot start the Azure Kinect: {reason}; close other programs that use it, plug in both its "
            "cables, or plug them in again"
        ) from error
    first_of(streams.poll, streams.name)
    return streams


def _config(pyk4a: Any, wanted: Wanted) -> Any:
    """Settings of the two cameras; pairs only."""
    size = wanted.size_px or USUAL_SIZE_PX
    if size not in SIZES_PX or wanted.rate_hz not in RATES_HZ or (size[1] == 3072 and wanted.rate_hz == 30):
        words = ", ".join(f"{width}x{height}" for width, height in SIZES_PX)
        raise DataError(
            f"an Azure Kinect does not give {size[0]}x{size[1]} colour at {wanted.rate_hz} Hz; it has "
            f"{words} at {', '.join(map(str, RATES_HZ))} Hz (the largest not at 30); choose with --width, "
            "--height and --fps"
        )
    return pyk4a.Config(
        color_resolution=getattr(pyk4a.ColorResolution, SIZES_PX[size]),
        color_format=pyk4a.ImageFormat.COLOR_BGRA32,
        depth_mode=pyk4a.DepthMode.NFOV_UNBINNED,
        camera_fps=getattr(pyk4a.FPS, RATES_HZ[wanted.rate_hz]),
        synchronized_images_only=True,
    )


def _opened(pyk4a: Any, config: Any, wanted: str | None) -> Any:
    """Open the camera with this serial number; the SDK tells it only of one that is open."""
    found = {}
    for number in range(pyk4a.connected_device_count()):
        kinect = pyk4a.PyK4A(config, device_id=number)
        with suppress(pyk4a.K4AException):  # in use by another program
            kinect.open()
            found[kinect.serial] = kinect
    serial = None
    try:
        serial = chosen_serial(
            list(found),
            wanted,
            cameras="Azure Kinect",
            hint="plug in its USB 3 and its power cable, and close other programs that use it (on Linux its "
            "udev rules must be installed, in a container the USB bus passed through)",
        )
        return found[serial]
    finally:
        for name, kinect in found.items():
            if name != serial:
                kinect.close()


@dataclass
class KinectStreams:
    """An open camera (`CameraStreams`).

    Attributes:
        pyk4a: the module.
        kinect: the running device.
        name: its name.
        wanted: what was asked for.
        counts: counts of frames.
        last: time in microseconds and number of the last shot; the camera numbers none, so numbers follow
            from its clock.
        capture: the last pair as pyk4a gave it.
    """

    pyk4a: Any
    kinect: Any
    name: str
    wanted: Wanted
    counts: StreamCounts = field(default_factory=StreamCounts)
    last: tuple[int, int] | None = None
    capture: Any = None

    @property
    def camera(self) -> StreamCamera:
        """What the device reports about itself."""
        known, kind = self.kinect.calibration, self.pyk4a.CalibrationType.COLOR
        k = np.asarray(known.get_camera_matrix(kind), float)
        intrinsics = opencv_camera(
            (k[0, 0], k[1, 1], k[0, 2], k[1, 2]),
            self.wanted.size_px or USUAL_SIZE_PX,
            known.get_distortion_coefficients(kind).tolist(),
        )
        return StreamCamera(intrinsics, METRES_PER_UNIT, self.name)

    def begin(self) -> None:
        """Count from zero again."""
        self.counts.clear()

    def shots(self, *, patience_s: float) -> Iterator[Shot]:
        """Yield shots until the camera is unplugged or silent."""
        return until_unplugged(self.poll, patience_s=patience_s)

    def lock_exposure(self, mean_color: MeanColor) -> tuple[str, ...]:
        """Hold exposure and white balance as they are now."""
        return lock(KinectControls(self), mean_color, rate_hz=self.wanted.rate_hz)

    def poll(self) -> Shot | None:
        """The next pair; None when none has come for a moment."""
        try:
            capture = self.kinect.get_capture(timeout=int(POLL_S * 1000))
            if capture.color is None or capture.depth is None:
                self.counts.color_alone += capture.color is not None
                return None
            depth = capture.transformed_depth
        except self.pyk4a.K4ATimeoutException:
            return None
        except self.pyk4a.K4AException as error:
            raise UnpluggedError from error
        self.counts.pairs += 1
        self.capture = capture
        return Shot(
            self._number(capture.color_timestamp_usec),
            capture.color_timestamp_usec / 1e6,
            np.ascontiguousarray(capture.color[..., 2::-1]),
            np.array(depth, np.uint16),
        )

    def _number(self, time_us: int) -> int:
        """Count images by the camera's clock."""
        if self.last is None:
            number = 0
        else:
            number = self.last[1] + max(1, round((time_us - self.last[0]) * 1e-6 * self.wanted.rate_hz))
        self.last = time_us, number
        return number


@dataclass(frozen=True)
class KinectControls:
    """The controls of the colour camera (`Controls`)."""

    streams: KinectStreams

    @property
    def refusals(self) -> tuple[type[Exception], ...]:
        """What the package raises when the camera refuses a value."""
        return (self.streams.pyk4a.K4AException,)

    def supports(self, key: Key) -> bool:
        """Whether the camera has this control; an Azure Kinect has all."""
        return True

    def get(self, key: Key) -> float:
        """The value of a control."""
        return float(getattr(self.streams.kinect, _NAMES[key]))

    def set(self, key: Key, value: float) -> None:
        """Set a control; switching an automatic off holds what it chose for the last image."""
        kinect, capture = self.streams.kinect, self.streams.capture
        if key == "auto_exposure" and not value:
            kinect.exposure = capture.color_exposure_usec
        elif key == "auto_white_balance" and not value:
            kinect.whitebalance = capture.color_white_balance
        else:
            setattr(kinect, _NAMES[key], bool(value) if key.startswith("auto_") else round(value))

    def range(self, key: Key) -> Range:
        """The values that a control allows."""
        return RANGES[key]


_NAMES: dict[Key, str] = {
    "auto_exposure": "exposure_mode_auto",
    "exposure": "exposure",
    "gain": "gain",
    "auto_white_balance": "whitebalance_mode_auto",
    "white_balance": "whitebalance",
}

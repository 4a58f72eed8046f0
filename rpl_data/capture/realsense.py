"""RealSense cameras: find the connected one, choose which of its streams to record, hold its exposure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from rpl_data.capture.camera import USB_HINT, Shot, StreamCamera, StreamCounts, Wanted, chosen_serial
from rpl_data.capture.device import COLOR_FORMATS, device_name, opened
from rpl_data.capture.exposure import Key, MeanColor, Range, lock
from rpl_data.capture.streams import Streams
from rpl_data.types import DataError

USUAL_SIZE_PX = (640, 480)


@contextmanager
def open_realsense(wanted: Wanted) -> Iterator[RealSenseStreams]:
    """Open the connected RealSense camera while the block lasts; depth is aligned to colour by librealsense.

    Raises:
        DataError: there is no camera, one must be chosen, or it has no such streams.
    """
    with open_device(connected_camera(wanted.serial), wanted) as streams:
        yield streams


@contextmanager
def open_device(device: Any, wanted: Wanted) -> Iterator[RealSenseStreams]:
    """Open a device of librealsense: a camera, or one made of software."""
    choices = choices_of(device, *(wanted.size_px or USUAL_SIZE_PX), wanted.rate_hz)
    sensor = choices[0][0]
    steady_rate(sensor)
    with opened(device, choices, lossless=False) as streams:
        yield RealSenseStreams(device, sensor, streams, wanted.rate_hz)


@dataclass(frozen=True)
class RealSenseStreams:
    """An open camera (`CameraStreams`).

    Attributes:
        device: the device of librealsense.
        sensor: its sensor for colour.
        streams: its colour and depth.
        rate_hz: images per second.
    """

    device: Any
    sensor: Any
    streams: Streams
    rate_hz: int

    @property
    def camera(self) -> StreamCamera:
        """What the device reports about itself."""
        return self.streams.camera

    @property
    def counts(self) -> StreamCounts:
        """Counts of frames, which grow while `shots` is read."""
        return self.streams.counts

    def begin(self) -> None:
        """Count from zero again."""
        self.counts.clear()

    def shots(self, *, patience_s: float) -> Iterator[Shot]:
        """Yield shots until the camera is unplugged or silent."""
        return self.streams.shots(patience_s=patience_s, ended=lambda: not self.device.is_connected())

    def lock_exposure(self, mean_color: MeanColor) -> tuple[str, ...]:
        """Hold exposure and white balance as they are now."""
        return lock(RealSenseControls(self.sensor), mean_color, rate_hz=self.rate_hz)


@dataclass(frozen=True)
class RealSenseControls:
    """The controls of a colour sensor of librealsense (`Controls`)."""

    sensor: Any
    refusals: tuple[type[Exception], ...] = (RuntimeError,)

    def supports(self, key: Key) -> bool:
        """Whether the sensor has this control."""
        return bool(self.sensor.supports(_option(key)))

    def get(self, key: Key) -> float:
        """The value of a control."""
        return float(self.sensor.get_option(_option(key)))

    def set(self, key: Key, value: float) -> None:
        """Set a control."""
        self.sensor.set_option(_option(key), value)

    def range(self, key: Key) -> Range:
        """The values that a control allows."""
        found = self.sensor.get_option_range(_option(key))
        return Range(found.min, found.max, found.step)


def _option(key: Key) -> Any:
    import pyrealsense2 as rs

    names = {"auto_exposure": "enable_auto_exposure", "auto_white_balance": "enable_auto_white_balance"}
    return getattr(rs.option, names.get(key, key))


def steady_rate(sensor: Any) -> None:
    """Forbid the automatic control to take fewer frames per second in dim light."""
    import pyrealsense2 as rs

    if sensor.supports(rs.option.auto_exposure_priority):
        with suppress(RuntimeError):  # some firmware refuses; then the rate drops in the dark
            sensor.set_option(rs.option.auto_exposure_priority, 0)


def connected_camera(serial: str | None = None) -> Any:
    """Return the connected RealSense camera, or the one with this serial number if there are several.

    Raises:
        DataError: there is none, or one must be chosen.
    """
    import pyrealsense2 as rs

    found = {device.get_info(rs.camera_info.serial_number): device for device in rs.context().query_devices()}
    hint = f"{USB_HINT}; --camera names that of another maker"
    return found[chosen_serial(list(found), serial, cameras="RealSense camera", hint=hint)]


def choices_of(device: Any, width: int, height: int, rate_hz: int) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Choose sensor and profile of colour and of depth; depth has the same size or the largest there is.

    Raises:
        DataError: the camera has no such streams; the message lists what it has.
    """
    size = (width, height)
    at_rate = [
        (sensor, profile)
        for sensor in device.query_sensors()
        for profile in sensor.get_stream_profiles()
        if profile.is_video_stream_profile() and profile.fps() == rate_hz
    ]
    colors = [c for c in _of_kind(at_rate, "color", COLOR_FORMATS) if _size(c) == size]
    depths = sorted(_of_kind(at_rate, "depth", ("z16",)), key=lambda c: (_size(c) == size, _size(c)))
    if not colors or not depths:
        every = ((s, p) for s in device.query_sensors() for p in s.get_stream_profiles())
        offered = sorted({(*_size(c), c[1].fps()) for c in _of_kind(list(every), "color", COLOR_FORMATS)})
        known = (
            ", ".join(f"{width}x{height} at {fps}" for width, height, fps in offered) or "no colour at all"
        )
        raise DataError(
            f"{device_name(device)} does not give {size[0]}x{size[1]} colour with depth at {rate_hz} Hz; "
            f"it has {known}; choose with --width, --height and --fps (a USB 2 port leaves little)"
        )
    return colors[0], depths[-1]


def _of_kind(choices: Sequence[tuple[Any, Any]], kind: str, formats: Sequence[str]) -> list[tuple[Any, Any]]:
    """Choices of one kind, the preferred formats first."""
    found = [c for c in choices if c[1].stream_type().name == kind and c[1].format().name in formats]
    return sorted(found, key=lambda choice: formats.index(choice[1].format().name))


def _size(choice: tuple[Any, Any]) -> tuple[int, int]:
    profile = choice[1].as_video_stream_profile()
    return profile.width(), profile.height()

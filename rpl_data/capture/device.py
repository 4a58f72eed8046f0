"""Choose, open and close the streams of a RealSense device of any kind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rpl_data.capture.camera import StreamCamera
from rpl_data.capture.lens import as_meant, intrinsics_of
from rpl_data.capture.streams import Streams
from rpl_data.types import DataError


def choose(profiles: Sequence[Any], kind: str, formats: Sequence[str]) -> Any | None:
    """The first profile of a kind ("color", "depth"); formats in order of preference."""
    for wanted in formats:
        for profile in profiles:
            if profile.stream_type().name == kind and profile.format().name == wanted:
                return profile
    return None


COLOR_FORMATS = ("rgb8", "bgr8", "rgba8", "bgra8", "yuyv", "uyvy")


@contextmanager
def opened(device: Any, choices: Sequence[tuple[Any, Any]], *, lossless: bool) -> Iterator[Streams]:
    """Open the streams of a device, and keep them running while the block lasts.

    Args:
        device: a camera, a playback or a software device.
        choices: sensor and profile of colour and of depth.
        lossless: wait for the reader instead of dropping frames; for files, which can wait.

    Raises:
        DataError: a stream cannot be opened.
    """
    (_, color), (depth_sensor, depth) = choices
    intrinsics, notes = intrinsics_of(color.as_video_stream_profile().get_intrinsics())
    camera = StreamCamera(intrinsics, depth_unit_m(depth_sensor), device_name(device), notes)
    streams = Streams(color, depth, camera, lossless=lossless)
    started: list[Any] = []
    try:
        _start(device, choices, streams, started)
        yield streams
    finally:
        streams.close()
        for sensor in started:
            _stop(sensor)


def _start(device: Any, choices: Sequence[tuple[Any, Any]], streams: Streams, started: list[Any]) -> None:
    """Open all streams, then start them; `started` grows by the sensors that must be stopped."""
    sensors = {id(sensor): sensor for sensor, _ in choices}
    try:
        for key, sensor in sensors.items():
            sensor.open([profile for owner, profile in choices if id(owner) == key])
            started.append(sensor)
        for sensor in started:
            sensor.start(streams.receive)
    except RuntimeError as error:
        raise DataError(
            f"cannot start the streams of {device_name(device)}: {error}; close other programs that use it, "
            "or plug it in again"
        ) from error


def _stop(sensor: Any) -> None:
    """Stop a sensor; one whose camera was unplugged cannot be stopped, which is ignored."""
    for end in (sensor.stop, sensor.close):
        try:
            end()
        except RuntimeError:
            continue


def depth_unit_m(sensor: Any) -> float:
    """Metres per unit of the sensor's depth; millimetres where it does not say."""
    import pyrealsense2 as rs

    if not sensor.supports(rs.option.depth_units):
        return 0.001
    return as_meant(sensor.get_option(rs.option.depth_units))


def device_name(device: Any) -> str:
    """Name and serial number of a device."""
    import pyrealsense2 as rs

    keys = (rs.camera_info.name, rs.camera_info.serial_number)
    return " ".join(device.get_info(key) for key in keys if device.supports(key)) or "RealSense device"

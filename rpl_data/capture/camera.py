"""Find the connected RealSense camera, and choose which of its streams to record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rpl_data.capture.device import COLOR_FORMATS, device_name
from rpl_data.types import DataError


def connected_camera(serial: str | None = None) -> Any:
    """Return the connected RealSense camera, or the one with this serial number if there are several.

    Raises:
        DataError: there is none, or one must be chosen.
    """
    import pyrealsense2 as rs

    found = {device.get_info(rs.camera_info.serial_number): device for device in rs.context().query_devices()}
    if not found:
        raise DataError(
            "no RealSense camera is connected; plug it into a USB 3 port (on Linux its udev rules must be "
            "installed, in a container the USB bus passed through)"
        )
    if serial is not None and serial not in found:
        raise DataError(f"no camera has serial number {serial}; connected: {', '.join(found)}")
    if serial is None and len(found) > 1:
        raise DataError(f"{len(found)} cameras are connected; choose one with --serial: {', '.join(found)}")
    return found[serial] if serial is not None else next(iter(found.values()))


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

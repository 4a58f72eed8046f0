"""A RealSense camera made of software: it sends what a test gives it, to a recorder or to the capture."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyrealsense2 as rs

WIDTH, HEIGHT = 64, 48
FOCAL_PX = 60.0


class SoftwareCamera:
    """Depth and colour of 64 x 48 pixels; `apart_m` between the two cameras.

    Keep it as long as anything of librealsense lives: it owns the pixels of the frames it sent.
    """

    def __init__(
        self,
        *,
        apart_m: float = 0.0,
        unit_m: float = 0.001,
        model: Any = rs.distortion.none,
        coeffs: tuple[float, ...] = (0, 0, 0, 0, 0),
    ) -> None:
        self.unit_m = unit_m
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, "Software Camera")
        self.device.register_info(rs.camera_info.serial_number, "0815")
        self.sensors = {kind: self.device.add_sensor(kind.title()) for kind in ("depth", "color")}
        self.profiles = {
            kind: sensor.add_video_stream(_stream(kind, number, model, coeffs))
            for number, (kind, sensor) in enumerate(self.sensors.items())
        }
        self.sensors["depth"].add_read_only_option(rs.option.depth_units, unit_m)
        apart = rs.extrinsics()
        apart.rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]
        apart.translation = [apart_m, 0, 0]
        self.profiles["depth"].register_extrinsics_to(self.profiles["color"], apart)
        self._pixels: list[np.ndarray] = []

    def send(self, kind: str, number: int, time_ms: float, pixels: np.ndarray) -> None:
        """One image of one sensor."""
        pixels = np.ascontiguousarray(pixels)
        self._pixels.append(pixels)
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp = pixels, 2 if kind == "depth" else 3
        frame.stride = WIDTH * frame.bpp
        frame.timestamp, frame.domain = time_ms, rs.timestamp_domain.hardware_clock
        frame.frame_number = number
        frame.profile = self.profiles[kind].as_video_stream_profile()
        if kind == "depth":
            frame.depth_units = self.unit_m
        self.sensors[kind].on_video_frame(frame)


def _stream(kind: str, number: int, model: Any, coeffs: tuple[float, ...]) -> Any:
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy = WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX
    lens.ppx, lens.ppy, lens.model, lens.coeffs = 31.5, 23.5, model, list(coeffs)
    stream = rs.video_stream()
    stream.type, stream.fmt = getattr(rs.stream, kind), rs.format.z16 if kind == "depth" else rs.format.rgb8
    stream.index, stream.uid, stream.fps, stream.bpp = 0, number, 30, 2 if kind == "depth" else 3
    stream.width, stream.height, stream.intrinsics = WIDTH, HEIGHT, lens
    return stream


def depth_pixels(number: int) -> np.ndarray:
    """Noise that no two frames share, 0.7 to 0.9 m in millimetres, and a hole."""
    pixels = np.random.default_rng(number).integers(700, 900, (HEIGHT, WIDTH)).astype(np.uint16)
    pixels[10:12, 20:22] = 0
    return pixels


def color_pixels(number: int) -> np.ndarray:
    """Red says which frame it is; left half green, right half blue."""
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[..., 0] = 5 * number
    pixels[:, : WIDTH // 2, 1] = pixels[:, WIDTH // 2 :, 2] = 200
    return pixels


def send_pairs(
    camera: SoftwareCamera,
    count: int,
    *,
    depth: Callable[[int], np.ndarray] = depth_pixels,
    pause_s: float = 0.0,
) -> None:
    """Pairs at 30 Hz by their timestamps, depth 2 ms behind colour."""
    for number in range(count):
        time_ms = 1000 + number * 100 / 3
        camera.send("color", number + 1, time_ms, color_pixels(number))
        camera.send("depth", number + 1, time_ms + 2, depth(number))
        time.sleep(pause_s)


def record(
    path: Path,
    count: int,
    *,
    streams: tuple[str, ...] = ("depth", "color"),
    depth: Callable[[int], np.ndarray] = depth_pixels,
    **camera: Any,
) -> Path:
    """A recording of `count` pairs; a .db3 with today's librealsense, a .bag with 2.56 and before."""
    source = SoftwareCamera(**camera)
    recorder = rs.recorder(str(path), source.device)
    frames = rs.frame_queue(10)
    sensors = [s for s in recorder.query_sensors() if s.get_info(rs.camera_info.name).lower() in streams]
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(frames)
    send_pairs(source, count, depth=depth, pause_s=0.003)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del sensor, sensors, recorder  # the file is closed with the last of them
    return path

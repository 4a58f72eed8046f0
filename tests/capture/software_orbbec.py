"""`pyorbbecsdk` 2 made of software, as far as the capture uses it.

Depth has another size than colour until it went through `AlignFilter`, which as in the package leaves out the
lens distortion of colour unless `TargetDistortion` is set: depth then lies beside colour.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
from software_camera import HEIGHT, WIDTH, color_pixels, depth_pixels

NAMES = (
    "Context.query_devices", "DeviceList.get_count", "DeviceList.get_device_serial_number_by_index",
    "DeviceList.get_device_by_serial_number", "Device.get_device_info", "Device.is_property_supported",
    "Device.get_bool_property", "Device.set_bool_property", "Device.get_int_property",
    "Device.set_int_property", "Device.get_int_property_range", "DeviceInfo.get_name",
    "DeviceInfo.get_serial_number", "Pipeline.get_stream_profile_list", "Pipeline.enable_frame_sync",
    "Pipeline.start", "Pipeline.stop", "Pipeline.wait_for_frames", "Config.enable_stream",
    "Config.set_frame_aggregate_output_mode", "OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE",
    "AlignFilter.set_config_value", "AlignFilter.process", "OBStreamType.COLOR_STREAM",
    "OBSensorType.COLOR_SENSOR", "OBSensorType.DEPTH_SENSOR", "StreamProfileList.__len__",
    "StreamProfileList.__getitem__", "StreamProfileList.get_default_video_stream_profile",
    "StreamProfile.as_video_stream_profile", "StreamProfile.get_format", "VideoStreamProfile.get_width",
    "VideoStreamProfile.get_height", "VideoStreamProfile.get_fps", "VideoStreamProfile.get_intrinsic",
    "VideoStreamProfile.get_distortion", "OBCameraIntrinsic.fx", "OBCameraIntrinsic.cy",
    "OBCameraDistortion.k6", "OBCameraDistortion.p2", "OBCameraDistortion.model",
    "OBCameraDistortionModel.BROWN_CONRADY", "OBCameraDistortionModel.BROWN_CONRADY_K6", "OBError",
    "OBFormat.RGB", "OBFormat.BGR", "OBFormat.YUYV", "OBFormat.UYVY", "OBFormat.MJPG", "OBFormat.Y16",
    "Frame.as_frame_set", "FrameSet.get_color_frame", "FrameSet.get_depth_frame", "Frame.get_data",
    "Frame.get_format", "Frame.get_index", "Frame.get_timestamp_us", "VideoFrame.get_width",
    "VideoFrame.get_height", "DepthFrame.get_depth_scale", "OBPermissionType.PERMISSION_READ_WRITE",
    "OBPropertyID.OB_PROP_COLOR_AUTO_EXPOSURE_BOOL", "OBPropertyID.OB_PROP_COLOR_EXPOSURE_INT",
    "OBPropertyID.OB_PROP_COLOR_GAIN_INT", "OBPropertyID.OB_PROP_COLOR_AUTO_WHITE_BALANCE_BOOL",
    "OBPropertyID.OB_PROP_COLOR_WHITE_BALANCE_INT",
)  # fmt: skip
"""What of the package is imitated; a test looks for each name where the package is installed."""

UNIT_M = 0.0005
LENS = SimpleNamespace(fx=60.0, fy=61.0, cx=31.25, cy=23.75)
K6 = dict(k1=0.5, k2=-2.5, p1=0.001, p2=0.002, k3=1.5, k4=0.25, k5=-2.25, k6=1.25)
RANGES = {
    "OB_PROP_COLOR_EXPOSURE_INT": (1, 10000),
    "OB_PROP_COLOR_GAIN_INT": (0, 128),
    "OB_PROP_COLOR_WHITE_BALANCE_INT": (2800, 6500),
}


class OBError(Exception):
    pass


class Format(Enum):
    RGB, BGR, YUYV, UYVY, MJPG, Y16, H264 = range(7)


class Profile:
    def __init__(self, size: tuple[int, int], form: str, fps: int, model: str) -> None:
        self.size, self.form, self.fps, self.model = size, Format[form], fps, model

    def as_video_stream_profile(self) -> Profile:
        return self

    def get_width(self) -> int:
        return self.size[0]

    def get_height(self) -> int:
        return self.size[1]

    def get_fps(self) -> int:
        return self.fps

    def get_format(self) -> Format:
        return self.form

    def get_intrinsic(self) -> Any:
        return LENS

    def get_distortion(self) -> Any:
        return SimpleNamespace(**K6, model=SimpleNamespace(name=self.model))


class Profiles(list[Profile]):
    def get_default_video_stream_profile(self) -> Profile:
        return self[0]


class Frame:
    def __init__(self, number: int, form: Format, data: np.ndarray, size: tuple[int, int]) -> None:
        self.number, self.form, self.data, self.size = number, form, data, size

    def get_index(self) -> int:
        return self.number

    def get_timestamp_us(self) -> int:
        return round(1e6 * (1 + self.number / 30))

    def get_format(self) -> Format:
        return self.form

    def get_data(self) -> np.ndarray:
        return self.data.view(np.uint8).ravel()

    def get_width(self) -> int:
        return self.size[0]

    def get_height(self) -> int:
        return self.size[1]

    def get_depth_scale(self) -> float:
        return float(np.float32(UNIT_M * 1000))


class Frames:
    def __init__(self, color: Frame | None, depth: Frame | None) -> None:
        self.color, self.depth = color, depth

    def as_frame_set(self) -> Frames:
        return self

    def get_color_frame(self) -> Frame | None:
        return self.color

    def get_depth_frame(self) -> Frame | None:
        return self.depth


class SoftwareOrbbec:
    """An Orbbec camera, as a module `pyorbbecsdk`; it gives colour in one format."""

    def __init__(
        self,
        *,
        serials: tuple[str, ...] = ("CP0001",),
        until: int = 10**9,
        lost: Callable[[int], bool] = lambda number: False,
        damaged: tuple[int, ...] = (),
        form: str = "RGB",
        model: str = "BROWN_CONRADY_K6",
    ) -> None:
        self.serials, self.until, self.lost = serials, until, lost
        self.damaged = damaged
        self.form, self.number, self.calls, self.running = form, 0, 0, False
        self.enabled: list[Profile] = []
        self.colors = Profiles(
            [Profile((128, 96), form, 15, model)]
            + [Profile((WIDTH, HEIGHT), each, 30, model) for each in ("H264", form)]
        )
        self.depths = Profiles([Profile((32, 24), "Y16", 30, model), Profile((320, 240), "Y16", 5, model)])
        self.values: dict[str, Any] = {name: low for name, (low, _) in RANGES.items()}
        self.values |= {f"OB_PROP_COLOR_AUTO_{name}_BOOL": True for name in ("EXPOSURE", "WHITE_BALANCE")}
        self.module = self._module()

    def _module(self) -> ModuleType:
        ob: Any = ModuleType("pyorbbecsdk")
        ob.OBError = OBError
        ob.OBSensorType = Enum("OBSensorType", "COLOR_SENSOR DEPTH_SENSOR")
        ob.OBStreamType = Enum("OBStreamType", "COLOR_STREAM DEPTH_STREAM")
        ob.OBFrameAggregateOutputMode = Enum("OBFrameAggregateOutputMode", "FULL_FRAME_REQUIRE DISABLE")
        ob.OBPermissionType = Enum("OBPermissionType", "PERMISSION_READ PERMISSION_READ_WRITE")
        ob.OBPropertyID = Enum("OBPropertyID", list(self.values))
        ob.Context = lambda: SimpleNamespace(query_devices=self._devices)
        ob.Config = lambda: SimpleNamespace(
            enable_stream=self.enabled.append, set_frame_aggregate_output_mode=lambda mode: None
        )
        ob.Pipeline = lambda device: SimpleNamespace(
            get_stream_profile_list=lambda s: self.colors if s.name == "COLOR_SENSOR" else self.depths,
            enable_frame_sync=lambda: None,
            start=lambda config: setattr(self, "running", True),
            stop=self._stop,
            wait_for_frames=self._wait,
        )
        ob.AlignFilter = self._align
        self.device = self._device()
        return ob

    def _devices(self) -> Any:
        return SimpleNamespace(
            get_count=lambda: len(self.serials),
            get_device_serial_number_by_index=lambda number: self.serials[number],
            get_device_by_serial_number=lambda serial: self.device,
        )

    def _device(self) -> Any:
        return SimpleNamespace(
            get_device_info=lambda: SimpleNamespace(
                get_name=lambda: "Gemini", get_serial_number=lambda: self.serials[0]
            ),
            is_property_supported=lambda key, permission: key.name in self.values,
            get_bool_property=lambda key: self.values[key.name],
            get_int_property=lambda key: self.values[key.name],
            get_int_property_range=lambda key: SimpleNamespace(
                min=RANGES[key.name][0], max=RANGES[key.name][1], step=1
            ),
            set_bool_property=self._set,
            set_int_property=self._set,
        )

    def _set(self, key: Any, value: int) -> None:
        low, high = RANGES.get(key.name, (0, 1))
        if not low <= value <= high:
            raise OBError(f"{key.name} cannot be {value}")
        self.values[key.name] = value

    def _stop(self) -> None:
        self.running = False
        if self.number >= self.until:
            raise OBError("device is disconnected")

    def _wait(self, milliseconds: int) -> Frames | None:
        time.sleep(0.002)
        while self.lost(self.number):
            self.number += 1
        if self.number >= self.until:
            raise OBError("device is disconnected")
        self.calls += 1
        if self.calls % 7 == 0:  # as when the computer is busy
            return None
        number, self.number = self.number, self.number + 1
        raw = Frame(number, Format.Y16, np.zeros((24, 32), np.uint16), (32, 24))
        color = encoded(color_pixels(number % 50), self.form)[: 100 if number in self.damaged else None]
        return Frames(Frame(number, Format[self.form], color, (WIDTH, HEIGHT)), raw)

    def _align(self, *, align_to_stream: Any) -> Any:
        config = {"TargetDistortion": 0.0}

        def process(frames: Frames) -> Frames:
            assert frames.depth is not None
            assert align_to_stream.name == "COLOR_STREAM"
            there = depth_pixels(frames.depth.number)
            depth = there if config["TargetDistortion"] else np.roll(there, 5, axis=1)
            return Frames(frames.color, Frame(frames.depth.number, Format.Y16, depth, (WIDTH, HEIGHT)))

        return SimpleNamespace(set_config_value=config.__setitem__, process=process)


def encoded(rgb: np.ndarray, form: str) -> np.ndarray:
    """Pixels as the camera sends them."""
    if form == "MJPG":
        return np.asarray(cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1])
    if form == "BGR":
        return np.ascontiguousarray(rgb[..., ::-1])
    codes = {"YUYV": cv2.COLOR_RGB2YUV_YUY2, "UYVY": cv2.COLOR_RGB2YUV_UYVY}
    return np.asarray(cv2.cvtColor(rgb, codes[form])) if form in codes else rgb

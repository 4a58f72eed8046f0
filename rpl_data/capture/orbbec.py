"""Orbbec cameras (Gemini, Femto, Astra), by the second version of their package `pyorbbecsdk`.

Depth is moved onto the pixels of the colour image, with its lens distortion, by the package's own
`AlignFilter`. Tested against a software device only.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from rpl_data.capture.camera import (
    POLL_S,
    USB_HINT,
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
from rpl_data.capture.lens import as_meant, opencv_camera
from rpl_data.types import DataError, Intrinsics

INSTALL = "install it by: pip install --no-deps pyorbbecsdk2"
"""Without its requirements: they name versions of Open3D and PyAV that exclude ours, and it needs none."""

USUAL_SIZE_PX = (1280, 720)
FORMATS = ("RGB", "BGR", "YUYV", "UYVY", "MJPG")
"""Formats of colour, in order of preference."""

TERMS = {"NONE": 0, "BROWN_CONRADY": 5, "BROWN_CONRADY_K6": 8}
"""Lens models that are OpenCV's (OrbbecSDK_v2, AlignImpl.cpp, addDistortion), by how many terms they use."""


@contextmanager
def open_orbbec(wanted: Wanted) -> Iterator[OrbbecStreams]:
    """Open the connected Orbbec camera while the block lasts.

    Raises:
        DataError: pyorbbecsdk is not installed, there is no camera, or it has no such streams.
    """
    ob = needed("pyorbbecsdk", cameras="Orbbec cameras", install=INSTALL)
    context = ob.Context()
    devices = context.query_devices()
    connected = [devices.get_device_serial_number_by_index(number) for number in range(devices.get_count())]
    serial = chosen_serial(
        connected,
        wanted.serial,
        cameras="Orbbec camera",
        hint=USB_HINT,
    )
    device = devices.get_device_by_serial_number(serial)
    pipeline = ob.Pipeline(device)
    streams = _started(ob, device, pipeline, wanted)
    try:
        first_of(streams.poll, streams.name)  # which tells the unit of depth
        yield streams
    finally:
        with suppress(RuntimeError, ob.OBError):  # one that was unplugged cannot be stopped
            pipeline.stop()


def _started(ob: Any, device: Any, pipeline: Any, wanted: Wanted) -> OrbbecStreams:
    """Choose the streams and start them."""
    info = device.get_device_info()
    name = f"{info.get_name()} {info.get_serial_number()}"
    color, depth = _profiles(ob, pipeline, wanted, name)
    config = ob.Config()
    config.enable_stream(color)
    config.enable_stream(depth)
    config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
    intrinsics = _intrinsics_of(color, name)
    try:
        pipeline.enable_frame_sync()
        pipeline.start(config)
    except (RuntimeError, ob.OBError) as error:
        raise DataError(
            f"cannot start the streams of {name}: {error}; close other programs that use it, or plug it in "
            "again"
        ) from error
    align = ob.AlignFilter(align_to_stream=ob.OBStreamType.COLOR_STREAM)
    align.set_config_value("TargetDistortion", 1)  # else depth lies where colour would be without distortion
    return OrbbecStreams(ob, pipeline, align, OrbbecControls(ob, device), name, intrinsics, wanted.rate_hz)


def _profiles(ob: Any, pipeline: Any, wanted: Wanted, name: str) -> tuple[Any, Any]:
    """The profiles of colour and of depth; depth has the maker's usual size if it comes at this rate.

    Raises:
        DataError: there are none; the message lists what there is.
    """
    size = wanted.size_px or USUAL_SIZE_PX
    offered = [p for p in _listed(ob, pipeline, "COLOR_SENSOR") if p.get_format().name in FORMATS]
    colors = [p for p in offered if _size(p) == size and p.get_fps() == wanted.rate_hz]
    depths = [p for p in _listed(ob, pipeline, "DEPTH_SENSOR") if p.get_fps() == wanted.rate_hz]
    depths = [p for p in depths if p.get_format().name in ("Y16", "Z16")]
    if not colors or not depths:
        known = sorted({(*_size(p), p.get_fps()) for p in offered})
        words = ", ".join(f"{width}x{height} at {fps}" for width, height, fps in known)
        raise DataError(
            f"{name} does not give {size[0]}x{size[1]} colour with depth at {wanted.rate_hz} Hz; it has "
            f"{words or 'no colour at all'}; choose with --width, --height and --fps (a USB 2 port leaves "
            "little)"
        )
    usual = _size(
        pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR).get_default_video_stream_profile()
    )
    color = min(colors, key=lambda p: FORMATS.index(p.get_format().name))
    return color, max(depths, key=lambda p: (_size(p) == usual, _size(p)))


def _listed(ob: Any, pipeline: Any, sensor: str) -> list[Any]:
    found = pipeline.get_stream_profile_list(getattr(ob.OBSensorType, sensor))
    return [found[number].as_video_stream_profile() for number in range(len(found))]


def _size(profile: Any) -> tuple[int, int]:
    return profile.get_width(), profile.get_height()


def _intrinsics_of(profile: Any, name: str) -> Intrinsics:
    """The camera of a colour profile.

    Raises:
        DataError: the lens model is not OpenCV's.
    """
    lens, bent = profile.get_intrinsic(), profile.get_distortion()
    coefficients = [bent.k1, bent.k2, bent.p1, bent.p2, bent.k3, bent.k4, bent.k5, bent.k6]
    if any(coefficients) and bent.model.name not in TERMS:
        raise DataError(
            f"{name} states its lens in the model {bent.model.name}, which a recording cannot hold; choose "
            "another --width and --height, or record with Orbbec's own viewer"
        )
    terms = coefficients[: TERMS.get(bent.model.name, 0)]
    return opencv_camera((lens.fx, lens.fy, lens.cx, lens.cy), _size(profile), terms)


@dataclass
class OrbbecStreams:
    """An open camera (`CameraStreams`).

    Attributes:
        ob: the module pyorbbecsdk.
        pipeline: the running pipeline.
        align: moves depth onto colour.
        controls: those of the colour camera.
        name: name of the camera.
        intrinsics: of its colour images.
        rate_hz: images per second.
        metres_per_unit: of depth, as its last image said.
        counts: counts of frames.
    """

    ob: Any
    pipeline: Any
    align: Any
    controls: OrbbecControls
    name: str
    intrinsics: Intrinsics
    rate_hz: int
    metres_per_unit: float = 0.001
    counts: StreamCounts = field(default_factory=StreamCounts)

    @property
    def camera(self) -> StreamCamera:
        """What the device reports about itself."""
        return StreamCamera(self.intrinsics, self.metres_per_unit, self.name)

    def begin(self) -> None:
        """Count from zero again."""
        self.counts.clear()

    def shots(self, *, patience_s: float) -> Iterator[Shot]:
        """Yield shots until the camera is unplugged or silent."""
        return until_unplugged(self.poll, patience_s=patience_s)

    def lock_exposure(self, mean_color: MeanColor) -> tuple[str, ...]:
        """Hold exposure and white balance as they are now."""
        return lock(self.controls, mean_color, rate_hz=self.rate_hz)

    def poll(self) -> Shot | None:
        """The next pair; None when none has come for a moment."""
        try:
            frames = self.pipeline.wait_for_frames(int(POLL_S * 1000))
            if frames is None:
                return None
            if frames.get_color_frame() is None or frames.get_depth_frame() is None:
                self.counts.color_alone += frames.get_color_frame() is not None
                return None
            moved = self.align.process(frames)
            aligned = None if moved is None else moved.as_frame_set()
        except (RuntimeError, self.ob.OBError) as error:
            raise UnpluggedError from error
        color, depth = frames.get_color_frame(), aligned and aligned.get_depth_frame()
        rgb = _rgb(color)
        if rgb is None or depth is None:  # a damaged image, or depth that could not be moved onto colour
            self.counts.color_alone += 1
            return None
        self.counts.pairs += 1
        self.metres_per_unit = as_meant(depth.get_depth_scale() / 1000)
        units = np.frombuffer(depth.get_data(), np.uint16).reshape(depth.get_height(), depth.get_width())
        return Shot(color.get_index(), color.get_timestamp_us() / 1e6, rgb, units.copy())


def _rgb(frame: Any) -> UInt8[np.ndarray, "height width 3"] | None:
    """A colour image as RGB, whatever format it came in; None when it came damaged."""
    name, data = frame.get_format().name, np.array(frame.get_data(), np.uint8)
    if name == "MJPG":
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
        return None if decoded is None else np.ascontiguousarray(decoded[..., ::-1])
    pixels = data.reshape(frame.get_height(), frame.get_width(), -1)
    codes = {"BGR": cv2.COLOR_BGR2RGB, "YUYV": cv2.COLOR_YUV2RGB_YUY2, "UYVY": cv2.COLOR_YUV2RGB_UYVY}
    return pixels if name == "RGB" else np.asarray(cv2.cvtColor(pixels, codes[name]), np.uint8)


@dataclass(frozen=True)
class OrbbecControls:
    """The controls of the colour camera (`Controls`)."""

    ob: Any
    device: Any

    @property
    def refusals(self) -> tuple[type[Exception], ...]:
        """What the package raises when the camera refuses a value."""
        return (RuntimeError, self.ob.OBError)

    def supports(self, key: Key) -> bool:
        """Whether the camera has this control."""
        allowed = self.ob.OBPermissionType.PERMISSION_READ_WRITE
        return bool(self.device.is_property_supported(self._property(key), allowed))

    def get(self, key: Key) -> float:
        """The value of a control."""
        if key.startswith("auto_"):
            return float(self.device.get_bool_property(self._property(key)))
        return float(self.device.get_int_property(self._property(key)))

    def set(self, key: Key, value: float) -> None:
        """Set a control."""
        if key.startswith("auto_"):
            self.device.set_bool_property(self._property(key), bool(value))
        else:
            self.device.set_int_property(self._property(key), round(value))

    def range(self, key: Key) -> Range:
        """The values that a control allows."""
        found = self.device.get_int_property_range(self._property(key))
        return Range(float(found.min), float(found.max), float(found.step))

    def _property(self, key: Key) -> Any:
        kind = "BOOL" if key.startswith("auto_") else "INT"
        return getattr(self.ob.OBPropertyID, f"OB_PROP_COLOR_{key.upper()}_{kind}")

"""Decode the messages that a recording is made of: images, raw, compressed and of videos, with their stamps.

Sources: sensor_msgs/Image and image_encodings.hpp (ros2/common_interfaces), cv_bridge for the byte orders,
compressed_image_transport and compressed_depth_image_transport (ros-perception/image_transport_plugins).
"""

from __future__ import annotations

import functools
import struct
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from rpl_data.files import FAULTS
from rpl_data.formats.containers.rvl import unpack_rvl
from rpl_data.formats.recordings.ros.bags import Message
from rpl_data.formats.recordings.ros.video import (
    VIDEO_TYPES,
    VideoPacket,
    is_video_format,
    size_of_video,
    video_packet,
)
from rpl_data.types import DepthImage

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_LARGEST_SIDE_PX = 16384
_MOST_RVL_PIXELS = 2**26
"""8192 x 8192: a few bytes of RVL may stand for any number of empty pixels."""
_DEPTH_HEADER_BYTES = 12
"""compressedDepth puts before its PNG or RVL: a number for the format, then A and B of its float depth."""

_COLORS = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8uc3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8uc4": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8uc1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUYV),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
}
"""Bytes per pixel, and OpenCV's conversion to RGB; OpenCV names a Bayer pattern by its second row."""

GREY = ("mono8", "8uc1")
_DEPTHS = {"16uc1": "u2", "mono16": "u2", "32fc1": "f4"}


def is_color_encoding(encoding: str) -> bool:
    """Whether images of this encoding (or compressed images of this format) are seen, not measured."""
    name = base_encoding(encoding)
    return name in _COLORS or name in ("jpeg", "jpg", "png") or is_video_format(name)


def is_depth_encoding(encoding: str) -> bool:
    """Whether images of this encoding (or compressed images of this format) can be depth."""
    return base_encoding(encoding) in _DEPTHS or "compresseddepth" in encoding.lower()


def base_encoding(encoding: str) -> str:
    """The encoding before compression, such as 16uc1 of "16UC1; compressedDepth png"."""
    return encoding.split(";")[0].strip().lower()


@functools.cache
def _store(is_ros1: bool) -> Any:
    """The definitions of the messages; those that a bag brings with it are never compiled."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    extrinsics = "float64[9] rotation\nfloat64[3] translation"
    added = {
        "realsense2_camera_msgs/msg/Extrinsics": extrinsics,
        "realsense2_camera/msg/Extrinsics": f"std_msgs/Header header\n{extrinsics}",
    }
    added |= {} if is_ros1 else VIDEO_TYPES
    if is_ros1:
        transforms = "geometry_msgs/TransformStamped[] transforms"
        added |= {"tf2_msgs/msg/TFMessage": transforms, "tf/msg/tfMessage": transforms}
    for name, text in added.items():
        store.register(get_types_from_msg(text, name))
    return store


def decoded(message: Message) -> Any:
    """The fields of a message, a packet where it is one of a video, None when it is damaged.

    Those of ROS 1's CameraInfo are called D, K, R, P, those of ROS 2's d, k, r, p.
    """
    from rosbags.serde import SerdeError

    store = _store(message.is_ros1)
    unpack = store.deserialize_ros1 if message.is_ros1 else store.deserialize_cdr
    try:
        fields = unpack(message.raw, message.type)
        return video_packet(fields) if message.type in VIDEO_TYPES else fields
    except (*FAULTS, struct.error, AssertionError, SerdeError):
        return None


def stamp_ns(message: Message) -> int:
    """Time in the header of a message, in nanoseconds: when the camera made it; 0 when there is none."""
    if len(message.raw) < 12:
        return 0
    if message.is_ros1:
        _, seconds, nanoseconds = struct.unpack_from("<III", message.raw)
    else:
        order = "<" if message.raw[1] & 1 else ">"
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", message.raw, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def size_of(image: Any) -> tuple[int, int] | None:
    """Width and height of an image message, raw or compressed; None when it cannot be decoded."""
    if hasattr(image, "encoding"):
        return int(image.width), int(image.height)
    if isinstance(image, VideoPacket):
        return size_of_video(image)
    content = image.data.tobytes()
    if _is_rvl(str(image.format)):
        return _rvl_size(content)
    packed = _image_file(content)
    pixels = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED) if packed else None
    return None if pixels is None else (pixels.shape[1], pixels.shape[0])


def color_of(image: Any) -> UInt8[np.ndarray, "height width 3"] | bytes | None:
    """The RGB pixels of an image message, or the JPEG or PNG file it holds; None when it is damaged."""
    if not hasattr(image, "encoding"):
        return _compressed_color(str(image.format), image.data.tobytes())
    channels, conversion = _COLORS.get(base_encoding(image.encoding), (0, None))
    pixels = _rows(image, np.dtype(np.uint8), channels) if channels else None
    if pixels is None:
        return None
    try:
        converted = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error:  # such as an odd width in YUV
        return None
    return np.asarray(converted, np.uint8)


def _compressed_color(format: str, content: bytes) -> UInt8[np.ndarray, "height width 3"] | bytes | None:
    """A file as it is, unless the program that compressed it took red for blue.

    "rgb8; jpeg compressed rgb8" says that the pixels were given to OpenCV in the order RGB, which it takes
    for BGR: the image in the file is swapped. Its subscriber turns such images back, and so do we.
    """
    if not content.startswith((b"\xff\xd8", b"\x89PNG")):
        return None
    if "compressed rgb" not in format.lower():
        return content
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)  # BGR of a swapped image
    return None if pixels is None else np.asarray(pixels, np.uint8)


def depth_of(image: Any) -> tuple[np.ndarray, bool] | None:
    """The values of a depth message, and whether they are whole units (else metres, NaN = none).

    None when it is damaged.
    """
    if not hasattr(image, "encoding"):
        return _compressed_depth(str(image.format), image.data.tobytes())
    kind = _DEPTHS.get(base_encoding(image.encoding))
    values = None if kind is None else _rows(image, np.dtype(("<", ">")[bool(image.is_bigendian)] + kind), 1)
    return None if values is None or kind is None else (values.astype(kind), kind == "u2")


def _compressed_depth(format: str, content: bytes) -> tuple[np.ndarray, bool] | None:
    """Depth as PNG or RVL. Floats are stored as inverse depth q: z = A / (q - B), q = 0 for none."""
    units = _rvl_image(content) if _is_rvl(format) else _png_image(content)
    if units is None:
        return None
    if base_encoding(format) != "32fc1":
        return units, True
    if content[:_DEPTH_HEADER_BYTES].startswith(b"\x89PNG"):
        return None
    a, b = struct.unpack_from("<ff", content, 4)
    depth_m: DepthImage = np.full(units.shape, np.nan, np.float32)
    some = units > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m[some] = np.float32(a) / (units[some].astype(np.float32) - np.float32(b))
    return depth_m, False


def _png_image(content: bytes) -> UInt16[np.ndarray, "height width"] | None:
    """The whole numbers of a 16-bit PNG; None for anything else."""
    packed = _image_file(content)
    if packed is None or not packed.startswith(b"\x89PNG"):
        return None
    units = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED)
    return units if units is not None and units.dtype == np.uint16 and units.ndim == 2 else None


def _is_rvl(format: str) -> bool:
    return "compresseddepth rvl" in format.lower()


def _rvl_size(content: bytes) -> tuple[int, int] | None:
    """Width and height, which stand between the header of compressedDepth and its RVL; None for odd ones."""
    if len(content) < _DEPTH_HEADER_BYTES + 8:
        return None
    width, height = struct.unpack_from("<II", content, _DEPTH_HEADER_BYTES)
    bearable = 0 < width <= _LARGEST_SIDE_PX and 0 < height <= _LARGEST_SIDE_PX
    return (width, height) if bearable and width * height <= _MOST_RVL_PIXELS else None


def _rvl_image(content: bytes) -> UInt16[np.ndarray, "height width"] | None:
    size = _rvl_size(content)
    if size is None:
        return None
    units = unpack_rvl(content[_DEPTH_HEADER_BYTES + 8 :], size[0] * size[1])
    return None if units is None else units.reshape(size[1], size[0])


def _image_file(content: bytes) -> bytes | None:
    """The JPEG or PNG in a compressed message: all of it, or what follows the header of compressedDepth."""
    for start in (0, _DEPTH_HEADER_BYTES):
        if content[start : start + 4] == b"\x89PNG" or content[start : start + 2] == b"\xff\xd8":
            return content[start:] if _is_of_bearable_size(content[start:]) else None
    return None


def _is_of_bearable_size(packed: bytes) -> bool:
    """Whether a PNG says that its sides are of reasonable length; JPEGs end at 65535 pixels anyway."""
    if not packed.startswith(b"\x89PNG"):
        return True
    return max(int.from_bytes(packed[16:20]), int.from_bytes(packed[20:24])) <= _LARGEST_SIDE_PX


def _rows(image: Any, kind: np.dtype[Any], channels: int) -> np.ndarray | None:
    """The pixels of a raw image, whose rows may be longer than its width; None where there are too few."""
    width, height, step = int(image.width), int(image.height), int(image.step)
    row_bytes = width * channels * kind.itemsize
    if not (0 < width <= _LARGEST_SIDE_PX and 0 < height <= _LARGEST_SIDE_PX):
        return None
    step = step or row_bytes
    if step < row_bytes or len(image.data) < step * (height - 1) + row_bytes:
        return None
    data = np.zeros(step * height, np.uint8)
    data[: min(len(image.data), step * height)] = image.data[: step * height]
    rows = np.ascontiguousarray(data.reshape(height, step)[:, :row_bytes]).view(kind)
    return rows.reshape(height, width) if channels == 1 else rows.reshape(height, width, channels)

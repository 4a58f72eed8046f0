"""Colour that ROS 2 sends as video, H.264 or H.265: one packet of it per message, decoded in their order.

foxglove_msgs/CompressedVideo   time, frame, one picture as Annex B, with its parameter sets where it is a key
                                picture, and no B frames (foxglove-sdk, schemas/CompressedVideo)
ffmpeg_image_transport_msgs/FFMPEGPacket   header, and a packet of FFmpeg's encoder, whose name is the first
                                token of `encoding` (ros-misc-utilities/ffmpeg_image_transport_msgs)

A picture is stored as what changed since others: before the first key picture, and after a packet that is
damaged until the next one, nothing can be shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import UInt8

VIDEO_TYPES = {
    "foxglove_msgs/msg/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": (
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data"
    ),
}
"""The definition of each type of message."""

_LARGEST_PIXELS = 2**26


@dataclass(frozen=True)
class Header:
    """What all messages of images have.

    Attributes:
        frame_id: the coordinate frame.
    """

    frame_id: str


@dataclass(frozen=True)
class VideoPacket:
    """A message of a video.

    Attributes:
        format: h264 or hevc; the encoder's own name for anything else, which is not decoded.
        packet: its bytes.
    """

    header: Header
    format: str
    packet: bytes


def video_packet(message: Any) -> VideoPacket:
    """A message of one of the `VIDEO_TYPES`, decoded, as a packet."""
    encoding = str(message.encoding if hasattr(message, "encoding") else message.format)
    frame = message.header.frame_id if hasattr(message, "header") else message.frame_id
    return VideoPacket(Header(str(frame)), _codec(encoding), message.data.tobytes())


def _codec(encoding: str) -> str:
    """FFmpeg's name of the codec: of libx264, h264_nvenc, h265 and the like."""
    name = encoding.split(";")[0].strip().lower()
    if "264" in name:
        return "h264"
    return "hevc" if "265" in name or "hevc" in name else name


def is_video_format(format: str) -> bool:
    """Whether packets of this format can be decoded."""
    return format in ("h264", "hevc")


class VideoDecoder:
    """Decodes the packets of one topic."""

    def __init__(self, format: str) -> None:
        import av

        self._context: Any = av.CodecContext.create(format, "r")
        self._context.options = {"err_detect": "explode"}
        self._context.thread_count = 1
        self._waits_for_key = True

    def size(self) -> tuple[int, int] | None:
        """Width and height; None before the packet that tells them."""
        width, height = int(self._context.width), int(self._context.height)
        return (width, height) if 0 < width * height <= _LARGEST_PIXELS else None

    def push(self, number: int, packet: bytes) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
        """Decode a packet, and yield the pictures that are then known, each with the number of its packet."""
        import av

        content = av.Packet(packet)
        content.pts = number
        yield from self._pictures(content)

    def flush(self) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
        """Yield the pictures that the decoder still holds."""
        yield from self._pictures(None)

    def _pictures(self, content: Any) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
        from av.error import FFmpegError

        try:
            frames = self._context.decode(content)
        except (FFmpegError, ValueError):
            self._waits_for_key = True
            return
        for frame in frames:
            if frame.key_frame:
                self._waits_for_key = False
            if self._waits_for_key or frame.is_corrupt or frame.pts is None or self.size() is None:
                continue
            yield int(frame.pts), frame.to_ndarray(format="rgb24")


def size_of_video(packet: VideoPacket) -> tuple[int, int] | None:
    """Width and height of a picture that stands for itself; None for another one."""
    if not is_video_format(packet.format):
        return None
    decoder = VideoDecoder(packet.format)
    shown = [*decoder.push(0, packet.packet), *decoder.flush()]
    return decoder.size() if shown else None

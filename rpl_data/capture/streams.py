"""Read pairs of colour and depth from any RealSense device (camera, file, software device), depth aligned.

The sensors are read directly: librealsense's pipeline drops the first frames of a file and delivers some
frames twice. Frames are paired by time, then depth is moved onto the colour pixels by librealsense's own
`align`, unless the two streams already share one camera.
"""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from rpl_data.capture.camera import POLL_S, Shot, StreamCamera, StreamCounts
from rpl_data.types import DataError

LIVE_QUEUE = 120
"""Frames of both streams that may wait for their reader: 2 s at 30 Hz."""

LONGEST_WAIT = 30
"""Number of frames that may wait for their partner; an older one stays without."""


class Streams:
    """The open colour and depth streams of a device.

    Attributes:
        camera: what the device reports about itself.
        counts: counts of frames, which grow while `shots` is read.
        settings: exposure, gain and white balance of the last colour image, where the camera reports them.
    """

    def __init__(self, color: Any, depth: Any, camera: StreamCamera, *, lossless: bool) -> None:
        self._color, self._depth = color.as_video_stream_profile(), depth.as_video_stream_profile()
        self.camera = camera
        self.counts = StreamCounts()
        self._lossless = lossless
        self._queue: queue.Queue[Any] = queue.Queue(maxsize=16 if lossless else LIVE_QUEUE)
        self._closed = False
        self.settings: dict[str, float] = {}
        self._aligner = None if self._share_one_camera() else _Aligner()

    # Called by librealsense's threads -----------------------------------------------------------

    def receive(self, frame: Any) -> None:
        """Take a frame; if nothing may be lost, wait for room, otherwise count it as late."""
        frame.keep()
        while not self._closed:
            try:
                self._queue.put(frame, timeout=0.1 if self._lossless else 0)
                return
            except queue.Full:
                if not self._lossless:
                    self.counts.late += frame.profile.stream_type() == self._color.stream_type()
                    return

    def close(self) -> None:
        """Release threads that wait for room."""
        self._closed = True

    # Called by the reader -------------------------------------------------------------------------

    def shots(self, *, patience_s: float, ended: Callable[[], bool] = lambda: False) -> Iterator[Shot]:
        """Yield pairs in the order of time.

        Args:
            patience_s: if nothing comes for this long, the stream has ended.
            ended: called when nothing has come for a moment; True ends the stream.
        """
        for color, depth in self._pairs(patience_s, ended):
            self.counts.pairs += 1
            self.settings = _settings(color)
            yield Shot(
                color.frame_number,
                color.timestamp / 1000,
                _rgb(color),
                _pixels(depth) if self._aligner is None else self._aligner.aligned(color, depth),
            )

    def _pairs(self, patience_s: float, ended: Callable[[], bool]) -> Iterator[tuple[Any, Any]]:
        colors: deque[Any] = deque()
        depths: deque[Any] = deque()
        apart_ms = 500.0 / max(1, self._color.fps())
        for frame in self._frames(patience_s, ended):
            mine = colors if frame.profile.stream_type() == self._color.stream_type() else depths
            mine.append(frame)
            yield from self._matched(colors, depths, apart_ms, waiting=LONGEST_WAIT)
        yield from self._matched(colors, depths, apart_ms, waiting=0)
        self.counts.depth_alone += len(depths)

    def _frames(self, patience_s: float, ended: Callable[[], bool]) -> Iterator[Any]:
        waited_s, end_seen = 0.0, False
        while waited_s < patience_s:
            try:
                frame = self._queue.get(timeout=POLL_S)
            except queue.Empty:
                if end_seen:  # it had ended a moment ago, so nothing is on its way any more
                    return
                waited_s, end_seen = waited_s + POLL_S, ended()
                continue
            waited_s = 0.0
            yield frame

    def _matched(
        self, colors: deque[Any], depths: deque[Any], apart_ms: float, *, waiting: int
    ) -> Iterator[tuple[Any, Any]]:
        """Yield colour images whose nearest depth image is known; at most `waiting` are kept waiting."""
        while colors and (len(colors) > waiting or (depths and depths[-1].timestamp >= colors[0].timestamp)):
            color = colors.popleft()
            nearest = min(depths, key=lambda depth: abs(depth.timestamp - color.timestamp), default=None)
            if nearest is None or abs(nearest.timestamp - color.timestamp) > apart_ms:
                self.counts.color_alone += 1
                continue
            while depths[0] is not nearest:
                depths.popleft()
                self.counts.depth_alone += 1
            depths.popleft()
            yield color, nearest

    def _share_one_camera(self) -> bool:
        color, depth = self._color.get_intrinsics(), self._depth.get_intrinsics()
        same = all(
            getattr(color, key) == getattr(depth, key)
            for key in ("width", "height", "fx", "fy", "ppx", "ppy", "model", "coeffs")
        )
        moved = self._depth.get_extrinsics_to(self._color)
        still = np.allclose(moved.rotation, np.eye(3).ravel()) and np.allclose(moved.translation, 0)
        return same and still


class _Aligner:
    """librealsense's `align`, for a pair that its own syncer did not make."""

    def __init__(self) -> None:
        import pyrealsense2 as rs

        self._pair: list[Any] = []
        self._joined = rs.frame_queue(1)
        self._block = rs.processing_block(self._join)
        self._block.start(self._joined)
        self._align = rs.align(rs.stream.color)

    def _join(self, frame: Any, source: Any) -> None:
        source.frame_ready(source.allocate_composite_frame(self._pair))

    def aligned(self, color: Any, depth: Any) -> UInt16[np.ndarray, "height width"]:
        """Move the depth image onto the pixels of the colour image."""
        self._pair = [depth, color]
        self._block.invoke(depth)
        pair = self._joined.wait_for_frame().as_frameset()
        return _pixels(self._align.process(pair).get_depth_frame())


def _pixels(frame: Any) -> UInt16[np.ndarray, "height width"]:
    return np.array(np.asanyarray(frame.get_data()), dtype=np.uint16)  # a copy: the buffer is reused


def _rgb(frame: Any) -> UInt8[np.ndarray, "height width 3"]:
    """The colour image as RGB, whatever format it was recorded in."""
    name = frame.profile.format().name
    pixels = np.asanyarray(frame.get_data())
    if name == "rgb8":
        return np.array(pixels, dtype=np.uint8)
    codes = {
        "bgr8": cv2.COLOR_BGR2RGB,
        "rgba8": cv2.COLOR_RGBA2RGB,
        "bgra8": cv2.COLOR_BGRA2RGB,
        "yuyv": cv2.COLOR_YUV2RGB_YUY2,
        "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    }
    if name not in codes:
        raise DataError(f"colour is stored as {name}; expected rgb8, {', '.join(codes)}")
    if name in ("yuyv", "uyvy"):
        pixels = pixels.view(np.uint8).reshape(*pixels.shape[:2], 2)
    converted: np.ndarray = cv2.cvtColor(pixels, codes[name])
    return converted


def _settings(frame: Any) -> dict[str, float]:
    """The settings that the camera reports for an image."""
    import pyrealsense2 as rs

    keys = {"exposure": "actual_exposure", "gain": "gain_level", "white_balance": "white_balance"}
    found = {option: getattr(rs.frame_metadata_value, key) for option, key in keys.items()}
    return {
        option: float(frame.get_frame_metadata(key))
        for option, key in found.items()
        if frame.supports_frame_metadata(key)
    }

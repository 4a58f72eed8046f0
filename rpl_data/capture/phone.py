"""An iPhone or iPad with a depth camera, by the USB streaming of the app Record3D and its package `record3d`.

Depth is coarser than colour, through one lens, and is kept at its own size. The lens focuses, so that each
scene has intrinsics of its own: the median of those of its images. The stream has no times; those of arrival
are used. Tested against a software device only.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from contextlib import contextmanager
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
from rpl_data.capture.exposure import MeanColor
from rpl_data.formats.recordings.color_lens import MOST_STRETCHED
from rpl_data.formats.recordings.depth_files import STORED_UNIT_M, stored_units
from rpl_data.formats.recordings.matrices import median_camera
from rpl_data.types import DataError, Intrinsics

INSTALL = "install it by: pip install 'rpl-data[phone]'"
HINT = (
    "connect it by cable, trust this computer on it, and choose USB streaming in Record3D's settings (on "
    "Linux usbmuxd must run)"
)
TRUE_DEPTH = 0
"""`get_device_type` of the camera on the side of the screen; the other one is 1."""

QUEUE = 60
"""Shots that may wait to be written: 2 s at 30 Hz."""

_KEPT: list[Any] = []
"""All streams: a thread of the package goes on using one after it was disconnected, until its next image."""


@contextmanager
def open_phone(wanted: Wanted) -> Iterator[PhoneStreams]:
    """Receive from the connected phone while the block lasts.

    Raises:
        DataError: record3d is not installed, there is no phone, it does not stream, or a size was asked for.
    """
    if wanted.size_px is not None:
        raise DataError("a phone chooses the size of its images itself; leave out --width and --height")
    record3d = needed("record3d", cameras="phones", install=INSTALL)
    devices = {device.udid: device for device in record3d.Record3DStream.get_connected_devices()}
    serial = chosen_serial(list(devices), wanted.serial, cameras="phone", hint=HINT)
    session = record3d.Record3DStream()
    streams = PhoneStreams(session, f"phone {serial}")
    session.on_new_frame, session.on_stream_stopped = streams.receive, streams.end
    _KEPT.append(session)
    if not session.connect(devices[serial]):
        raise DataError(f"the phone {serial} does not stream; open Record3D on it; {HINT}")
    try:
        first_of(streams.poll, streams.name)
        yield streams
    finally:
        session.disconnect()


@dataclass
class PhoneStreams:
    """An open camera (`CameraStreams`).

    Attributes:
        session: the stream of record3d.
        name: name of the phone.
        counts: counts of frames.
        received: number of images that have come.
        lenses: fx, fy, cx, cy of each image since `begin`, in pixels.
        sizes_px: width and height of colour and of depth; None before the first image.
        front: whether the images are from the camera on the side of the screen.
        ended: whether the phone has stopped sending.
    """

    session: Any
    name: str
    counts: StreamCounts = field(default_factory=StreamCounts)
    received: int = 0
    lenses: list[tuple[float, float, float, float]] = field(default_factory=list)
    sizes_px: tuple[tuple[int, int], tuple[int, int]] | None = None
    front: bool = False
    ended: bool = False
    waiting: queue.Queue[tuple[Shot, tuple[float, float, float, float]]] = field(
        default_factory=lambda: queue.Queue(maxsize=QUEUE)
    )

    # Called by the thread of the package --------------------------------------------------------------

    def receive(self) -> None:
        """Take the image that has come; only now do colour, depth and lens surely belong together.

        Nothing may be raised here: the package would end the program.
        """
        self.received += 1
        try:
            self.waiting.put_nowait(self._taken(time.monotonic()))
        except queue.Full:
            self.counts.late += 1
        except (ValueError, TypeError, IndexError):  # an image that came damaged
            self.counts.color_alone += 1

    def end(self) -> None:
        """The phone was unplugged, or stopped streaming."""
        self.ended = True

    def _taken(self, timestamp_s: float) -> tuple[Shot, tuple[float, float, float, float]]:
        color = np.array(self.session.get_rgb_frame(), np.uint8)
        depth_m = np.array(self.session.get_depth_frame(), np.float32)
        levels = np.asarray(self.session.get_confidence_frame())
        units = stored_units(depth_m, 1.0, levels > 0 if levels.size else None)
        lens = self.session.get_intrinsic_mat()
        self.front = self.session.get_device_type() == TRUE_DEPTH
        return Shot(self.received, timestamp_s, color, units), (lens.fx, lens.fy, lens.tx, lens.ty)

    # Called by the reader -----------------------------------------------------------------------------

    @property
    def camera(self) -> StreamCamera:
        """What the phone reports: the median of the lenses since `begin`."""
        assert self.sizes_px is not None  # set before anybody sees this object
        color_px, depth_px = self.sizes_px
        lens, notes = median_camera(np.array(self.lenses))
        intrinsics = Intrinsics(lens[0], lens[1], lens[2], lens[3], *color_px)
        notes = (*notes, TIMES, *((FRONT,) if self.front else ()))
        coarse = None if depth_px == color_px else depth_px
        return StreamCamera(intrinsics, STORED_UNIT_M, self.name, notes, coarse, focuses=True)

    def begin(self) -> None:
        """Count from zero, and forget the lenses so far."""
        self.counts.clear()
        del self.lenses[:-1]

    def shots(self, *, patience_s: float) -> Iterator[Shot]:
        """Yield shots until the phone is unplugged or silent."""
        return until_unplugged(self.poll, patience_s=patience_s)

    def lock_exposure(self, mean_color: MeanColor) -> tuple[str, ...]:
        """Say that the phone cannot be told to hold its exposure."""
        return ("a phone's exposure cannot be locked from here; keep bright windows out of the picture",)

    def poll(self) -> Shot | None:
        """The next pair; None when none has come for a moment."""
        try:
            shot, lens = self.waiting.get(timeout=POLL_S)
        except queue.Empty:
            if self.ended:
                raise UnpluggedError from None
            return None
        self.counts.pairs += 1
        self.lenses.append(lens)
        if self.sizes_px is None:
            self.sizes_px = _sizes_px(shot)
        return shot


TIMES = "the phone sends no times: they are those of arrival at this computer"
FRONT = "the camera on the side of the screen may send mirrored images: check that print reads the right way"


def _sizes_px(shot: Shot) -> tuple[tuple[int, int], tuple[int, int]]:
    """Width and height of colour and of depth; DataError when they cannot show the same view."""
    (height, width), (rows, columns) = shot.color.shape[:2], shot.depth.shape
    if abs(columns * height / (rows * width) - 1) > MOST_STRETCHED:
        raise DataError(
            f"the phone sends depth of {columns}x{rows} px and colour of {width}x{height} px, which do not "
            "show the same view; turn the phone upright, restart the stream, and try again"
        )
    return (width, height), (columns, rows)

"""What every camera offers, whoever made it: `CameraStreams`, and the shots that come from it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8, UInt16

from rpl_data.capture.exposure import MeanColor
from rpl_data.types import DataError, Intrinsics
from rpl_data.wording import counted

POLL_S = 0.1
"""How long to wait for a shot before asking whether the camera is still there."""

FIRST_SHOT_S = 10.0
"""A camera that has sent no shot for this long after its start will not send any."""


@dataclass(frozen=True)
class Shot:
    """A pair of a colour and a depth image.

    Attributes:
        number: the camera's own count of colour images; a gap means images lost before they arrived.
        timestamp_s: time of the colour image, on the camera's clock.
        color: RGB.
        depth: in units of `StreamCamera.metres_per_unit`, at the pixels of the colour image or, where
            `StreamCamera.depth_px` says so, at coarser pixels of the same view.
    """

    number: int
    timestamp_s: float
    color: UInt8[np.ndarray, "height width 3"]
    depth: UInt16[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class StreamCamera:
    """What the device reports about itself.

    Attributes:
        intrinsics: camera of the colour images, and so of the aligned depth.
        name: name of the device, with its serial number where it has one.
        notes: lines for the user.
        depth_px: width and height of the depth images, where they are coarser than the colour images.
        focuses: whether the lens moves, so that each scene has intrinsics of its own.
    """

    intrinsics: Intrinsics
    metres_per_unit: float
    name: str
    notes: tuple[str, ...] = ()
    depth_px: tuple[int, int] | None = None
    focuses: bool = False


@dataclass
class StreamCounts:
    """Counts of the frames that arrived, by what became of them."""

    pairs: int = 0
    color_alone: int = 0
    depth_alone: int = 0
    late: int = 0

    def clear(self) -> None:
        """Count from zero again."""
        self.pairs = self.color_alone = self.depth_alone = self.late = 0

    def lines(self) -> list[str]:
        """One line per kind of loss."""
        lines = []
        if self.color_alone:
            lines.append(f"{counted(self.color_alone, 'colour image')} without depth at the same time")
        if self.late:
            lines.append(f"{counted(self.late, 'colour image')} dropped: too fast to be aligned")
        return lines


@runtime_checkable
class CameraStreams(Protocol):
    """An open camera that sends colour and depth."""

    @property
    def camera(self) -> StreamCamera:
        """What the device reports about itself; may become more exact until the camera is closed."""

    @property
    def counts(self) -> StreamCounts:
        """Counts of frames, which grow while `shots` is read."""

    def begin(self) -> None:
        """A recording starts now: count from zero again."""

    def shots(self, *, patience_s: float) -> Iterator[Shot]:
        """Yield shots in the order of time, until the camera is unplugged or silent for `patience_s`."""

    def lock_exposure(self, mean_color: MeanColor) -> tuple[str, ...]:
        """Hold exposure and white balance as they are now; returns lines about what was held.

        Args:
            mean_color: measures the next images, 0-255.
        """


@dataclass(frozen=True)
class Wanted:
    """What a camera is asked for.

    Attributes:
        size_px: width and height of the colour images; None = the usual size of this camera.
        rate_hz: images per second.
        serial: serial number of the camera; None = the only one connected.
    """

    size_px: tuple[int, int] | None = None
    rate_hz: int = 30
    serial: str | None = None


class UnpluggedError(Exception):
    """The camera is gone; raised by the function that `until_unplugged` polls."""


def until_unplugged(poll: Callable[[], Shot | None], *, patience_s: float) -> Iterator[Shot]:
    """Yield what `poll` returns until it raises `UnpluggedError`, or returns None for `patience_s`."""
    heard_at = time.monotonic()
    while time.monotonic() - heard_at < patience_s:
        try:
            shot = poll()
        except UnpluggedError:
            return
        if shot is not None:
            yield shot
            heard_at = time.monotonic()


def first_of(poll: Callable[[], Shot | None], name: str) -> Shot:
    """The first shot of a camera that has just started, which tells what its images are like.

    Raises:
        DataError: none came.
    """
    for shot in until_unplugged(poll, patience_s=FIRST_SHOT_S):
        return shot
    raise DataError(
        f"{name} sends no colour with depth (for {FIRST_SHOT_S:g} s); plug it in again, into a USB 3 port"
    )


def needed(module: str, *, cameras: str, install: str) -> Any:
    """Import a maker's package.

    Args:
        module: what is imported.
        cameras: which cameras need it, for the message.
        install: the command that installs it.

    Raises:
        DataError: it is not installed, or cannot be loaded.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        raise DataError(f"{cameras} need the package {module}, which is not installed; {install}") from error
    except ImportError as error:
        raise DataError(f"the package {module} cannot be loaded: {error}; {install}") from error


USB_HINT = (
    "plug it into a USB 3 port (on Linux its udev rules must be installed, in a container the USB bus passed "
    "through)"
)
"""What to do when no camera is found."""


def chosen_serial(connected: list[str], wanted: str | None, *, cameras: str, hint: str) -> str:
    """The serial number of the camera to use.

    Args:
        connected: serial numbers of what is connected.
        wanted: the one asked for.
        cameras: what such a camera is called: "OAK camera".
        hint: what to do when there is none.

    Raises:
        DataError: there is none, or one must be chosen.
    """
    if not connected:
        raise DataError(f"no {cameras} is connected; {hint}")
    if wanted is not None and wanted not in connected:
        raise DataError(f"no {cameras} has serial number {wanted}; connected: {', '.join(connected)}")
    if wanted is None and len(connected) > 1:
        raise DataError(
            f"{len(connected)} cameras are connected; choose one with --serial: {', '.join(connected)}"
        )
    return connected[0] if wanted is None else wanted

"""Record a scene from an open camera: warm up, lock the exposure, count down, record."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from rpl_data.capture.camera import CameraStreams, Shot, StreamCamera
from rpl_data.capture.disk import SceneWriter
from rpl_data.capture.tally import Tally
from rpl_data.files import read_text, write_text
from rpl_data.formats.recordings.camera_file import camera_text
from rpl_data.types import DataError
from rpl_data.wording import counted

PATIENCE_S = 3.0
"""A camera that sends nothing for this long was unplugged, or hangs."""

WARM_UP_S = 1.0
"""Time for the automatic exposure to settle."""

SETTLING = 6
"""Number of images already on their way when a new setting takes effect."""

Say = Callable[[str], None]
Show = Callable[[Shot, str], None]
"""Receives every image with a line of status: "get ready: 3", "recording 12.3 s"."""


@dataclass(frozen=True)
class CaptureOptions:
    """Settings of a recording.

    Attributes:
        seconds: length of the recording; None = until stopped.
        countdown_s: whole seconds before it starts.
        exposure: "lock" holds what the automatic control chose, "auto" leaves it on.
    """

    seconds: float | None = None
    countdown_s: int = 3
    exposure: Literal["lock", "auto"] = "lock"


@dataclass(frozen=True)
class Captured:
    """Result of a recording.

    Attributes:
        folder: folder of the scene.
        frames: number of frames on disk.
        seconds: time from the first to the last of them.
        losses: one line per reason why frames are missing; empty when nothing was lost.
    """

    folder: Path
    frames: int
    seconds: float
    losses: tuple[str, ...]


def capture(
    streams: CameraStreams,
    recording: Path,
    scene: str,
    options: CaptureOptions,
    *,
    say: Say,
    show: Show = lambda shot, word: None,
    stop: Callable[[], bool] = lambda: False,
) -> Captured:
    """Record one scene: `<recording>/<scene>`, read by `format: rpl`, and `<recording>/camera.txt`.

    Lost frames are counted and reported when it happens. Unplugging the camera ends the recording; what is on
    disk by then is complete.

    Args:
        streams: the open camera.
        recording: the folder of all scenes, made when it does not exist.
        scene: name of this scene.
        options: settings of the recording.
        say: receives lines for the user.
        show: receives every image.
        stop: called at every image; True ends the recording.

    Raises:
        DataError: the camera sends nothing, the scene already exists, camera.txt is of another camera,
            or no frame was recorded.
    """
    folder = recording / scene
    _check_folder(recording, folder, streams.camera)
    for note in streams.camera.notes:
        say(note)
    shots = streams.shots(patience_s=PATIENCE_S)
    settled = _prepare(streams, shots, options, say, show, stop)
    say(f"recording to {folder}")
    streams.begin()
    captured = _record(streams, shots, folder, options, say, show, stop)
    facts = [f"recorded by {streams.camera.name}", *streams.camera.notes, *settled, *captured.losses]
    with suppress(DataError):  # on a full disk, which is among the losses already
        write_text(folder / "capture.txt", "".join(f"{line}\n" for line in facts))
        if streams.camera.focuses:  # the intrinsics of all its images are known only now
            write_text(_camera_path(folder, streams.camera), _camera_text(streams.camera))
    return captured


def _check_folder(recording: Path, folder: Path, camera: StreamCamera) -> None:
    """DataError when the scene exists, or camera.txt, which all scenes share, is of another camera."""
    if folder.exists():
        raise DataError(f"{folder} already exists; choose another --scene, or delete it first")
    path, text = _camera_path(folder, camera), _camera_text(camera)
    if path.exists() and read_text(path) != text:
        raise DataError(
            f"{path} is of another camera or image size than {camera.name} has now "
            f"({' '.join(text.split())}); record into another folder"
        )


def _camera_text(camera: StreamCamera) -> str:
    return camera_text(camera.intrinsics, camera.metres_per_unit, camera.depth_px)


def _camera_path(folder: Path, camera: StreamCamera) -> Path:
    """All scenes share one file, unless the lens moves between them."""
    return (folder if camera.focuses else folder.parent) / "camera.txt"


def _prepare(
    streams: CameraStreams,
    shots: Iterator[Shot],
    options: CaptureOptions,
    say: Say,
    show: Show,
    stop: Callable[[], bool],
) -> tuple[str, ...]:
    """Warm up, lock the exposure, count down; returns what was locked."""
    _show_for(WARM_UP_S, shots, "warming up", show, stop)
    lines: tuple[str, ...] = ()
    if options.exposure == "lock":
        say("holding exposure and white balance: point the camera at the scene and keep it still")
        lines = streams.lock_exposure(lambda: _mean_color(shots, show))
        for line in lines:
            say(line)
    for left in range(options.countdown_s, 0, -1):
        say(f"recording in {left}")
        _show_for(1.0, shots, f"get ready: {left}", show, stop)
    return lines


def _show_for(seconds: float, shots: Iterator[Shot], word: str, show: Show, stop: Callable[[], bool]) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until and not stop():
        show(_next(shots), word)


def _next(shots: Iterator[Shot]) -> Shot:
    for shot in shots:
        return shot
    raise DataError(
        f"the camera sends no colour with depth (for {PATIENCE_S:g} s); plug it in again, into a USB 3 port"
    )


def _mean_color(shots: Iterator[Shot], show: Show) -> Float64[np.ndarray, "3"]:
    """Mean colour of three images, ignoring those already on their way."""
    for _ in range(SETTLING):
        show(_next(shots), "holding the exposure")
    means = [_next(shots).color[::4, ::4].mean(axis=(0, 1)) for _ in range(3)]
    return np.asarray(np.mean(means, axis=0), dtype=np.float64)


def _record(
    streams: CameraStreams,
    shots: Iterator[Shot],
    folder: Path,
    options: CaptureOptions,
    say: Say,
    show: Show,
    stop: Callable[[], bool],
) -> Captured:
    """Write every frame to disk until the end."""
    lens, camera_file = streams.camera.intrinsics, _camera_path(folder, streams.camera)
    first_scene = not camera_file.exists()
    write_text(camera_file, _camera_text(streams.camera))
    tally = Tally(streams.counts)
    with SceneWriter(folder, frame_bytes=5 * lens.width * lens.height) as writer:
        unplugged = True
        for shot in shots:
            if stop() or tally.seconds_at(shot) > (options.seconds or math.inf) - 1e-3:
                unplugged = False
                break
            tally.add(shot, kept=writer.add(shot))
            if writer.failure is not None:
                break
            for line in tally.news():
                say(line)
            show(shot, f"recording {tally.seconds:.1f} s, {counted(tally.shots, 'frame')}")
    if not writer.listed:
        shutil.rmtree(folder)
        if first_scene:
            camera_file.unlink(missing_ok=True)
        raise writer.failure or DataError(f"nothing was recorded, so there is no {folder}; try again")
    ends = [] if writer.failure is None else [f"recording ended early: {writer.failure}"]
    if unplugged and not ends and not stop():
        ends = [f"the camera was unplugged or hung after {tally.seconds:.1f} s; what came before is kept"]
    return Captured(folder, writer.listed, tally.seconds, (*ends, *tally.losses()))

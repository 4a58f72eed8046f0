"""`rpl capture`: record a scene, with lines on the terminal, a preview in the browser, and Ctrl-C to stop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

from rich.console import Console

from rpl_data.capture.camera import CameraStreams
from rpl_data.capture.live import Captured, CaptureOptions, Show, capture
from rpl_data.capture.preview import Preview
from rpl_data.types import DataError


def record_scene(
    camera: AbstractContextManager[CameraStreams],
    recording: Path,
    scene: str | None,
    options: CaptureOptions,
    *,
    preview_port: int | None,
) -> Captured:
    """Record a scene with a camera, with lines on the terminal.

    Args:
        camera: opens the camera.
        recording: folder of all scenes.
        scene: name of the scene; None = the next number.
        options: how long, and so on.
        preview_port: port that the preview is served on; None = no preview.

    Raises:
        DataError: as `capture`; also when the camera cannot be opened, or the duration is not positive.
    """
    console = Console(highlight=False, markup=False, soft_wrap=True)
    if options.seconds is not None and options.seconds <= 0:
        raise DataError(f"--seconds must be positive, got {options.seconds:g}")
    name = next_scene(recording) if scene is None else scene
    with ExitStack() as stack:
        streams = stack.enter_context(camera)
        show: Show = lambda shot, word: None  # noqa: E731
        if preview_port is not None:
            page = stack.enter_context(Preview(preview_port, metres_per_unit=streams.camera.metres_per_unit))
            console.print(f"preview: {page.url}")
            show = page.show
        console.print(
            "end with Ctrl-C" if options.seconds is None else f"{options.seconds:g} s; Ctrl-C ends it"
        )
        stop = stack.enter_context(stopped_by_ctrl_c())
        captured = capture(streams, recording, name, options, say=console.print, show=show, stop=stop)
    for line in describe(captured):
        console.print(line)
    return captured


def next_scene(recording: Path) -> str:
    """The number after the largest of the recorded scenes: 00, 01, ..."""
    taken = [int(p.name) for p in recording.glob("*") if p.name.isdigit()] if recording.is_dir() else []
    return f"{max(taken, default=-1) + 1:02d}"


@contextmanager
def stopped_by_ctrl_c() -> Iterator[Callable[[], bool]]:
    """Make Ctrl-C request a stop, so that writing is finished; a second one interrupts at once."""
    asked = threading.Event()

    def ask(number: int, frame: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def describe(captured: Captured) -> list[str]:
    """Lines for the user: what was recorded, what was lost, and what to do next."""
    rate = (captured.frames - 1) / captured.seconds if captured.seconds else 0.0
    lost = captured.losses or ("nothing was lost",)
    heading = f"scene {captured.folder.name}: {captured.frames} frames, {captured.seconds:.1f} s"
    return [
        f"{heading}, {rate:.1f} frames per second",
        *(f"    {line}" for line in lost),
        f"look at it: rpl check {captured.folder.parent}",
    ]

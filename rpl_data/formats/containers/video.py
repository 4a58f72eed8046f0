"""Frames of a video file, by FFmpeg's decoders (PyAV)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from rpl_data.types import DataError

MOST_PIXELS = 2**26
"""Largest frame that is decoded: 8192 x 8192 pixels."""


def video_frames(path: Path) -> Iterator[tuple[float | None, UInt8[np.ndarray, "height width 3"]]]:
    """Yield the time in seconds, where there is one, and the pixels of every frame, as RGB.

    Pixels come as they are stored: a rotation that the file asks for is left to whoever shows it. Of a video
    that was cut off, the frames before the end are yielded. FFmpeg may end the process on a damaged file:
    call it in a process of its own.

    Raises:
        DataError: it is no video, or was cut off before its index, which phones write last.
    """
    import av

    try:
        container = av.open(str(path))
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise DataError(
            f"{path} cannot be played: {error}; if it was cut off, its index is lost: copy it again"
        ) from error
    with container:
        if not container.streams.video:
            raise DataError(f"{path} holds no video; copy it again")
        stream = container.streams.video[0]
        width, height = getattr(stream, "width", 0), getattr(stream, "height", 0)  # none without a decoder
        if not 0 < width * height <= MOST_PIXELS:
            raise DataError(f"{path} has frames of {width} x {height} px; expected a video")
        for frame in _frames(container, stream):
            if frame.width * frame.height > MOST_PIXELS:
                return
            time_s = None if frame.pts is None else float(frame.pts * stream.time_base)
            yield time_s, frame.to_ndarray(format="rgb24")


def _frames(container: Any, stream: Any) -> Iterator[Any]:
    """Decode the whole frames of a stream in the order in which they are shown, without a gap.

    Decoders hold some frames back, since a video may store a frame before others that are shown earlier.
    Where the file ends, those others may be lost: what is held back is given as far as it follows on.
    """
    from av.error import FFmpegError

    shown: list[int] = []
    stored = 0
    with suppress(FFmpegError):
        for packet in container.demux(stream):
            if not packet.size or packet.is_corrupt:
                break
            stored += 1
            for frame in packet.decode():
                shown.append(frame.pts or 0)
                yield frame
    is_whole = stored == stream.frames
    with suppress(FFmpegError):
        for frame in stream.codec_context.decode(None):
            if not is_whole and not _follows_on(shown, frame.pts or 0):
                return
            shown.append(frame.pts or 0)
            yield frame


def _follows_on(shown: Sequence[int], time: int) -> bool:
    """Whether no frame is missing between the times shown and another, going by their usual distance."""
    if len(shown) < 2:
        return not shown and time == 0
    return time - shown[-1] < 1.5 * float(np.median(np.diff(shown)))

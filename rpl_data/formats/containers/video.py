"""Frames of a video file, by FFmpeg's decoders (PyAV)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

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
        try:
            for frame in container.decode(stream):
                if frame.width * frame.height > MOST_PIXELS:
                    return
                yield frame.time, frame.to_ndarray(format="rgb24")
        except av.error.FFmpegError:
            return  # the rest was cut off; who counts frames misses them

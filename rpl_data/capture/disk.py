"""Write frames to disk while a camera runs, so that the recording is complete at every moment.

Encoding and writing run beside the camera, behind a queue of limited size. A frame that finds it full is
dropped and reported, since silence would mean a recording with unnoticed holes. A frame is listed in
associations.txt once both its images are on disk, in the order of time; so whatever ends the recording,
every listed frame is complete.
"""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from io import FileIO
from pathlib import Path
from types import TracebackType

from rpl_data.capture.camera import Shot
from rpl_data.formats.recordings.rpl import association_line
from rpl_data.formats.recordings.saved_images import write_images
from rpl_data.types import DataError

QUEUE_BYTES = 256 * 2**20
"""Size of the queue of frames that wait to be written: 6 s of 640x480 at 30 Hz."""

WRITERS = 2

Write = Callable[[Path, int, Shot], tuple[Path, Path]]


def write_shot(folder: Path, index: int, shot: Shot) -> tuple[Path, Path]:
    """Write both images of a frame, JPEG and PNG, and return their paths."""
    return write_images(folder, index, shot.color, shot.depth)


class SceneWriter:
    """Writes the frames of one scene, in the layout of a RapidPoseLabels tree.

    Attributes:
        listed: number of frames that are complete on disk.
        dropped: number of frames that found the queue full.
        list_file: the file that lists the frames, associations.txt.
        failure: why writing ended early; None while all is well.
    """

    def __init__(self, folder: Path, *, frame_bytes: int, write: Write = write_shot) -> None:
        self.folder = folder
        self.listed = self.dropped = self._taken = 0
        self.failure: DataError | None = None
        self._limit = max(4, QUEUE_BYTES // frame_bytes)
        self._write = write
        self._waiting: deque[tuple[float, Future[tuple[Path, Path]]]] = deque()
        self.list_file = folder / "associations.txt"
        self._list = _opened(self.list_file)
        self._pool = ThreadPoolExecutor(WRITERS, thread_name_prefix="disk")

    def __enter__(self) -> SceneWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait until all accepted frames are written."""
        try:
            self._enlist(everything=True)
        finally:
            self._pool.shutdown(cancel_futures=True)
            self._list.close()

    def add(self, shot: Shot) -> bool:
        """Accept a frame; False when it was dropped because the disk is too slow."""
        self._enlist()
        if len(self._waiting) >= self._limit:
            self.dropped += 1
            return False
        future = self._pool.submit(self._write, self.folder, self._taken, shot)
        self._waiting.append((shot.timestamp_s, future))
        self._taken += 1
        return True

    def _enlist(self, *, everything: bool = False) -> None:
        """List the frames that are written, up to the first that is not."""
        while self._waiting and self.failure is None and (everything or self._waiting[0][1].done()):
            timestamp_s, future = self._waiting.popleft()
            try:
                self._append(timestamp_s, *future.result())
            except DataError as error:
                self.failure = error
            except OSError as error:
                self.failure = DataError(
                    f"cannot write {self.folder / 'associations.txt'}: {error.strerror or error}"
                )

    def _append(self, timestamp_s: float, color: Path, depth: Path) -> None:
        names = (path.relative_to(self.folder).as_posix() for path in (color, depth))
        line = association_line(timestamp_s, *names).encode()
        begins = self._list.tell()
        if self._list.write(line) < len(line):  # a full disk accepts what still fits
            self._list.truncate(begins)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.listed += 1


def _opened(path: Path) -> FileIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("xb", buffering=0)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror or error}; choose another folder") from error

"""Count the frames of a live camera: how many arrived, over what time, and where others were lost."""

from __future__ import annotations

from rpl_data.capture.camera import Shot, StreamCounts
from rpl_data.wording import counted


class Tally:
    """Counts frames as they come, and where frames were lost.

    A colour image that the camera numbered but that never arrived was lost on the way (cable, USB); others
    came faster than they could be aligned, or without depth, as `StreamCounts` counts them; others found the
    disk's queue full.

    Attributes:
        shots: number of pairs that came.
        seconds: time from the first to the last of them, on the camera's clock.
        at_disk: number of pairs dropped because the disk was too slow.
    """

    def __init__(self, counts: StreamCounts) -> None:
        self._counts = counts
        self.shots = self.at_disk = self._jumped = 0
        self._first_s: float | None = None
        self._last: Shot | None = None
        self._next_news = 1

    @property
    def seconds(self) -> float:
        """Time from the first to the last pair."""
        return 0.0 if self._last is None else self.seconds_at(self._last)

    def seconds_at(self, shot: Shot) -> float:
        """Time from the first pair to this one."""
        return 0.0 if self._first_s is None else shot.timestamp_s - self._first_s

    def add(self, shot: Shot, *, kept: bool) -> None:
        """Count a pair, and the numbers that the camera gave to images between it and the last."""
        if self._last is None:
            self._first_s = shot.timestamp_s
        else:
            self._jumped += max(0, shot.number - self._last.number - 1)
        self._last = shot
        self.shots += 1
        self.at_disk += not kept

    @property
    def too_fast(self) -> int:
        """Number of colour images, first to last pair, that came faster than they could be aligned."""
        return min(self._counts.late, self._jumped - self.alone)

    @property
    def alone(self) -> int:
        """Number of colour images, first to last pair, without depth at the same time."""
        return min(self._counts.color_alone, self._jumped)

    @property
    def on_the_way(self) -> int:
        """Number of colour images, first to last pair, that never arrived."""
        return self._jumped - self.alone - self.too_fast

    def losses(self) -> list[str]:
        """One line per place where frames were lost."""
        found = {
            f"{counted(self.alone, 'colour image')} came without depth at the same time": self.alone,
            f"{counted(self.too_fast, 'colour image')} dropped: they came faster than they could be aligned; "
            "record smaller images, or at a lower --fps": self.too_fast,
            f"{counted(self.on_the_way, 'colour image')} lost between camera and computer; use a USB 3 port, "
            "a shorter cable, or a lower --fps": self.on_the_way,
            f"{counted(self.at_disk, 'frame')} dropped as the disk is too slow; record to a faster one": (
                self.at_disk
            ),
        }
        return [line for line, count in found.items() if count]

    def news(self) -> list[str]:
        """The losses if they have doubled since they were last asked for; otherwise nothing."""
        lost = self.at_disk + self._jumped
        if lost < self._next_news:
            return []
        self._next_news = 2 * lost
        return [f"losing frames: {line}" for line in self.losses()]

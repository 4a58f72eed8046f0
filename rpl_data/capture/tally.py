"""What came of the frames of a live camera: how many, over what time, and where the others were lost."""

from __future__ import annotations

from rpl_data.capture.streams import Shot, StreamCounts


class Tally:
    """Counts frames as they come; every loss has one of three places.

    A colour image the camera numbered and nobody received was lost on the way here (cable, USB); one came
    faster than it could be aligned, or without depth, as `StreamCounts` counts; one found the disk's queue
    full.

    Attributes:
        shots: pairs that came.
        seconds: from the first to the last of them, by the camera's clock.
        at_disk: pairs dropped because the disk was behind.
    """

    def __init__(self, counts: StreamCounts) -> None:
        self._counts = counts
        self.shots = self.at_disk = self._jumped = 0
        self._first_s: float | None = None
        self._last: Shot | None = None
        self._next_news = 1

    @property
    def seconds(self) -> float:
        """From the first to the last pair."""
        return 0.0 if self._last is None else self.seconds_at(self._last)

    def seconds_at(self, shot: Shot) -> float:
        """From the first pair to this one."""
        return 0.0 if self._first_s is None else shot.timestamp_s - self._first_s

    def add(self, shot: Shot, *, kept: bool) -> None:
        """Count a pair, and the numbers the camera gave to those between it and the last."""
        if self._last is None:
            self._first_s = shot.timestamp_s
        else:
            self._jumped += max(0, shot.number - self._last.number - 1)
        self._last = shot
        self.shots += 1
        self.at_disk += not kept

    @property
    def too_fast(self) -> int:
        """Colour images between the first pair and the last that came faster than they could be aligned."""
        return min(self._counts.late, self._jumped - self.alone)

    @property
    def alone(self) -> int:
        """Colour images between the first pair and the last without depth at their time."""
        return min(self._counts.color_alone, self._jumped)

    @property
    def on_the_way(self) -> int:
        """Colour images between the first pair and the last that never arrived."""
        return self._jumped - self.alone - self.too_fast

    def losses(self) -> list[str]:
        """A line for every place where frames were lost."""
        found = {
            f"{self.alone} colour images came without depth at their time": self.alone,
            f"{self.too_fast} colour images came faster than they could be aligned to and were dropped; "
            "record smaller images, or at a lower --fps": self.too_fast,
            f"{self.on_the_way} colour images were lost between camera and computer; use a USB 3 port, a "
            "shorter cable, or a lower --fps": self.on_the_way,
            f"{self.at_disk} frames were dropped because the disk is too slow; record to a faster one": (
                self.at_disk
            ),
        }
        return [line for line, count in found.items() if count]

    def news(self) -> list[str]:
        """The losses, when they have doubled since they were last asked for; else nothing."""
        lost = self.at_disk + self._jumped
        if lost < self._next_news:
            return []
        self._next_news = 2 * lost
        return [f"losing frames: {line}" for line in self.losses()]

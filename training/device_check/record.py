"""What the check has measured so far, written after every row: a check that is cut off leaves its rows."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rpl_data.files import write_json


@dataclass
class Record:
    """Measurements, and the time they may take.

    Attributes:
        out: the JSON file.
        minutes: how long the check may take; what there is no time for is left out and named.
        content: what was measured.
    """

    out: Path
    minutes: float
    content: dict[str, Any] = field(default_factory=dict)
    _started_s: float = field(default_factory=time.perf_counter)

    def left_s(self) -> float:
        """Seconds that are left."""
        return 60 * self.minutes - (time.perf_counter() - self._started_s)

    def note(self, **values: Any) -> None:
        """Keep values under their names."""
        self.content |= values
        self._write()

    def add(self, name: str, row: Any) -> None:
        """Add a row to a list."""
        self.content.setdefault(name, []).append(row)
        self._write()

    def has_time(self, what: str, seconds: float) -> bool:
        """Whether so many seconds are left; else `what` is named as left out."""
        if self.left_s() >= seconds:
            return True
        print(f"left out for want of time: {what}", flush=True)
        self.add("left_out", what)
        return False

    def _write(self) -> None:
        taken_s = time.perf_counter() - self._started_s
        write_json(self.out, {**self.content, "seconds": round(taken_s, 1)})

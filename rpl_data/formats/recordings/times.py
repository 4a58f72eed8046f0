"""Times of frames and poses, in whatever unit a recorder wrote them, as seconds.

Which unit it was follows from the usual step: depth cameras make a picture every 1/120 s or less often, and
of those that are kept one comes every 8 s or more often. Only one of seconds, milliseconds, microseconds and
nanoseconds can give that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.types import DataError

USUAL_STEPS_S = (1 / 120, 8.0)
"""Usual times between frames; less than a factor of 1000 apart, so that one unit alone fits."""

UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}

FRAME_RATE_HZ = 30.0
"""Assumed frame rate of recordings that count frames instead of seconds."""

MOST_FRAMES_APART = 10
"""Whole times this close together are counts, of every tenth frame at most: no depth camera makes 100 Hz."""

MOST_FRAMES = 1e7
"""Larger numbers count no frames, but time since some beginning."""

MOST_ROWS_OUT_OF_PLACE = 5
"""A recorder with several threads writes a line this far from its place, in a list of 20 or more; times that
lie farther off are something else, such as how long each frame took."""


@dataclass(frozen=True)
class Clock:
    """How stored times become seconds.

    Attributes:
        unit_s: seconds per stored unit.
        note: says the unit where it is not seconds; empty otherwise.
    """

    unit_s: float
    note: str = ""


def clock_of(times: Sequence[float], source: Path) -> Clock:
    """Find the unit of the frames' stored times, in any order, by their median step.

    Seconds are assumed where no unit gives a usual step; the doctor then shows the odd rate.

    Args:
        times: one per frame.
        source: the file they are from, for the note.
    """
    step = _median_step(times)
    if (
        1 <= step <= MOST_FRAMES_APART
        and max(times) < MOST_FRAMES
        and all(float(time).is_integer() for time in times)
    ):
        note = f"frames are counted, not timed: {FRAME_RATE_HZ:g} per second assumed"
        return Clock(1 / FRAME_RATE_HZ, note)
    for name, unit_s in UNITS.items():
        if USUAL_STEPS_S[0] <= step * unit_s <= USUAL_STEPS_S[1]:
            note = f"the times of {source.name} are {name}, by their usual step of {step:.6g}"
            return Clock(unit_s, "" if name == "seconds" else note)
    return Clock(1.0)


def clock_beside(times: Sequence[float], frames_s: Sequence[float], frames: Clock, source: Path) -> Clock:
    """Find the unit of stored times of poses, which may come seldom: the one that covers the frames best.

    Args:
        times: one per pose.
        frames_s: times of the frames.
        frames: clock of the frames, which is kept unless another unit covers them better.
        source: the file with the poses, for the note.
    """
    clocks = [frames] + [
        Clock(unit_s, f"the times of {source.name} are {name}, unlike those of the frames")
        for name, unit_s in UNITS.items()
        if unit_s != frames.unit_s
    ]
    frames_at, poses_at = np.asarray(frames_s, dtype=float), np.asarray(times, dtype=float)
    return max(clocks, key=lambda clock: _common_share(poses_at * clock.unit_s, frames_at))


def _common_share(a: Float64[np.ndarray, " n"], b: Float64[np.ndarray, " m"]) -> float:
    """Share of the time that two recordings span together in which both ran; 0 below a hundredth."""
    both = min(a.max(), b.max()) - max(a.min(), b.min())
    whole = max(a.max(), b.max()) - min(a.min(), b.min())
    return float(both / whole) if both > 0.01 * whole else 0.0


def _median_step(times: Sequence[float]) -> float:
    steps = np.diff(np.unique(np.asarray(times, dtype=float)))
    return float(np.median(steps)) if len(steps) else 0.0


def refuse_jumping(times: Sequence[float], source: Path) -> None:
    """Raise a DataError for times that jump back and forth, or that hardly change.

    Lines may be a few rows out of place, or run from the last to the first.
    """
    values = np.asarray(times, dtype=float)
    if len(values) < 3:
        return
    if len(np.unique(values)) <= len(values) // 2:
        raise DataError(f"{source}: {_NO_TIMES.format('most of its times are the same')}")
    allowed = min(MOST_ROWS_OUT_OF_PLACE, max(1, len(values) // 4))
    if min(_most_out_of_place(values), _most_out_of_place(values[::-1])) > allowed:
        raise DataError(f"{source}: {_NO_TIMES.format('its times jump back and forth')}")


_NO_TIMES = (
    "{}, so they are not the times at which the images were taken (how long each frame took, perhaps?); "
    "write the time of each image, in seconds, into the first column, and sort the lines by it"
)


def _most_out_of_place(values: Float64[np.ndarray, " n"]) -> int:
    """Largest distance of a row from where it would be in sorted order."""
    place = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return int(np.abs(place - np.arange(len(values))).max())

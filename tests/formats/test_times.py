"""The unit of times follows from their usual step; what jumps is no time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rpl_data.formats.recordings.times import Clock, clock_beside, clock_of, refuse_jumping
from rpl_data.types import DataError

SOURCE = Path("rgb.txt")
EPOCH_S = 1_700_000_000.0


@pytest.mark.parametrize("name", ["seconds", "milliseconds", "microseconds", "nanoseconds"])
@pytest.mark.parametrize("step_s", [1 / 110, 1 / 30, 5.567, 7.9])
def test_the_unit_follows_from_the_usual_step(name: str, step_s: float) -> None:
    unit_s = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}[name]
    stored = [(EPOCH_S + step_s * n) / unit_s for n in range(9)]
    clock = clock_of([*stored[:4], *stored[6:]], SOURCE)
    assert clock.unit_s == unit_s
    assert (name in clock.note) == (name != "seconds")


def test_whole_numbers_one_apart_count_frames() -> None:
    clock = clock_of([float(n) for n in range(5, 12)], SOURCE)
    assert (clock.unit_s, clock.note) == (1 / 30, "frames are counted, not timed: 30 per second assumed")
    for every in (2, 4, 10):  # of which some were left out; in seconds or milliseconds they fit as well
        assert clock_of([float(every * n) for n in range(9)], SOURCE) == clock


def test_what_fits_no_unit_is_left_as_seconds() -> None:
    assert clock_of([0.0, 8.2, 16.4], SOURCE) == Clock(1.0)
    assert clock_of([7.0], SOURCE) == Clock(1.0)


@pytest.mark.parametrize("unit_s", [1.0, 1e-3, 1e-6, 1e-9])
def test_seldom_poses_take_the_unit_that_covers_the_frames(unit_s: float) -> None:
    """Keyframes 5 s apart: their own step alone would make milliseconds of seconds."""
    frames_s = [EPOCH_S + n / 30 for n in range(900)]
    stored = [(EPOCH_S + 1 + 5 * n) / unit_s for n in range(5)]
    assert clock_beside(stored, frames_s, Clock(1.0), Path("camera.poses")).unit_s == unit_s


def test_poses_of_another_clock_keep_the_unit_of_the_frames() -> None:
    assert clock_beside([9e5, 9e5 + 1], [0.0, 1.0], Clock(1.0), SOURCE) == Clock(1.0)


@pytest.mark.parametrize("frames", [6, 12, 200])
def test_how_long_frames_took_is_refused(frames: int) -> None:
    took_ms = 33 + np.random.default_rng(frames).normal(0, 3, frames)
    for stored in (took_ms, took_ms / 1000):
        with pytest.raises(DataError, match=r"rgb.txt: its times jump back and forth.*sort the lines by it"):
            refuse_jumping(stored.tolist(), SOURCE)


def test_a_constant_duration_is_refused() -> None:
    with pytest.raises(DataError, match="most of its times are the same"):
        refuse_jumping([0.033] * 5 + [0.034] * 4, SOURCE)


def test_a_few_lines_out_of_place_or_all_in_reverse_are_times() -> None:
    times = [n / 30 for n in range(40)]
    refuse_jumping(times[::-1], SOURCE)
    times[7:10] = reversed(times[7:10])
    refuse_jumping(times, SOURCE)
    refuse_jumping([1.0, 0.0], SOURCE)


def test_two_takes_in_one_list_are_refused() -> None:
    with pytest.raises(DataError, match="jump back and forth"):
        refuse_jumping([n / 30 for n in range(30)] + [n / 30 + 0.01 for n in range(30)], SOURCE)

"""Counts in messages."""

from __future__ import annotations

from rpl_data.wording import counted


def test_a_single_thing_is_not_written_as_many() -> None:
    assert [counted(n, "frame") for n in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]

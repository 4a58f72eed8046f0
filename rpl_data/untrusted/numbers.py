"""Numbers in texts of others."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

Number = TypeVar("Number", int, float)


def plain_number(kind: Callable[[str], Number], text: str) -> Number:
    """A number as tables and lists hold it; Python's own `3_07.5` is a slip of the finger, not 307.5.

    Raises:
        ValueError: it is none.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r:.40} is no number")
    return kind(text)

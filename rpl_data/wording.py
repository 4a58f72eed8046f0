"""Wording of messages: numbers with their nouns in the right form."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """Write a count with its noun: `1 frame`, `3 frames`, `0 frames`. The noun's plural must end in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"

"""Clicks that come from a file: what they change, as events for the log and in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rpl_data.clicks.log import Annotation, Event, events_to
from rpl_data.types import Click
from rpl_data.wording import counted


@dataclass(frozen=True)
class Incoming:
    """What a file of clicks does to an object.

    Attributes:
        events: they bring the log there; empty when nothing changes.
        added, moved, removed, same: numbers of clicks: new ones, those of the same keypoint and frame at
            another pixel, those that the object had and the file has not, and those that stay as they are.
        decided: clicks of a program that were left out: their keypoints were clicked in that scene, or
            declared not visible there.
    """

    events: tuple[Event, ...]
    added: int
    moved: int
    removed: int
    same: int
    decided: int = 0

    @property
    def changed(self) -> int:
        """Number of clicks that are not as before."""
        return self.added + self.moved + self.removed

    def __str__(self) -> str:
        """`3 clicks added, 1 moved, 2 removed; 20 stay as before`."""
        if not self.decided:
            return self._changes()
        why = "was" if self.decided == 1 else "were"
        return f"{self._changes()}; {self.decided} {why} left out, of keypoints clicked or skipped before"

    def _changes(self) -> str:
        numbers = (("added", self.added), ("moved", self.moved), ("removed", self.removed))
        parts = [f"{number} {word}" for word, number in numbers if number]
        if not parts:
            return f"no click changed; all {self.same} were there" if self.same else "no click changed"
        first = next(number for _, number in numbers if number)
        parts[0] = parts[0].replace(f"{first} ", f"{counted(first, 'click')} ", 1)
        stay = f"; {self.same} {'stays' if self.same == 1 else 'stay'} as before" if self.same else ""
        return ", ".join(parts) + stay


def click_key(click: Click) -> tuple[int, str, int]:
    """What there is at most one click of: a keypoint in a frame of a scene."""
    return click.keypoint, click.scene, click.frame


def incoming(
    annotation: Annotation, keypoints: Sequence[str], clicks: Iterable[Click], *, replaces: bool
) -> Incoming:
    """What the clicks of a file change.

    Args:
        keypoints: the names that the object has from then on.
        replaces: the object's other clicks are removed; else they stay.
    """
    new = {click_key(click): click for click in clicks}
    old = {click_key(click): click for click in annotation.clicks}
    wanted = new if replaces else old | new
    return Incoming(
        tuple(events_to(annotation, keypoints, wanted.values())),
        added=len(wanted.keys() - old.keys()),
        moved=sum(old[key] != click for key, click in wanted.items() if key in old),
        removed=len(old.keys() - wanted.keys()),
        same=sum(old.get(key) == click for key, click in wanted.items()),
    )

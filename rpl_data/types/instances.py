"""Names of an object's places in a scene that shows several instances of it.

Eq. 2 places an object once per scene. A scene that shows several instances of it counts as that many scenes
which share one recording: clicks, solutions and everything by scene name them `00`, `00/2`, `00/bottom`. What
stands before the slash is the scene, behind it the instance; names of scenes and instances hold no slash.
Instances of different scenes have nothing to do with one another, whatever they are called.

Where an object is moved while a scene is filmed, each clicked frame is such a place too: `00/@12`, `00/2@12`.
"""

from __future__ import annotations

from collections.abc import Iterable

_BETWEEN = "/"
_AT_FRAME = "@"


def placed_as(scene: str, instance: str = "") -> str:
    """Name of an instance's place in a scene; the scene's own name for the instance without a name."""
    return f"{scene}{_BETWEEN}{instance}" if instance else scene


def scene_of(place: str) -> str:
    """The scene of a place."""
    return place.partition(_BETWEEN)[0]


def instance_of(place: str) -> str:
    """The instance of a place; empty for the one without a name."""
    return place.partition(_BETWEEN)[2]


def places_in(scene: str, places: Iterable[str]) -> list[str]:
    """Those of the places that lie in a scene, sorted."""
    return sorted(place for place in places if scene_of(place) == scene)


def placed_in_frame(place: str, frame: int) -> str:
    """Name of the place that a moved object has in one frame."""
    return placed_as(scene_of(place), f"{instance_of(place)}{_AT_FRAME}{frame}")


def without_frame(place: str) -> str:
    """The place without the frame that `placed_in_frame` gave it."""
    return placed_as(scene_of(place), instance_of(place).partition(_AT_FRAME)[0])


def frame_of(place: str) -> int | None:
    """The frame of a place that `placed_in_frame` named; None for others."""
    number = instance_of(place).partition(_AT_FRAME)[2]
    return int(number) if number.isdecimal() else None

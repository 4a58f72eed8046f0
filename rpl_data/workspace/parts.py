"""Videos that were cut into several scenes, and the clicks that follow their frames.

Frames keep their numbers, so a click belongs to a frame of a video however it is cut. The log of clicks
names videos; everything else names the scenes they were cut into.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from rpl_data.types import Click, Span


@dataclass(frozen=True)
class Parts:
    """How videos were cut.

    Attributes:
        spans: frames of the parts in order, by the name of the video; videos that are whole are left out.
    """

    spans: Mapping[str, tuple[Span, ...]]

    def scenes_of(self, video: str) -> tuple[str, ...]:
        """The scenes a video was cut into; itself when it is whole."""
        return (
            tuple(part_name(video, n) for n in range(len(self.spans[video])))
            if video in self.spans
            else (video,)
        )

    def scene_at(self, video: str, frame: int) -> str:
        """The scene that holds a frame of a video."""
        if video not in self.spans:
            return video
        lasts = [last for _, last in self.spans[video][:-1]]
        return part_name(video, sum(frame > last for last in lasts))

    def video_of(self, scene: str) -> str:
        """The video a scene was cut from; itself when it was not."""
        return next((video for video in self.spans if scene in self.scenes_of(video)), scene)

    def click_in_scene(self, click: Click) -> Click:
        """The click with the scene its frame is in, whether it names that or the video."""
        return replace(click, scene=self.scene_at(self.video_of(click.scene), click.frame))

    def click_in_video(self, click: Click) -> Click:
        """The click with the name of the video."""
        return replace(click, scene=self.video_of(click.scene))

    def event_in_scene(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """An event of the log with the scenes its frames are in."""
        return _moved(event, lambda scene, frame: self.scene_at(self.video_of(scene), frame))

    def event_in_video(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """An event with the names of videos, as the log keeps it."""
        return _moved(event, lambda scene, frame: self.video_of(scene))


def part_name(video: str, number: int) -> str:
    """Name of a part, counted from 0: 00.1, 00.2, ..."""
    return f"{video}.{number + 1}"


def _moved(event: Mapping[str, Any], scene_of: Callable[[str, int], str]) -> dict[str, Any]:
    """The event with its scene renamed where it has a frame; `skip` is of a scene as a whole."""
    moved = dict(event)
    if "events" in moved:
        moved["events"] = [_moved(inner, scene_of) for inner in moved["events"]]
    if moved.get("scene") is not None and "frame" in moved:
        moved["scene"] = scene_of(moved["scene"], moved["frame"])
    return moved

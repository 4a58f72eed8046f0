"""Videos that were cut into several scenes, and the clicks that follow their frames.

Frames keep their numbers, so a click belongs to a frame of a video however it is cut. The log of clicks
names videos; everything else names the scenes they were cut into.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rpl_data.types import Click, DataError, Recording, Span, Trajectory


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


def recordings_of_parts(
    recording: Recording, trajectory: Trajectory, spans: Sequence[Span]
) -> list[Recording]:
    """One recording per part, with its own frames and poses; the frames keep their numbers."""
    video, parts = recording.scene.name, Parts({recording.scene.name: tuple(spans)})
    found = []
    for name in parts.scenes_of(video):
        frames = tuple(f for f in recording.scene.frames if parts.scene_at(video, f.index) == name)
        rows = np.array([parts.scene_at(video, int(index)) == name for index in trajectory.frames])
        poses = Trajectory(trajectory.frames[rows], trajectory.scene_from_camera[rows])
        found.append(Recording(replace(recording.scene, name=name, frames=frames), poses))
    return found


def refuse_taken_names(video: str, cut: Sequence[Recording], taken: Collection[str]) -> None:
    """Raise DataError when another recording has the name of a part."""
    names = [part.scene.name for part in cut]
    if clash := sorted(set(names) & set(taken)):
        raise DataError(
            f"scene {video} is cut into {', '.join(names)}, but another recording is called "
            f"{', '.join(clash)}; rename it"
        )


def _moved(event: Mapping[str, Any], scene_of: Callable[[str, int], str]) -> dict[str, Any]:
    """The event with its scene renamed where it has a frame; `skip` is of a scene as a whole."""
    moved = dict(event)
    if "events" in moved:
        moved["events"] = [_moved(inner, scene_of) for inner in moved["events"]]
    if moved.get("scene") is not None and "frame" in moved:
        moved["scene"] = scene_of(moved["scene"], moved["frame"])
    return moved

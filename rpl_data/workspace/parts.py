"""Videos that were cut into several scenes because their poses drift, and where their clicks belong then.

A part keeps the frame numbers of its video, so a click belongs to the same frame however the video is cut.
The log of clicks names videos; everything else names the scenes (parts) that they were cut into.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rpl_data.types import Click, DataError, Recording, Span, Trajectory
from rpl_data.types.instances import instance_of, placed_as, placed_in_frame, scene_of, without_frame


@dataclass(frozen=True)
class Parts:
    """Which videos were cut into parts, and at which frames.

    Attributes:
        spans: first and last frame of each part, in order, keyed by video name. A whole video has no entry.
        moving: videos in which objects are moved: each clicked frame of them is a place of its own.
    """

    spans: Mapping[str, tuple[Span, ...]]
    moving: frozenset[str] = frozenset()

    def scenes_of(self, video: str) -> tuple[str, ...]:
        """Names of the scenes that a video was cut into; its own name when it is whole."""
        return (
            tuple(part_name(video, n) for n in range(len(self.spans[video])))
            if video in self.spans
            else (video,)
        )

    def scene_at(self, video: str, frame: int) -> str:
        """Name of the scene that holds this frame of the video."""
        if video not in self.spans:
            return video
        lasts = [last for _, last in self.spans[video][:-1]]
        return part_name(video, sum(frame > last for last in lasts))

    def video_of(self, scene: str) -> str:
        """Name of the video that a scene was cut from; the scene's own name when it was not cut.

        An instance's place (`types.instances`) has the video of its scene.
        """
        own = scene_of(scene)
        return next((video for video in self.spans if own in self.scenes_of(video)), own)

    def click_in_scene(self, click: Click) -> Click:
        """Copy of the click that names the scene holding its frame, not the video."""
        return replace(click, scene=self._part(click.scene, click.frame))

    def click_in_video(self, click: Click) -> Click:
        """Copy of the click that names the video."""
        return replace(click, scene=self._video(click.scene))

    def event_in_scene(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """Copy of an event of the click log that names the scenes holding its frames."""
        return _renamed(event, self._part)

    def event_in_video(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """Copy of an event that names videos, as the click log stores it."""
        return _renamed(event, lambda place, frame: self._video(place))

    def _part(self, place: str, frame: int) -> str:
        """The place in the scene that holds a frame of its video."""
        video = self.video_of(place)
        if video in self.moving:
            return placed_in_frame(self._video(place), frame)
        return placed_as(self.scene_at(video, frame), instance_of(place))

    def _video(self, place: str) -> str:
        """The place in the video."""
        video = self.video_of(place)
        return without_frame(place) if video in self.moving else placed_as(video, instance_of(place))


def part_name(video: str, number: int) -> str:
    """Name of part `number` (counted from 0) of a video: `00.1`, `00.2`, ..."""
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


def _renamed(event: Mapping[str, Any], scene_of: Callable[[str, int], str]) -> dict[str, Any]:
    """Rename the scene in an event that has a frame; `skip` has none, since it concerns the whole scene."""
    renamed = dict(event)
    if "events" in renamed:
        renamed["events"] = [_renamed(inner, scene_of) for inner in renamed["events"]]
    if renamed.get("scene") is not None and "frame" in renamed:
        renamed["scene"] = scene_of(renamed["scene"], renamed["frame"])
    return renamed

"""The colour and the depth stream of a bag, their cameras, and how depth comes onto colour."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rpl_data.formats.recordings.frame_files import Camera, intrinsics_of
from rpl_data.formats.recordings.ros.cameras import camera_of
from rpl_data.formats.recordings.ros.decode import size_of
from rpl_data.formats.recordings.ros.survey import Survey, times_ns
from rpl_data.formats.recordings.ros.topics import (
    ImageTopic,
    choose_color,
    choose_depth,
    is_aligned_by_name,
)
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.geometry import Transform, resized
from rpl_data.types import DataError, Intrinsics


@dataclass(frozen=True)
class Streams:
    """The two topics of a recording, and how depth comes onto colour.

    Attributes:
        depth_camera: camera of the depth images; None where they have the pixels of the colour images.
        color_from_depth: where it stands; None where both come through one lens.
        registered: whether it is known how depth lies to colour.
    """

    color: ImageTopic
    depth: ImageTopic
    camera: Intrinsics
    camera_source: str
    depth_camera: Intrinsics | None
    color_from_depth: Transform | None
    registered: bool
    notes: tuple[str, ...]


def streams_of(survey: Survey, topics: Topics, camera: Camera | None, file: Path) -> Streams:
    """Choose the topics of a recording, and find out how its depth comes onto its colour.

    Args:
        survey: what the bag holds.
        topics: topics that were asked for.
        camera: camera of the colour images, where it was given.
        file: the bag, for messages.

    Raises:
        DataError: topics or cameras are missing or ambiguous, or depth of another size has no way to colour.
    """
    try:
        color = choose_color(survey.images, topics.color)
        depth = choose_depth(survey.images, color, topics.depth)
    except DataError as error:
        raise DataError(f"{file}: {error}") from error
    color_size, depth_size = size_of(color.first), size_of(depth.first)
    if color_size is None or depth_size is None:
        lost = color.name if color_size is None else depth.name
        raise DataError(f"{file}: the first image of {lost} cannot be decoded; record it again")
    source = topics.color_info or _info_topic(survey, color)
    if camera is not None:
        lens = intrinsics_of(camera, *color_size)
    elif source not in survey.infos:
        raise DataError(
            f"{file} holds no camera_info for {color.name}; name its topic, `topics: {{color_info: ...}}` "
            f"(there are {', '.join(survey.infos) or 'none'}), or give `camera: [fx, fy, cx, cy]`"
        )
    else:
        lens = camera_of(survey.infos[source], color_size, color, source)
    depth_camera, place, registered, note = _alignment(survey, color, depth, lens, depth_size, topics, file)
    notes = (f"colour from {color.name}, depth from {depth.name}", *([note] if note else []))
    if not times_ns(color)[1]:
        notes += (f"{color.name} has no stamps in its headers: times are when images were recorded",)
    return Streams(color, depth, lens, source or str(file), depth_camera, place, registered, notes)


def _info_topic(survey: Survey, images: ImageTopic) -> str:
    """The camera_info of a topic of images: beside it, or else the only one of its frame; empty when none."""
    beside = f"{images.folder}/camera_info"
    if beside in survey.infos:
        return beside
    same = [
        name for name, info in survey.infos.items() if str(info.header.frame_id).lstrip("/") == images.frame
    ]
    return same[0] if len(same) == 1 else ""


def _alignment(
    survey: Survey,
    color: ImageTopic,
    depth: ImageTopic,
    camera: Intrinsics,
    depth_size: tuple[int, int],
    topics: Topics,
    file: Path,
) -> tuple[Intrinsics | None, Transform | None, bool, str]:
    """The camera of depth where it has one of its own, its place, whether that is known, and a note."""
    same_size = depth_size == (camera.width, camera.height)
    source = topics.depth_info or _info_topic(survey, depth)
    aligned = is_aligned_by_name(depth.base) or (color.frame == depth.frame and color.frame != "")
    if aligned and same_size and not _differ(survey, source, depth, camera):
        return None, None, True, ""
    own = camera_of(survey.infos[source], depth_size, depth, source) if source in survey.infos else None
    if aligned:
        return own or resized(camera, width=depth_size[0], height=depth_size[1]), None, True, ""
    color_from_depth = survey.color_from_depth
    if color_from_depth is None and color.frame and depth.frame:
        color_from_depth = survey.tree.fixed(color.frame, depth.frame)
    if color_from_depth is not None and own is not None:
        return own, color_from_depth, True, ""
    what = (
        "camera_info" if color_from_depth is not None else "transform (/tf_static, extrinsics/depth_to_color)"
    )
    frames = f"depth is in frame {depth.frame or '?'}, colour in {color.frame or '?'}"
    missing = f"{frames}, and the bag holds no {what} for it"
    if not same_size:
        raise DataError(f"{file}: {missing}; record that too, or depth that the driver aligned to colour")
    return None, None, False, f"{missing}: not registered; set `registered: true` if the driver aligned it"


def _differ(survey: Survey, source: str, depth: ImageTopic, camera: Intrinsics) -> bool:
    """Whether depth of the same frame and size has a camera of its own all the same."""
    if source not in survey.infos:
        return False
    k = np.array(getattr(survey.infos[source], "k", getattr(survey.infos[source], "K", None)), float)
    mine = np.array([k[0], k[4], k[2], k[5]])
    return bool(k[0] > 0 and np.abs(mine - [camera.fx, camera.fy, camera.cx, camera.cy]).max() > 1.0)

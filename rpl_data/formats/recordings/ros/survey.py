"""Go through a bag once and note what it holds: image topics with stamps, cameras, transforms, poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Int64

from rpl_data.formats.recordings.ros.bags import Bag, Message
from rpl_data.formats.recordings.ros.cameras import from_extrinsics
from rpl_data.formats.recordings.ros.decode import COMPRESSED, IMAGE, decoded, size_of, stamp_ns
from rpl_data.formats.recordings.ros.poses import POSE_TYPES, TF_TYPES
from rpl_data.formats.recordings.ros.topics import ImageTopic
from rpl_data.formats.recordings.ros.transforms import FrameTree, frame_name
from rpl_data.formats.recordings.ros.video import VIDEO_TYPES, VideoPacket, is_video_format
from rpl_data.geometry import Transform
from rpl_data.types import DataError

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


@dataclass
class Survey:
    """What a bag holds.

    Attributes:
        types: the type of every topic.
        images: its image topics.
        infos: the first CameraInfo of each topic.
        tree: its coordinate frames.
        color_from_depth: as a topic .../extrinsics/depth_to_color of realsense-ros says it.
        poses: decoded messages of the topic of poses that was asked for.
        early: stamps of image messages before the first that could be decoded.
    """

    types: dict[str, str]
    images: dict[str, ImageTopic] = field(default_factory=dict)
    infos: dict[str, Any] = field(default_factory=dict)
    tree: FrameTree = field(default_factory=FrameTree)
    color_from_depth: Transform | None = None
    poses: list[Any] = field(default_factory=list)
    early: dict[str, tuple[list[int], list[int]]] = field(default_factory=dict)


def survey_of(bag: Bag, poses: str | None) -> Survey:
    """Note what a bag holds.

    Args:
        bag: the bag.
        poses: the topic of poses that is wanted.

    Raises:
        DataError: there is no such topic, or it holds no poses.
    """
    survey = Survey(bag.types())
    pose_topic = _pose_topic(survey.types, poses)
    kinds = (IMAGE, COMPRESSED, *VIDEO_TYPES, CAMERA_INFO, *TF_TYPES)
    wanted = {name for name, kind in survey.types.items() if kind in kinds or name == pose_topic}
    wanted |= {name for name, kind in survey.types.items() if _is_extrinsics(name, kind)}
    for message in bag.messages(wanted):
        _note(survey, message, pose_topic)
    return survey


def _pose_topic(types: dict[str, str], poses: str | None) -> str | None:
    if poses is None:
        return None
    name = "/" + poses.lstrip("/")
    if name == "/tf" and not any(kind in TF_TYPES for kind in types.values()):
        raise DataError("the bag holds no /tf; leave `topics: {poses: /tf}` out to have the camera tracked")
    if name != "/tf" and types.get(name) not in POSE_TYPES:
        able = [topic for topic, kind in types.items() if kind in (*POSE_TYPES, *TF_TYPES)]
        raise DataError(
            f"`topics: {{poses: {poses}}}`: the bag holds no poses there; topics with poses are "
            f"{', '.join(able) or 'none'}"
        )
    return name


def _is_extrinsics(name: str, kind: str) -> bool:
    return name.endswith("depth_to_color") and kind.endswith("/Extrinsics")


def _note(survey: Survey, message: Message, pose_topic: str | None) -> None:
    """Note a message; one that cannot be decoded is passed over."""
    if message.type in (IMAGE, COMPRESSED, *VIDEO_TYPES):
        _note_image(survey, message)
        return
    if message.type == CAMERA_INFO and message.topic in survey.infos:
        return
    found = decoded(message)
    if found is None:
        return
    if message.type == CAMERA_INFO:
        survey.infos[message.topic] = found
    elif message.type in TF_TYPES:
        survey.tree.add(found, is_static=message.topic == "/tf_static")
    elif message.topic == pose_topic:
        survey.poses.append(found)
    elif survey.color_from_depth is None:
        survey.color_from_depth = from_extrinsics(found)


def _note_image(survey: Survey, message: Message) -> None:
    topic = survey.images.get(message.topic)
    if topic is None:
        first = decoded(message)
        early = survey.early.setdefault(message.topic, ([], []))
        if isinstance(first, VideoPacket) and is_video_format(first.format) and size_of(first) is None:
            first = None  # what changed since a picture that was not recorded
        if first is None:  # it counts all the same
            early[0].append(0)
            early[1].append(message.bag_ns)
            return
        encoding = str(first.encoding if hasattr(first, "encoding") else first.format)
        if message.topic.endswith("/compressedDepth") and "compresseddepth" not in encoding.lower():
            encoding += "; compressedDepth"
        frame = frame_name(first.header.frame_id)
        frame = "" if frame.isdigit() else frame  # depthai's recorder counts images there
        topic = ImageTopic(message.topic, first, encoding, frame, *early)
        survey.images[message.topic] = topic
    topic.stamps_ns.append(stamp_ns(message))
    topic.bag_ns.append(message.bag_ns)


def times_ns(topic: ImageTopic) -> tuple[Int64[np.ndarray, " n"], bool]:
    """The time of each image, and whether it is the camera's own; the recorder's where headers are empty."""
    stamps = np.array(topic.stamps_ns, dtype=np.int64)
    if len(np.unique(stamps)) > len(stamps) // 2:
        return stamps, True
    return np.array(topic.bag_ns, dtype=np.int64), False

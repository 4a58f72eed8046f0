"""Camera poses from a bag: from /tf, or from a topic of odometry, stamped poses or a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.formats.recordings.pose_lines import interpolated
from rpl_data.formats.recordings.ros.transforms import MAX_GAP_S, FrameTree, frame_name, rigid_of
from rpl_data.geometry import Transform
from rpl_data.types import DataError

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE_TYPES = (
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)


@dataclass(frozen=True)
class _Track:
    """Poses of one frame over time.

    Attributes:
        child: the frame whose poses these are; empty where the messages do not say.
        parent: the frame they are given in.
    """

    child: str
    parent: str
    times_s: Float64[np.ndarray, " n"]
    parent_from_child: Float64[np.ndarray, "n 4 4"]


def poses_from_tree(
    tree: FrameTree, color_frame: str, wanted: str | None, times_s: Float64[np.ndarray, " n"]
) -> tuple[list[Transform | None], str]:
    """`scene_from_camera` at each time from /tf, None where it is not known; also a note.

    Raises:
        DataError: /tf says nothing about the frame of the colour images.
    """
    scene = wanted or tree.root(color_frame)
    poses = tree.at(scene, color_frame, times_s)
    if scene == color_frame or all(pose is None for pose in poses):
        raise DataError(
            f"/tf does not say where {color_frame} (the frame of the colour images) is in {scene}; name a "
            "frame of the tree, `topics: {poses: /tf, frame: ...}`, or leave `poses` out to have it tracked"
        )
    return poses, f"poses of {color_frame} in {scene} from /tf"


def poses_from_messages(
    messages: Sequence[Any], topic: str, tree: FrameTree, color_frame: str, times_s: Float64[np.ndarray, " n"]
) -> tuple[list[Transform | None], str]:
    """`scene_from_camera` at each time from the messages of a topic of poses; also a note.

    Raises:
        DataError: they are poses of another frame, from which no fixed transform leads to the camera.
    """
    track = _track(messages)
    if track is None:
        raise DataError(
            f"{topic} holds no pose; leave `topics: {{poses: ...}}` out to have the camera tracked"
        )
    found = interpolated(track.times_s, track.parent_from_child, times_s, max_gap_s=MAX_GAP_S)
    if not track.child:
        return found, f"poses from {topic}, taken for those of {color_frame} (x right, y down, z forward)"
    child_from_camera = tree.fixed(track.child, color_frame)
    if child_from_camera is None:
        raise DataError(
            f"{topic} holds poses of {track.child}, and no fixed transform of /tf_static leads from there to "
            f"{color_frame}, the frame of the colour images; record /tf_static too, or leave `poses` out"
        )
    poses = [None if pose is None else pose @ child_from_camera for pose in found]
    return poses, f"poses of {color_frame} in {track.parent} from {topic} and /tf_static"


def _track(messages: Sequence[Any]) -> _Track | None:
    """The poses of all messages in the order of time; None where there are none."""
    if not messages:
        return None
    if hasattr(messages[0], "poses"):  # each Path repeats the one before, and adds to it
        messages = max(messages, key=lambda path: len(path.poses)).poses
    rows = []
    for message in messages:
        pose = _pose(message)
        if pose is not None:
            rows.append((message.header.stamp.sec + message.header.stamp.nanosec * 1e-9, pose))
    if not rows:
        return None
    rows.sort(key=lambda row: row[0])
    first = messages[0]
    return _Track(
        frame_name(getattr(first, "child_frame_id", "")),
        frame_name(first.header.frame_id),
        np.array([time for time, _ in rows]),
        np.array([pose for _, pose in rows]),
    )


def _pose(message: Any) -> Transform | None:
    if hasattr(message, "transform"):
        return rigid_of(message.transform.translation, message.transform.rotation)
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    return rigid_of(pose.position, pose.orientation)

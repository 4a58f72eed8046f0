"""The tree of coordinate frames that a bag's /tf and /tf_static describe, and ways through it.

Each of their transforms takes points from the child frame to its parent (geometry_msgs/TransformStamped).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.formats.recordings.pose_lines import interpolated
from rpl_data.geometry import Transform, from_quaternion_xyzw, invert
from rpl_data.types import DataError

MAX_GAP_S = 0.2
"""Between two transforms that are farther apart in time, nothing is known."""


def frame_name(name: str) -> str:
    """The name of a frame without the slash that ROS 1 began it with."""
    return str(name).lstrip("/")


def rigid_of(position: Any, orientation: Any) -> Transform | None:
    """The rigid transform of a message's position (x, y, z) and orientation; None when it is not one."""
    try:
        return from_quaternion_xyzw(
            np.array([orientation.x, orientation.y, orientation.z, orientation.w], float),
            np.array([position.x, position.y, position.z], float),
        )
    except DataError:
        return None


@dataclass
class _Edge:
    """The transforms from a frame to its parent, with their times."""

    parent: str
    is_static: bool
    times_s: list[float] = field(default_factory=list)
    parent_from_child: list[Transform] = field(default_factory=list)


class FrameTree:
    """All transforms of a bag."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Any, *, is_static: bool) -> None:
        """Take in a TFMessage; transforms that are not rigid are left out."""
        for one in message.transforms:
            found = rigid_of(one.transform.translation, one.transform.rotation)
            child, parent = frame_name(one.child_frame_id), frame_name(one.header.frame_id)
            if found is None or child == parent:
                continue
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent:
                edge = self._edges[child] = _Edge(parent, is_static)
            edge.times_s.append(one.header.stamp.sec + one.header.stamp.nanosec * 1e-9)
            edge.parent_from_child.append(found)

    def root(self, frame: str) -> str:
        """The frame at the root of the tree that holds a frame."""
        return self._way_up(frame)[-1]

    def fixed(self, to: str, source: str) -> Transform | None:
        """`to_from_source`, where all transforms between the two stay the same; None where they do not."""
        found = self.at(to, source, np.zeros(1), fixed=True)
        return found[0]

    def at(
        self, to: str, source: str, times_s: Float64[np.ndarray, " n"], *, fixed: bool = False
    ) -> list[Transform | None]:
        """`to_from_source` at each time; None where a transform is not known then.

        Args:
            to, source: names of frames.
            times_s: times in any order.
            fixed: use only transforms that never change.
        """
        up, down = self._way_up(source), self._way_up(to)
        meeting = next((frame for frame in up if frame in down), None)
        if meeting is None:
            return [None] * len(times_s)
        first = self._climb(up[: up.index(meeting)], times_s, fixed)
        second = self._climb(down[: down.index(meeting)], times_s, fixed)
        return [
            None if one is None or other is None else invert(other) @ one
            for one, other in zip(first, second, strict=True)
        ]

    def _way_up(self, frame: str) -> list[str]:
        """A frame, its parent, and so on to the root."""
        way = [frame]
        while way[-1] in self._edges and self._edges[way[-1]].parent not in way:
            way.append(self._edges[way[-1]].parent)
        return way

    def _climb(
        self, frames: Sequence[str], times_s: Float64[np.ndarray, " n"], fixed: bool
    ) -> list[Transform | None]:
        """From the first frame to the parent of the last one, at each time."""
        result: list[Transform | None] = [np.eye(4)] * len(times_s)
        for frame in frames:
            steps = self._along(self._edges[frame], times_s, fixed)
            result = [
                None if before is None or step is None else step @ before
                for before, step in zip(result, steps, strict=True)
            ]
        return result

    def _along(self, edge: _Edge, times_s: Float64[np.ndarray, " n"], fixed: bool) -> list[Transform | None]:
        poses = np.array(edge.parent_from_child)
        if edge.is_static or np.ptp(poses, axis=0).max() < 1e-9:  # ROS 1 repeats fixed ones on /tf
            return [poses[-1]] * len(times_s)
        if fixed:
            return [None] * len(times_s)
        times = np.array(edge.times_s)
        order = np.argsort(times, kind="stable")
        return interpolated(times[order], poses[order], times_s, max_gap_s=MAX_GAP_S)

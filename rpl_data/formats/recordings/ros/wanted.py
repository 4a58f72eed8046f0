"""Which topics of a bag a person wants; in a module of its own, so that the command line loads quickly."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Topics:
    """Topics of a ROS bag to use; those left out are found by their names.

    Attributes:
        color: of the colour images.
        depth: of the depth images.
        color_info: of the camera of the colour images.
        depth_info: of the camera of the depth images.
        poses: of camera poses: /tf, or a topic of Odometry, PoseStamped, TransformStamped or Path. None are
            used when it is left out.
        frame: frame in which poses from /tf are wanted; the root of its tree when left out.
    """

    color: str | None = None
    depth: str | None = None
    color_info: str | None = None
    depth_info: str | None = None
    poses: str | None = None
    frame: str | None = None

"""Measure how near the views of a split are to those of training: views that training saw prove little."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from rpl_data import directions
from rpl_data.export.split import FrameKey, SplitName
from rpl_data.types import InstanceLabel


@dataclass(frozen=True)
class ViewDirection:
    """The direction from which an object is seen in a frame.

    Attributes:
        direction_object: unit vector from the object's origin to the camera, object frame.
    """

    object: str
    frame: FrameKey
    timestamp_s: float
    direction_object: Float64[np.ndarray, "3"]


@dataclass(frozen=True)
class ViewDistance:
    """Distance from the views of a split to the nearest training view of the same object.

    Attributes:
        views: number of views compared.
        angle_median_deg, angle_p90_deg: angle between viewing directions in the object frame, over all
            scenes.
        time_median_s, time_p90_s: time difference within the same scene; None where no scene is shared.
    """

    views: int
    angle_median_deg: float
    angle_p90_deg: float
    time_median_s: float | None
    time_p90_s: float | None


def view_direction(frame: FrameKey, timestamp_s: float, instance: InstanceLabel) -> ViewDirection:
    """Compute the view of a labelled instance."""
    return ViewDirection(
        instance.object, frame, timestamp_s, directions.view_direction(instance.camera_from_object)
    )


def view_distances(
    views: Sequence[ViewDirection], splits: Mapping[FrameKey, SplitName]
) -> dict[SplitName, ViewDistance]:
    """Distances of val's and test's views from those of training; splits without any are absent."""
    train = [view for view in views if splits[view.frame] == "train"]
    names: tuple[SplitName, ...] = ("val", "test")
    distances = {}
    for name in names:
        others = [view for view in views if splits[view.frame] == name]
        angles, times = nearest_angles_deg(others, train), nearest_times_s(others, train)
        if len(angles):
            distances[name] = ViewDistance(
                views=len(angles),
                angle_median_deg=float(np.median(angles)),
                angle_p90_deg=float(np.percentile(angles, 90)),
                time_median_s=float(np.median(times)) if len(times) else None,
                time_p90_s=float(np.percentile(times, 90)) if len(times) else None,
            )
    return distances


def nearest_angles_deg(
    views: Sequence[ViewDirection], train: Sequence[ViewDirection]
) -> Float64[np.ndarray, " n"]:
    """Angle from each view to the nearest training view of its object; views without one are left out."""
    from scipy.spatial import cKDTree

    angles = [np.zeros(0)]
    for name in sorted({view.object for view in train}):
        mine = [view.direction_object for view in views if view.object == name]
        if mine:
            tree = cKDTree(np.array([view.direction_object for view in train if view.object == name]))
            chords = tree.query(np.array(mine))[0]
            angles.append(np.degrees(2 * np.arcsin(np.clip(chords / 2, 0, 1))))
    return np.concatenate(angles)


def nearest_times_s(
    views: Sequence[ViewDirection], train: Sequence[ViewDirection]
) -> Float64[np.ndarray, " n"]:
    """Time from each view to the nearest training view of its object in its scene, where there is one."""
    known: dict[tuple[str, str], list[float]] = {}
    for view in train:
        known.setdefault((view.object, view.frame[0]), []).append(view.timestamp_s)
    sorted_times = {key: np.sort(times) for key, times in known.items()}
    gaps = []
    for view in views:
        times = sorted_times.get((view.object, view.frame[0]))
        if times is not None:
            after = int(np.searchsorted(times, view.timestamp_s))
            gaps.append(np.abs(times[max(0, after - 1) : after + 1] - view.timestamp_s).min())
    return np.array(gaps, dtype=float)

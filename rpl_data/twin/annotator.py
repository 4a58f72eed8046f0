"""A simulated person who clicks the landmarks of an object, and gets some of them wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.types import Click, FrameLabel, InstanceLabel, Intrinsics, Rle

SLIP_PX = 4
"""How far off the outline a click on the background lands."""
FARTHEST_SLIP_PX = 15.0
"""A keypoint farther than this from the outline is not taken for the background."""


@dataclass(frozen=True)
class Mistakes:
    """What a person gets wrong besides the pixel; 0 switches each off.

    Attributes:
        missed: share of the clicks that are never made.
        swapped: share of the scenes in which two keypoints are taken for each other.
        slipped: share of the clicks that land on the background right beside the object.
    """

    missed: float = 0.0
    swapped: float = 0.0
    slipped: float = 0.0


NO_MISTAKES = Mistakes()


@dataclass(frozen=True)
class _View:
    """A keypoint as a frame shows it."""

    frame: int
    uv_px: Float64[np.ndarray, "2"]


def click(
    labels: Sequence[FrameLabel],
    object_name: str,
    *,
    intrinsics: Intrinsics,
    clicks_per_keypoint: int,
    noise_px: float,
    rng: np.random.Generator,
    mistakes: Mistakes = NO_MISTAKES,
) -> list[Click]:
    """Clicks of a scene: each keypoint in well-spread frames of those in which it is seen.

    Fewer clicks where a keypoint is seen in fewer frames. Keypoints closer to the image's border than
    the noise may reach are not clicked.

    Args:
        labels: the truth of the scene's frames.
        noise_px: standard deviation, each axis.
        mistakes: they have random numbers of their own: what is not mistaken stays where it was.
    """
    own = {label.frame: one for label in labels for one in label.instances if one.object == object_name}
    views = _clear_views(own, intrinsics, margin_px=4 * noise_px + 1)
    clicks = []
    for keypoint, seen in sorted(views.items()):
        for pick in _spread(rng, len(seen), clicks_per_keypoint):
            u, v = (seen[pick].uv_px + noise_px * rng.standard_normal(2)).tolist()
            clicks.append(Click(object_name, keypoint, labels[0].scene, seen[pick].frame, u, v))
    return _mistaken(clicks, own, mistakes, rng.spawn(1)[0])


def _clear_views(
    instances: dict[int, InstanceLabel], intrinsics: Intrinsics, *, margin_px: float
) -> dict[int, list[_View]]:
    """By keypoint, the frames in which it is seen and not near the border."""
    far = np.array([intrinsics.width, intrinsics.height]) - margin_px
    views: dict[int, list[_View]] = {}
    for frame, instance in instances.items():
        uv = instance.keypoints_px
        clear = (instance.visibility == 2) & (uv > margin_px).all(axis=1) & (uv < far).all(axis=1)
        for keypoint in np.flatnonzero(clear).tolist():
            views.setdefault(keypoint, []).append(_View(frame, uv[keypoint]))
    return views


def _spread(rng: np.random.Generator, count: int, wanted: int) -> list[int]:
    """One random position in each of `wanted` equal parts of 0 .. count - 1."""
    if count <= wanted:
        return list(range(count))
    bounds = np.linspace(0, count, wanted + 1).astype(int)
    return [int(rng.integers(low, high)) for low, high in zip(bounds, bounds[1:], strict=False)]


# Mistakes -----------------------------------------------------------------------------------------


def _mistaken(
    clicks: list[Click], instances: dict[int, InstanceLabel], mistakes: Mistakes, rng: np.random.Generator
) -> list[Click]:
    """The clicks of a scene as somebody careless makes them."""
    missed, slipped = rng.random((2, len(clicks)))
    clicks = [
        _beside(one, instances[one.frame].mask_full) if slip < mistakes.slipped else one
        for one, slip, miss in zip(clicks, slipped, missed, strict=True)
        if miss >= mistakes.missed
    ]
    keypoints = sorted({one.keypoint for one in clicks})
    if len(keypoints) >= 2 and rng.random() < mistakes.swapped:
        a, b = rng.choice(keypoints, 2, replace=False).tolist()
        other = {a: b, b: a}
        clicks = [replace(one, keypoint=other.get(one.keypoint, one.keypoint)) for one in clicks]
    return clicks


def _beside(one: Click, mask_full: Rle) -> Click:
    """The click moved off the object by the shortest way; unmoved in the middle of it."""
    from pycocotools import mask as coco_mask

    reach = np.ones((2 * SLIP_PX + 1, 2 * SLIP_PX + 1), np.uint8)
    rows, columns = np.nonzero(cv2.dilate(coco_mask.decode({**mask_full}), reach) == 0)
    distance_px = np.hypot(columns - one.u_px, rows - one.v_px)
    if distance_px.min(initial=np.inf) > FARTHEST_SLIP_PX:
        return one
    nearest = int(distance_px.argmin())
    return replace(one, u_px=float(columns[nearest]), v_px=float(rows[nearest]))

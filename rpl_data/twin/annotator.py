"""A simulated annotator, who clicks the landmarks of an object and makes some mistakes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.types import Click, FrameLabel, InstanceLabel, Intrinsics, Rle
from rpl_data.types.instances import placed_as

SLIP_PX = 4
"""Distance from the outline at which a click on the background lands."""
FARTHEST_SLIP_PX = 15.0
"""A keypoint farther than this from the outline is never clicked on the background."""


@dataclass(frozen=True)
class Mistakes:
    """Mistakes that the annotator makes besides pixel noise; 0 switches each off.

    Attributes:
        missed: share of the clicks that are left out.
        swapped: share of the scenes in which two keypoints are mistaken for each other.
        slipped: share of the clicks that land on the background right beside the object.
    """

    missed: float = 0.0
    swapped: float = 0.0
    slipped: float = 0.0


NO_MISTAKES = Mistakes()


@dataclass(frozen=True)
class _Sighting:
    """A keypoint that is visible in a frame, and where."""

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
    instance: str = "",
    same_frames: bool = False,
) -> list[Click]:
    """Make the clicks of a scene: each keypoint in well-spread frames among those that show it.

    A keypoint seen in fewer frames gets fewer clicks. Keypoints so close to the image's border that the noise
    could reach it are not clicked.

    Args:
        labels: the true labels of the scene's frames.
        noise_px: standard deviation of a click, per axis.
        instance: which instance of the object is clicked.
        same_frames: all keypoints are clicked in the same frames, those that show most of them.
        mistakes: drawn from random numbers of their own, so that all other clicks stay the same.
    """
    key = object_name, instance
    own = {label.frame: i for label in labels for i in label.instances if (i.object, i.instance) == key}
    place = placed_as(labels[0].scene, instance)
    sightings = _clear_sightings(own, intrinsics, margin_px=4 * noise_px + 1)
    if same_frames:
        sightings = _in_best_frames(sightings, clicks_per_keypoint)
    clicks = []
    for keypoint, seen in sorted(sightings.items()):
        for pick in _spread(rng, len(seen), clicks_per_keypoint):
            u, v = (seen[pick].uv_px + noise_px * rng.standard_normal(2)).tolist()
            clicks.append(Click(object_name, keypoint, place, seen[pick].frame, u, v))
    return _mistaken(clicks, own, mistakes, rng.spawn(1)[0])


def _clear_sightings(
    instances: dict[int, InstanceLabel], intrinsics: Intrinsics, *, margin_px: float
) -> dict[int, list[_Sighting]]:
    """Collect, for each keypoint, the frames in which it is visible and not near the border."""
    far = np.array([intrinsics.width, intrinsics.height]) - margin_px
    sightings: dict[int, list[_Sighting]] = {}
    for frame, instance in instances.items():
        uv = instance.keypoints_px
        clear = (instance.visibility == 2) & (uv > margin_px).all(axis=1) & (uv < far).all(axis=1)
        for keypoint in np.flatnonzero(clear).tolist():
            sightings.setdefault(keypoint, []).append(_Sighting(frame, uv[keypoint]))
    return sightings


def _in_best_frames(sightings: dict[int, list[_Sighting]], count: int) -> dict[int, list[_Sighting]]:
    """What is seen in the frame with most keypoints of each of `count` equal parts of the video."""
    shown = Counter(one.frame for seen in sightings.values() for one in seen)
    parts = np.array_split(sorted(shown), count)
    best = {max(part.tolist(), key=lambda frame: shown[frame]) for part in parts if len(part)}
    return {keypoint: [one for one in seen if one.frame in best] for keypoint, seen in sightings.items()}


def _spread(rng: np.random.Generator, count: int, wanted: int) -> list[int]:
    """Draw one random position in each of `wanted` equal parts of 0 .. count - 1."""
    if count <= wanted:
        return list(range(count))
    bounds = np.linspace(0, count, wanted + 1).astype(int)
    return [int(rng.integers(low, high)) for low, high in zip(bounds, bounds[1:], strict=False)]


# Mistakes -----------------------------------------------------------------------------------------


def _mistaken(
    clicks: list[Click], instances: dict[int, InstanceLabel], mistakes: Mistakes, rng: np.random.Generator
) -> list[Click]:
    """Change the clicks of a scene into those that a careless annotator makes."""
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
    """Move the click off the object by the shortest way; unmoved when it is far from the outline."""
    from pycocotools import mask as coco_mask

    reach = np.ones((2 * SLIP_PX + 1, 2 * SLIP_PX + 1), np.uint8)
    rows, columns = np.nonzero(cv2.dilate(coco_mask.decode({**mask_full}), reach) == 0)
    distance_px = np.hypot(columns - one.u_px, rows - one.v_px)
    if distance_px.min(initial=np.inf) > FARTHEST_SLIP_PX:
        return one
    nearest = int(distance_px.argmin())
    return replace(one, u_px=float(columns[nearest]), v_px=float(rows[nearest]))

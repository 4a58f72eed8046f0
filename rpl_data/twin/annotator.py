"""A simulated person who clicks the landmarks of an object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.types import Click, FrameLabel, Intrinsics


def click(
    labels: Sequence[FrameLabel],
    object_name: str,
    *,
    intrinsics: Intrinsics,
    clicks_per_keypoint: int,
    noise_px: float,
    rng: np.random.Generator,
) -> list[Click]:
    """Clicks of a scene: each keypoint in well-spread frames of those in which it is seen.

    Fewer clicks where a keypoint is seen in fewer frames. Keypoints closer to the image's border than
    the noise may reach are not clicked.

    Args:
        labels: the truth of the scene's frames.
        noise_px: standard deviation, each axis.
    """
    margin_px = 4 * noise_px + 1
    clicks = []
    seen: dict[int, list[tuple[int, float, float]]] = {}
    for label in labels:
        for instance in label.instances:
            if instance.object != object_name:
                continue
            for number, ((u, v), state) in enumerate(
                zip(instance.keypoints_px, instance.visibility, strict=True)
            ):
                clear = (
                    margin_px < u < intrinsics.width - margin_px
                    and margin_px < v < intrinsics.height - margin_px
                )
                if state == 2 and clear:
                    seen.setdefault(number, []).append((label.frame, u, v))
    for number, frames in sorted(seen.items()):
        for pick in _spread(rng, len(frames), clicks_per_keypoint):
            frame, u, v = frames[pick]
            du, dv = noise_px * rng.standard_normal(2)
            clicks.append(Click(object_name, number, labels[0].scene, frame, u + du, v + dv))
    return clicks


def _spread(rng: np.random.Generator, count: int, wanted: int) -> list[int]:
    """One random position in each of `wanted` equal parts of 0 .. count - 1."""
    if count <= wanted:
        return list(range(count))
    bounds = np.linspace(0, count, wanted + 1).astype(int)
    return [int(rng.integers(low, high)) for low, high in zip(bounds, bounds[1:], strict=False)]

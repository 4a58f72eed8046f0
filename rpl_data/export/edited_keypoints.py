"""Keypoints of an exported COCO file that was edited with another program: which of them moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.json_arrays import Json, number

DECIMALS = (0, 1, 2, 3, 4)
"""With which programs write keypoints (we do with 4): ours rounded to so many have not moved."""
BESIDE_PX = 1.0
"""A keypoint may lie beside the image by as much as programs round."""

Orders = tuple[Sequence[str], Sequence[str]]
"""Keypoint names of an object: in the file's order, and in ours."""


def _points(annotation: Json, count: int) -> list[tuple[float, float, int]]:
    """u, v and visibility per keypoint; u = v = 0 where it is not labelled."""
    flat = [number(value) for value in annotation["keypoints"]]
    if len(flat) != 3 * count or any(seen not in (0, 1, 2) for seen in flat[2::3]):
        raise ValueError(f"its keypoints are not x, y and v = 0, 1 or 2 for each of {count}")
    triples = zip(flat[::3], flat[1::3], flat[2::3], strict=True)
    return [(u, v, int(seen)) if seen else (0.0, 0.0, 0) for u, v, seen in triples]


def moved_keypoints(
    edited: Json, own: Json, order: Orders, size: tuple[int, int], distances_px: list[float]
) -> dict[str, tuple[float, float, int]]:
    """The keypoints that moved, or whose visibility changed; none where a program dropped them all.

    Args:
        edited, own: an annotation of the edited file, and ours.
        size: height and width of the image.
        distances_px: takes how far each keypoint moved that has a position before and after.

    Raises:
        ValueError: a keypoint is damaged, or lies outside of the image.
    """
    if not edited.get("keypoints"):
        return {}
    count, moved = len(order[0]), {}
    before = dict(zip(order[1], _points(own, count), strict=True))
    for name, point in zip(order[0], _points(edited, count), strict=True):
        if point[2] == before[name][2] and all(map(_is_rounded, point[:2], before[name][:2])):
            continue
        distance = float(np.hypot(point[0] - before[name][0], point[1] - before[name][1]))
        if point[2] and not _is_near(point, size):
            raise ValueError(
                f"its keypoint {name} at ({point[0]:g}, {point[1]:g}) lies outside of the image, which has "
                f"{size[1]} x {size[0]} pixels; move it into the image, or set its v to 0"
            )
        moved[name] = point
        if point[2] and before[name][2]:
            distances_px.append(distance)
    return moved


def _is_near(point: tuple[float, float, int], size: tuple[int, int]) -> bool:
    """Whether a keypoint lies in the image, or beside it by no more than programs round."""
    return all(
        -BESIDE_PX <= value <= side + BESIDE_PX for value, side in zip(point[:2], size[::-1], strict=True)
    )


def _is_rounded(value: float, own: float) -> bool:
    """Whether a number is ours, written with fewer decimals."""
    return any(
        abs(value - own) <= 0.5 * 10.0**-digits + 1e-6 and abs(value - round(value, digits)) < 1e-6
        for digits in DECIMALS
    )

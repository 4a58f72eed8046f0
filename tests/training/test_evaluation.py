"""Whose estimate is whose, where an image shows an object twice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from rpl_data.types import InstanceLabel, Rle, SquareBox
from training.pose.evaluation import _seen_of
from training.pose.pipeline import PosePipeline, SeenKeypoints

IMAGE = np.zeros((4, 4, 3), dtype=np.uint8)
RLE = Rle(size=[4, 4], counts="0")
LEFT = InstanceLabel(
    "cup", np.eye(4), np.array([[10.0, 10.0]]), np.array([2]), np.array([1.0]), SquareBox(10.0, 10.0, 8.0),
    (6.0, 6.0, 14.0, 14.0), (6.0, 6.0, 14.0, 14.0), RLE, RLE, 1.0, False, 1.0,
)  # fmt: skip
RIGHT = replace(LEFT, keypoints_px=np.array([[50.0, 10.0]]), square_box=SquareBox(50.0, 10.0, 8.0))


@dataclass
class AtTheMiddle:
    """Sees the keypoint in the middle of a crop, as a network does that is right; its detector finds one."""

    detected: np.ndarray

    def see(
        self, image: np.ndarray, squares_px: Mapping[str, np.ndarray] | None = None
    ) -> list[SeenKeypoints]:
        squares = {"cup": self.detected} if squares_px is None else squares_px
        return [seen_at(name, np.asarray(square)) for name, square in squares.items()]


def seen_at(name: str, square: np.ndarray) -> SeenKeypoints:
    return SeenKeypoints(name, square, 1.0, square[None, :2], np.ones(1), np.eye(2)[None])


def seen(crops: Any) -> list[SeenKeypoints | None]:
    pipeline = cast(PosePipeline, AtTheMiddle(np.array([49.0, 11.0, 8.0])))
    return _seen_of(pipeline, IMAGE, [LEFT, RIGHT], crops)


def test_each_instance_is_seen_in_its_own_crop() -> None:
    left, right = seen("given")
    assert left is not None and right is not None
    assert (left.positions_px == LEFT.keypoints_px).all() and (right.positions_px == RIGHT.keypoints_px).all()


def test_the_one_detection_counts_for_the_nearest_instance() -> None:
    left, right = seen("detected")
    assert left is None and right is not None

"""Average precision of keypoints by object keypoint similarity (OKS), as COCO counts it.

Definitions: https://cocodataset.org/#keypoints-eval and `cocoeval.py` of pycocotools, with which this agrees
for objects of any size (`areaRng` all) and up to 20 detections per image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import Pixels

SIGMA = 0.05
"""How far a person's click on a keypoint strays, in square roots of the object's area. COCO has measured one
per joint of people, 0.025 to 0.107; for keypoints of objects nobody has."""
THRESHOLDS = np.linspace(0.5, 0.95, 10)
RECALLS = np.linspace(0, 1, 101)
MOST_DETECTIONS = 20

Similarities = Float64[np.ndarray, "detections truths"]


@dataclass(frozen=True)
class SeenInImage:
    """Detections of one object in one image, beside the truth.

    Attributes:
        scores: confidence of each detection.
        similarity: OKS of each detection and each true instance.
    """

    scores: Float64[np.ndarray, " detections"]
    similarity: Similarities


def oks(
    found_px: Pixels,
    true_px: Pixels,
    visibility: Int64[np.ndarray, " k"],
    *,
    area_px: float,
    sigma: float = SIGMA,
) -> float:
    """Object keypoint similarity of two sets of keypoints, 0 to 1; NaN where no keypoint is labelled.

    Args:
        found_px, true_px: k x 2.
        visibility: COCO's, of the true ones; where it is 0, the keypoint does not count.
        area_px: of the object's visible mask.
        sigma: of each keypoint.
    """
    known = visibility > 0
    if not known.any():
        return float("nan")
    squared = ((found_px[known] - true_px[known]) ** 2).sum(axis=1)
    return float(np.exp(-squared / (2 * (2 * sigma) ** 2 * (area_px + np.spacing(1)))).mean())


def average_precision(
    images: Sequence[SeenInImage], thresholds: Float64[np.ndarray, " t"] = THRESHOLDS
) -> float:
    """Mean over thresholds of the average precision; NaN without true instances."""
    if not sum(image.similarity.shape[1] for image in images):
        return float("nan")
    return float(np.mean([_precision_at(images, threshold) for threshold in thresholds]))


def _precision_at(images: Sequence[SeenInImage], threshold: float) -> float:
    """Area under precision over recall, precision made monotonous and taken at 101 recalls."""
    truths = sum(image.similarity.shape[1] for image in images)
    scores, right = (
        np.concatenate(parts) for parts in zip(*(_matched(i, threshold) for i in images), strict=True)
    )
    hits = np.cumsum(right[np.argsort(-scores, kind="mergesort")])
    precision = hits / np.arange(1, len(hits) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    at = np.searchsorted(hits / truths, RECALLS, side="left")
    return float(np.append(precision, 0.0)[np.minimum(at, len(precision))].mean())


def _matched(
    image: SeenInImage, threshold: float
) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, " d"]]:
    """Scores of the detections, the surest first, and 1 for each that has a true instance of its own."""
    order = np.argsort(-image.scores, kind="mergesort")[:MOST_DETECTIONS]
    free = np.ones(image.similarity.shape[1], dtype=np.bool_)
    right = np.zeros(len(order))
    for place, row in enumerate(order):
        likeness = np.where(free, image.similarity[row], -1.0)
        if len(likeness) and likeness.max() >= threshold:
            free[likeness.argmax()] = False
            right[place] = 1
    return image.scores[order], right

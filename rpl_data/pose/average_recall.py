"""What share of poses is right: the recalls of the BOP benchmark, and the area under the curve of ADD.

Rules: `pose_matching.py` and `eval_bop19_pose.py` of https://github.com/thodan/bop_toolkit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

SHARES = np.arange(0.05, 0.51, 0.05)
"""Thresholds of VSD, and of MSSD in diameters."""
PIXELS = np.arange(5.0, 51.0, 5.0)
"""Thresholds of MSPD, in pixels of an image that is 640 px wide."""
ADD_AUC_M = 0.1
"""Where the curve of ADD ends: Xiang et al., "PoseCNN", RSS 2018."""

Errors = Float64[np.ndarray, "estimates targets"]


@dataclass(frozen=True)
class Answers:
    """What was estimated for one object in one image.

    Attributes:
        scores: confidence of each estimate.
        errors: error of each estimate relative to each target; infinite = no pose.
    """

    scores: Float64[np.ndarray, " estimates"]
    errors: Errors


def found(answers: Answers, threshold: float) -> int:
    """How many targets have an estimate whose error is below the threshold.

    As many estimates count as there are targets, the surest first; each takes the nearest target that is
    still free.
    """
    targets = answers.errors.shape[1]
    free = np.ones(targets, dtype=np.bool_)
    for row in np.argsort(-answers.scores, kind="stable")[:targets]:
        errors = np.where(free, answers.errors[row], np.inf)
        if errors.min(initial=np.inf) < threshold:
            free[errors.argmin()] = False
    return int((~free).sum())


def recall(answers: Sequence[Answers], threshold: float) -> float:
    """Share of the targets of all images that are found; 0 where there are none."""
    targets = sum(each.errors.shape[1] for each in answers)
    return sum(found(each, threshold) for each in answers) / targets if targets else 0.0


def average_recall(answers: Sequence[Answers], thresholds: Float64[np.ndarray, " t"]) -> float:
    """Mean recall over thresholds."""
    return float(np.mean([recall(answers, threshold) for threshold in thresholds]))


def add_auc(add_m: Float64[np.ndarray, " n"], *, farthest_m: float = ADD_AUC_M) -> float:
    """Area under the curve of the share of poses over the ADD that is allowed, up to 0.1 m; 0 to 1.

    The exact area under the steps. YCB-Video's own script takes each step at its upper end, which is more by
    at most 1 / n.
    """
    return float(np.clip(1 - add_m / farthest_m, 0, 1).mean()) if len(add_m) else float("nan")

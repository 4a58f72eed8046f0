"""A measured error curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Curve:
    """The mean 3D error of one object: one row per seed, one column per value of x.

    Attributes:
        against: `keypoints` (the first x landmarks of the one ordered list) or `scenes`.
        other: how many scenes (or keypoints) were used: the paper's N_s = 8 (or N_k = 9), or all of fewer.
        x: numbers of keypoints or of scenes.
        error_mm: NaN where the clicks of that seed did not tie the scenes together.
    """

    object: str
    against: Literal["keypoints", "scenes"]
    other: int
    x: tuple[int, ...]
    error_mm: tuple[tuple[float, ...], ...]

    @property
    def failed(self) -> int:
        """Seeds and values of x for which there was no answer."""
        return sum(value != value for row in self.error_mm for value in row)

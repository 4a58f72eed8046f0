"""What a trained network said of an object in a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True)
class NetworkView:
    """Where a trained network sees an object in a scene, by the frames that agree.

    Attributes:
        looked: frames that it was shown.
        found: frames in which it gave a pose.
        frames: those whose poses agree; empty when too few do.
        off_m: how far the pose of each of them is from their middle: distance of the keypoints, root mean
            square.
        scene_from_object: the middle, metres; None when too few frames agree.
        points_object: the keypoints that the network was trained with, in the frame of its labels.
        network: the checkpoint.
    """

    looked: int
    found: int
    frames: tuple[int, ...]
    off_m: tuple[float, ...]
    scene_from_object: Float64[np.ndarray, "4 4"] | None
    points_object: Float64[np.ndarray, "k 3"]
    network: str

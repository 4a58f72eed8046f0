"""A reading of the clicks with its fit, and what may explain that it does not fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.motions import transform_each
from rpl_data.solve.click_rays import NEAREST_DEPTH_M, Rays
from rpl_data.solve.refit import Fit, Reading, refit

Kind = Literal["wrong place", "swapped", "wrong name", "whole scene"]

Clicks = Int64[np.ndarray, " _"]
"""Numbers of clicks, in the order of the observations."""

Placements = Mapping[tuple[int, int], Clicks]
"""By (scene, keypoint), all clicks that place one keypoint in one scene."""


@dataclass(frozen=True)
class Explanation:
    """One mistake of a person, and how much better everything fits when it is undone.

    Attributes:
        clicks: the wrong clicks.
        meant: for `swapped` and `wrong name`, the keypoint that each of them was meant for.
        gain: fall of the cost when it is undone.
        mirrored: for `whole scene`, whether its mirror image fits all other scenes.
    """

    kind: Kind
    scene: int
    keypoints: tuple[int, ...]
    clicks: tuple[int, ...]
    meant: tuple[int, ...] = ()
    gain: float = 0.0
    mirrored: bool = False


@dataclass(frozen=True)
class Fault:
    """The best explanation of a contradiction, and the others that explain it about as well."""

    best: Explanation
    rivals: tuple[Explanation, ...] = ()


@dataclass(frozen=True)
class Trial:
    """A reading of the clicks and its fit.

    Attributes:
        go_on: called before each further fit; what it raises ends the work.
    """

    rays: Rays
    reading: Reading
    fit: Fit
    go_on: Callable[[], None] = lambda: None

    def placements(self) -> dict[tuple[int, int], Clicks]:
        """The clicks in use by scene and keypoint."""
        found: dict[tuple[int, int], list[int]] = {}
        for click in np.flatnonzero(self.reading.ray_used):
            key = int(self.rays.scene[click]), int(self.reading.keypoint[click])
            found.setdefault(key, []).append(int(click))
        return {key: np.array(clicks) for key, clicks in found.items()}

    def miss_px(
        self,
        clicks: Clicks,
        keypoint: Clicks | None = None,
        scene_from_model: Float64[np.ndarray, "s 4 4"] | None = None,
    ) -> Float64[np.ndarray, " _"]:
        """Distance of clicks from the keypoints they are named for, or from others, in pixels."""
        rays = self.rays
        poses = self.fit.scene_from_model if scene_from_model is None else scene_from_model
        named = rays.keypoint if keypoint is None else keypoint
        to_camera = rays.camera_from_scene[clicks] @ poses[rays.scene[clicks]]
        in_camera = transform_each(to_camera, self.fit.points_model[named[clicks]])
        xy = in_camera[:, :2] / np.maximum(in_camera[:, 2:], NEAREST_DEPTH_M)
        missed: Float64[np.ndarray, " _"] = (
            np.linalg.norm(xy - rays.xy[clicks], axis=1) / rays.pixel_rad[clicks]
        )
        return missed

    def read(self, reading: Reading, *starts: tuple[np.ndarray, np.ndarray]) -> Trial:
        """The fit of another reading: the best one from here and from the other starts."""
        self.go_on()
        here = (self.fit.scene_from_model, self.fit.points_model)
        fits = [
            refit(self.rays, reading, *start, sigma_px=self.fit.sigma_px, hold_points=self.fit.hold_points)
            for start in (here, *starts)
        ]
        return replace(self, reading=reading, fit=min(fits, key=lambda fit: fit.cost))


def undo(reading: Reading, explanation: Explanation) -> Reading:
    """The reading without the mistake."""
    keypoint, ray, depth = (column.copy() for column in reading)
    clicks = list(explanation.clicks)
    if explanation.meant:
        keypoint[clicks] = explanation.meant
    else:
        ray[clicks] = depth[clicks] = False
    return Reading(keypoint, ray, depth)

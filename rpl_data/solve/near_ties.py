"""What the clicks leave open: said in words, and as a wider covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.geometry import invert, rotation_angle_rad, transform
from rpl_data.solve.bundle_adjustment import State
from rpl_data.solve.search import Alternative

SAID_BELOW = 8.0
"""Excess cost (squared standard deviations) below which another answer is mentioned: odds of 1 in 50."""
SAID_BEYOND_M = 0.01
"""Answers that put the keypoints nearer than this (mean over the keypoints) need not be mentioned."""


def describe_near_ties(
    alternatives: Sequence[Alternative], state: State, scenes: Sequence[str], known: Bool[np.ndarray, " k"]
) -> dict[str, str]:
    """A line for each scene in which the object could stand elsewhere just as well, by its name."""
    lines: dict[str, str] = {}
    for one in alternatives:  # cheapest first
        offsets_m = _offsets_m(one, state, one.scene)[known]
        apart_m = float(np.linalg.norm(offsets_m, axis=1).mean())
        if scenes[one.scene] in lines or one.excess > SAID_BELOW or apart_m < SAID_BEYOND_M:
            continue
        turned = one.state.scene_from_model[one.scene] @ invert(state.scene_from_model[one.scene])
        turned_deg = np.degrees(rotation_angle_rad(turned[:3, :3]))
        lines[scenes[one.scene]] = (
            f"scene {scenes[one.scene]}: its clicks fit almost as well with the object "
            f"{1000 * apart_m:.0f} mm away and turned by {turned_deg:.0f} "
            "degrees; click one more keypoint there, or one of them again in a frame seen from another side"
        )
    return lines


def widened_for_near_ties(
    covariance: Float64[np.ndarray, "k 3 3"], alternatives: Sequence[Alternative], state: State, scene: int
) -> Float64[np.ndarray, "k 3 3"]:
    """The covariance of the keypoints in a scene, together with the chance that another answer is right.

    Every answer is as likely as its cost says, exp(-excess / 2); the second moment about the chosen one.
    """
    own = [one for one in alternatives if one.scene == scene]
    odds = np.exp([-one.excess / 2 for one in own])
    widened = covariance.copy()
    for one, share in zip(own, odds / (1 + odds.sum()), strict=True):
        offsets_m = _offsets_m(one, state, scene)
        widened += share * offsets_m[:, :, None] * offsets_m[:, None, :]
    return widened


def _offsets_m(one: Alternative, state: State, scene: int) -> Float64[np.ndarray, "k 3"]:
    """How far the alternative moves each keypoint in a scene, scene frame."""
    there = transform(one.state.scene_from_model[scene], one.state.points_model)
    offsets: Float64[np.ndarray, "k 3"] = there - transform(state.scene_from_model[scene], state.points_model)
    return offsets

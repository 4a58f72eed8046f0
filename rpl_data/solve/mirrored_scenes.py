"""Scenes that were clicked as if in a mirror.

In a scene with few keypoints one wrong click explains almost anything: those that remain can be made to fit.
So a mirror image (`mirror_image`) is tried as an explanation of its own. It drops no click. It is taken where
it explains all clicks as well as the mistakes that were found, each at the price of what it leaves free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rpl_data.geometry import transform
from rpl_data.solve.mirror_image import FEWEST_KEYPOINTS, Mirrored, mirrored_cost
from rpl_data.solve.refit import DEPTH_KERNEL_SIGMAS, unknowns_covariance
from rpl_data.solve.trial import Explanation, Trial, undo

FREE_DEPTH_COST = DEPTH_KERNEL_SIGMAS**2
"""What a depth costs that an explanation says nothing about, as much as one that does not fit at all."""
FREE_CLICK_COST = 15.0
"""What a click costs that may lie anywhere on the object: twice the logarithm of how much likelier the
normal density of a right click (2 px) is than an even one over an object of 200 px by 200 px."""
NAME_COST = 7.0
"""The same for a name among thirty or so that two keypoints or a click could have exchanged."""


def mirrored_scene(first: Trial, mended: Trial, *, enough: float, rival: float) -> Explanation | None:
    """The scene whose mirror image explains all clicks as well as the mistakes that were found.

    Args:
        first: every click at its word.
        mended: with the mistakes undone.
        enough: fall of the cost from which a scene contradicts all others.
        rival: explanations cannot be told apart whose costs differ by less. The mirror image is then
            preferred: to mark the scene again mends the other mistakes too.
    """
    lowest = min(mended.fit.cost + _cost_of_freedom(first, mended) + rival, first.fit.cost)
    best: Explanation | None = None
    for whole in _scenes(first):
        without = first.read(undo(first.reading, whole))
        gain = first.fit.cost - without.fit.cost
        if gain < enough:
            continue
        depths = np.isfinite(first.rays.depths_m[list(whole.clicks), 0]).sum()
        rest = without.fit.cost + FREE_DEPTH_COST * int(depths)
        cost = rest + mirrored_cost(_known_elsewhere(first, without, whole), most=lowest - rest)
        if cost < lowest:
            best, lowest = replace(whole, gain=gain), cost
    return best


def _scenes(trial: Trial) -> Iterator[Explanation]:
    """Every scene whose keypoints could tell a mirror image, as a mistake of its own."""
    for scene in range(len(trial.fit.scene_from_model)):
        clicks = np.flatnonzero(trial.rays.scene == scene)
        keypoints = tuple(np.unique(trial.reading.keypoint[clicks]).tolist())
        if len(keypoints) >= FEWEST_KEYPOINTS:
            yield Explanation("whole scene", scene, keypoints, tuple(clicks.tolist()), mirrored=True)


def _cost_of_freedom(first: Trial, mended: Trial) -> float:
    """What the mistakes that were found may be anything in: clicks without a place, and other names."""
    dropped = first.reading.ray_used & ~mended.reading.ray_used
    depths = dropped & np.isfinite(first.rays.depths_m[:, 0])
    renamed = (first.reading.keypoint != mended.reading.keypoint).any()
    return float(FREE_CLICK_COST * dropped.sum() + FREE_DEPTH_COST * depths.sum() + NAME_COST * renamed)


def _known_elsewhere(first: Trial, without: Trial, whole: Explanation) -> Mirrored:
    """The scene's clicks on keypoints that other scenes, or a known model, place."""
    fit, clicks = without.fit, np.array(whole.clicks)
    named = first.reading.keypoint[clicks]
    if fit.hold_points:
        known, covariance = np.unique(named), np.zeros((fit.points_model.size, fit.points_model.size))
    else:
        known = np.intersect1d(named, without.reading.keypoint[without.reading.ray_used])
        covariance = unknowns_covariance(fit)[-fit.points_model.size :, -fit.points_model.size :]
    shared = np.isin(named, known)
    coordinates = (3 * known[:, None] + np.arange(3)).ravel()
    middle = fit.points_model[known].mean(axis=0)
    return Mirrored(
        rays=first.rays.of(np.isin(np.arange(len(first.rays.scene)), clicks[shared])),
        column=np.searchsorted(known, named[shared]),
        points=fit.points_model[known],
        covariance=covariance[np.ix_(coordinates, coordinates)],
        centre=transform(first.fit.scene_from_model[whole.scene], middle),
        sigma_px=first.fit.sigma_px,
    )

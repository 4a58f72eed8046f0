"""A known object aligned to one more scene: its dense model held, the scene's surface registered on it.

The same registration as between scenes, with two "scenes": the model, which stands still, and the new one.
Few clicks leave the pose open by more than a registration can bridge, so it starts from several poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform, from_rotvec, invert, rotation_angle_rad, transform
from rpl_data.refine.evidence import (
    ClickCosts,
    Test,
    Verdict,
    cross_validated,
    disagreement,
    gains_sigmas,
    verdicts,
    without_surface,
)
from rpl_data.refine.registration import ClickTerms, Points, Poses, Registration, register_scenes
from rpl_data.refine.scene_surfaces import SceneSurface, scene_surface
from rpl_data.types import PointCloud

MODEL = "the dense model"
HELD = 1e10
"""Weight that holds the model still, per square metre and square radian: to 10 micrometres."""
NO_POINTS: Points = np.empty((0, 3))
BRIDGED_M = 0.008
"""Where the clicks leave the surface open by more than this (standard deviation), other starts are tried."""
SAME_M = 0.01
"""Poses that move the surface by less than this (root mean square) are the same answer."""
CLEAR_SIGMAS = 3.0
"""By how many standard errors the best answer must agree better than any other one."""


@dataclass(frozen=True)
class Alignment:
    """What became of the new scene.

    Attributes:
        scene_from_object: aligned where accepted, else as the clicks have it.
        normal: normal matrix of the pose (rotation, translation, applied on the left), of clicks and surface.
        verdict: what the held-out evidence says.
    """

    scene_from_object: Transform
    normal: Float64[np.ndarray, "6 6"]
    verdict: Verdict


class _Pair(NamedTuple):
    """The model, which stands still, and the scene; with the clicks' terms."""

    surfaces: list[SceneSurface | None]
    clicks: ClickTerms

    def registered(self, pose: Transform) -> Registration:
        return register_scenes(self.surfaces, beside_model(pose), NO_POINTS, self.clicks)

    def misfit(self, found: Registration, *, sigmas_of: Registration) -> float:
        """How much the scene's surface disagrees with the model, 0 to 1."""
        model, scene = self.surfaces
        assert model is not None and scene is not None
        return float(disagreement(scene, model, invert(found.scene_from_object[1]), sigmas_of)[0].mean())


def align_scene(
    model: PointCloud,
    region: PointCloud | None,
    starts: Sequence[Transform],
    clicks: ClickTerms,
    click_costs: ClickCosts,
) -> Alignment:
    """Align an object to what a scene shows of it, accepted where parts that were held out agree better.

    Args:
        model: the object's surface, object frame.
        region: its surface as the scene saw it, scene frame; None where the scene shows none.
        starts: `scene_from_object` by the clicks, then others that they fit almost as well.
        clicks: terms of the clicks in the scene, by its pose alone.
        click_costs: their cost.
    """
    held, start = _holding(clicks), beside_model(starts[0])
    by_clicks = held(start, NO_POINTS)[0][6:, 6:]
    if region is None:
        return Alignment(starts[0], by_clicks, without_surface(MODEL))
    pair = _Pair([scene_surface(model), scene_surface(region)], held)
    tried = [*starts, *_further_starts(starts[0], by_clicks, model)]
    found = [pair.registered(pose) for pose in tried]
    sharpest = min(found, key=lambda one: one.surface_sigma_m)
    best = min(range(len(found)), key=lambda n: pair.misfit(found[n], sigmas_of=sharpest))
    tests: list[Test] = cross_validated(pair.surfaces, beside_model(tried[best]), NO_POINTS, held)
    aligned = found[best].scene_from_object
    worse = click_costs(aligned[1:], NO_POINTS) - click_costs(start[1:], NO_POINTS)
    verdict = verdicts(gains_sigmas(tests, start)[1:], worse, compared_with=MODEL)[0]
    verdict = _against_rivals(verdict, pair, found, best, model)
    if not verdict.accepted:
        return Alignment(starts[0], by_clicks, verdict)
    return Alignment(aligned[1], found[best].normal[6:, 6:], verdict)


def beside_model(scene_from_object: Transform) -> Poses:
    """The poses of the model and of the scene."""
    return np.stack([np.eye(4), scene_from_object])


def _holding(clicks: ClickTerms) -> ClickTerms:
    """The clicks' terms beside a model that is held."""

    def held(poses: Poses, points: Points) -> tuple[np.ndarray, np.ndarray]:
        normal, gradient = np.zeros((12, 12)), np.zeros(12)
        normal[:6, :6] = HELD * np.eye(6)
        normal[6:, 6:], gradient[6:] = clicks(poses[1:], points)
        return normal, gradient

    return held


def _further_starts(
    pose: Transform, normal: Float64[np.ndarray, "6 6"], model: PointCloud
) -> list[Transform]:
    """Poses along the two motions that the clicks hold least, where these move the surface far."""
    centre = transform(pose, model.points.mean(axis=0)[None])[0]
    size_m = float(np.sqrt(((model.points - model.points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    about = np.eye(6)  # motions about the object's centre; turns in metres of its surface
    about[:3, :3] /= size_m
    about[3:, :3] = np.cross(centre, np.eye(3)).T @ about[:3, :3]
    held = about.T @ normal @ about
    value, motion = np.linalg.eigh(held + 1e-9 * np.trace(held) * np.eye(6))
    starts = []
    for weakest in (0, 1):
        sigma_m = 1 / np.sqrt(max(value[weakest], 1e-12))
        for times in (-2, -1, 1, 2) if sigma_m > BRIDGED_M else ():
            turn, shift = np.split(motion[:, weakest] * times * min(sigma_m, size_m), 2)
            starts.append(_turned_about(centre, turn / size_m, shift) @ pose)
    return starts


def _turned_about(
    centre: Float64[np.ndarray, "3"], turn_rad: Float64[np.ndarray, "3"], shift_m: Float64[np.ndarray, "3"]
) -> Transform:
    """The motion that turns about a point and then shifts, however far it turns."""
    turned = from_rotvec(turn_rad, np.zeros(3))
    turned[:3, 3] = centre - turned[:3, :3] @ centre + shift_m
    return turned


def _against_rivals(
    verdict: Verdict, pair: _Pair, found: Sequence[Registration], best: int, model: PointCloud
) -> Verdict:
    """The verdict, turned down when another answer agrees almost as well."""
    pose = found[best].scene_from_object[1]
    points = transform(pose, model.points)
    test = [Test(found[best], pair.surfaces)]
    for other in found:
        rival = other.scene_from_object[1]
        apart_m = np.sqrt(((transform(rival, model.points) - points) ** 2).sum(axis=1).mean())
        if apart_m < SAME_M or not verdict.accepted:
            continue
        clear = gains_sigmas(test, other.scene_from_object)[1]
        if clear < CLEAR_SIGMAS:
            turned_deg = np.degrees(rotation_angle_rad((rival @ invert(pose))[:3, :3]))
            reason = (
                f"its surface fits almost as well {1e3 * apart_m:.0f} mm away and turned by "
                f"{turned_deg:.0f} degrees; click one more keypoint"
            )
            return replace(verdict, accepted=False, reason=reason)
    return verdict

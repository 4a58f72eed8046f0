"""A known object placed in one more scene from its clicks there (paper section III-F)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import is_collinear
from rpl_data.motions import cross_matrices
from rpl_data.solve.bundle_adjustment import State, linearise
from rpl_data.solve.click_rays import Noise, Rays, rays_of
from rpl_data.solve.diagnosis import Placed, diagnose
from rpl_data.solve.hypotheses import hypotheses_of_scene
from rpl_data.solve.initial_guess import LINE_M
from rpl_data.solve.near_ties import SAID_BELOW, describe_near_ties, widened_for_near_ties
from rpl_data.solve.noise import (
    USUAL,
    adjust_with_noise,
    joint_covariance,
    points_in_scene_covariance,
)
from rpl_data.solve.refusals import refuse_bad
from rpl_data.solve.residuals import click_fit, click_residuals
from rpl_data.solve.scene_poses import likely_poses
from rpl_data.solve.search import Alternative
from rpl_data.types import (
    ClickResidual,
    DataError,
    KeypointModel,
    NextClick,
    Observation,
    Statement,
)
from rpl_data.types.keypoint_names import keypoint_titles
from rpl_data.wording import counted


class Registration(NamedTuple):
    """Where a known object stands in a scene, and how well that is known.

    Attributes:
        residuals: one per click, in their order.
        covariance_in_scene: one 3x3 covariance per keypoint of its position, in m^2, scene frame.
        statements, next_clicks: see `Solution`.
        alternatives: other poses that the clicks fit almost as well, the likeliest first.
        trajectory_sigma_m: how far the poses of the scene stray, which the covariance includes.
    """

    scene_from_object: Float64[np.ndarray, "4 4"]
    residuals: tuple[ClickResidual, ...]
    covariance_in_scene: Float64[np.ndarray, "k 3 3"]
    click_sigma_px: float
    depth_sigma_ratio: float
    statements: tuple[Statement, ...] = ()
    next_clicks: tuple[NextClick, ...] = ()
    alternatives: Float64[np.ndarray, "a 4 4"] = np.empty((0, 4, 4))
    trajectory_sigma_m: float = 0.0


def register(
    model: KeypointModel, observations: Sequence[Observation]
) -> tuple[Float64[np.ndarray, "4 4"], tuple[ClickResidual, ...]]:
    """`scene_from_object` of a new scene from clicks on a known model; see `register_scene`."""
    found = register_scene(model, observations)
    return found.scene_from_object, found.residuals


def register_scene(
    model: KeypointModel,
    observations: Sequence[Observation],
    *,
    covariance: Float64[np.ndarray, "k 3 3"] | None = None,
    click_sigma_px: float | None = None,
    depth_sigma_ratio: float | None = None,
    trajectory_sigma_m: float = 0.0,
) -> Registration:
    """Place a known object in a new scene from clicks on its keypoints.

    The cheapest of all poses that triples of clicks allow, refined with the model held fixed. Clicks on
    keypoints that the model has no position of are not used.

    Args:
        covariance: of the model's keypoints, in the object frame; exact when None.
        click_sigma_px, depth_sigma_ratio: the noise found when the model was solved: a few clicks alone
            hardly show it. The usual when None.
        trajectory_sigma_m: how far the poses of the scene stray, standard deviation per axis.

    Raises:
        DataError: fewer than three usable keypoints, or all on a line, or clicks that fit no pose.
    """
    refuse_bad(model.name, observations)
    scene = observations[0].click.scene
    candidates = {k: p for k, p in hypotheses_of_scene(observations).items() if model.known[k]}
    _refuse_few(model, scene, sorted({o.click.keypoint for o in observations}), sorted(candidates))
    usable = [o for o in observations if model.known[o.click.keypoint]]
    rays = rays_of(usable, [scene], {scene: trajectory_sigma_m})
    points = np.nan_to_num(model.points_object)
    poses = likely_poses(rays, points, candidates, known_poses=np.zeros((0, 4, 4)), samples=600)
    if not len(poses.cost):
        raise _fits_nowhere(model, scene)
    prior = Noise(click_sigma_px or USUAL.click_px, depth_sigma_ratio or USUAL.depth_ratio)
    states = [State(pose[None], points) for pose in poses.scene_from_model]
    state, noise = adjust_with_noise(rays, states[0], prior=prior, hold_points=True)
    excess = poses.cost - poses.cost[0]
    others = [Alternative(0, other, e) for other, e in zip(states[1:], excess[1:], strict=True)]
    joint = joint_covariance(rays, state, noise=noise, hold_points=True)
    in_scene = widened_for_near_ties(
        _covariance_in_scene(rays, state, noise, joint, model, covariance), others, state, 0
    )
    ties = describe_near_ties(others, state, [scene], model.known)
    strayed_m = {scene: trajectory_sigma_m}
    placed = Placed([scene], rays, state, noise, joint, {scene: in_scene}, model.known, ties, strayed_m)
    diagnosis = diagnose(usable, keypoint_titles(model.keypoints), placed, hold_points=True)
    fitted = iter(click_residuals(usable, click_fit(rays, state, noise), diagnosis.statements))
    return Registration(
        scene_from_object=state.scene_from_model[0],
        residuals=tuple(
            next(fitted) if model.known[o.click.keypoint] else _not_in_model(o, model) for o in observations
        ),
        covariance_in_scene=placed.stated_covariance(scene),
        click_sigma_px=noise.click_px,
        depth_sigma_ratio=noise.depth_ratio,
        statements=diagnosis.statements,
        next_clicks=diagnosis.next_clicks,
        alternatives=poses.scene_from_model[1:][excess[1:] < SAID_BELOW],
        trajectory_sigma_m=trajectory_sigma_m,
    )


def _fits_nowhere(model: KeypointModel, scene: str) -> DataError:
    return DataError(
        f"object {model.name}, scene {scene}: no three clicks fit the model within 15 mm: one is in the "
        "wrong place, or the depth there is that of what lies before or behind the keypoint; check them, "
        "and click one more keypoint"
    )


def _refuse_few(model: KeypointModel, scene: str, clicked: Sequence[int], usable: Sequence[int]) -> None:
    """DataError for fewer than three keypoints that can be used, or all on a line."""
    titles = keypoint_titles(model.keypoints)
    if len(usable) < 3:
        unknown = [titles[k] for k in clicked if not model.known[k]]
        deep = [titles[k] for k in clicked if model.known[k] and k not in usable]
        reasons = ((unknown, "without a position in the model"), (deep, "without depth at the click"))
        why = [f"{', '.join(names)} {what}" for names, what in reasons if names]
        raise DataError(
            f"object {model.name}, scene {scene}: {counted(len(clicked), 'keypoint')} clicked, {len(usable)} "
            f"can be used, at least 3 are needed{''.join(f'; {text}' for text in why)}; click more keypoints"
        )
    if is_collinear(model.points_object[usable], tolerance_m=LINE_M):
        raise DataError(
            f"object {model.name}, scene {scene}: keypoints {', '.join(titles[k] for k in usable)} "
            "lie on a line, about which the object could turn; click one more keypoint off that line"
        )


def _covariance_in_scene(
    rays: Rays,
    state: State,
    noise: Noise,
    joint: Float64[np.ndarray, "u u"],
    model: KeypointModel,
    covariance: Float64[np.ndarray, "k 3 3"] | None,
) -> Float64[np.ndarray, "k 3 3"]:
    """Of the keypoints in the scene: from the clicks there, and from the model that they are fitted to.

    A model that is off by e in its clicked keypoints turns the pose by -H e; so keypoint k is off by its own
    e_k, turned into the scene, less what the pose makes good of it.
    """
    by_clicks = points_in_scene_covariance(joint, state, 0, model.known)
    if covariance is None:
        return by_clicks
    system = linearise(rays, state, noise=noise)
    weighted = (system.root_weight[..., None] * system.jacobian).reshape(-1, system.jacobian.shape[2])
    normal = weighted.T @ weighted
    pose_by_points = np.linalg.solve(normal[:6, :6] + 1e-9 * np.diag(np.diag(normal[:6, :6])), normal[:6, 6:])
    pose = state.scene_from_model[0]
    in_scene = state.points_model @ pose[:3, :3].T + pose[:3, 3]
    total = by_clicks.copy()
    blocks = np.nan_to_num(covariance)
    for k in np.flatnonzero(model.known):
        by_pose = np.hstack([-cross_matrices(in_scene[k]), np.eye(3)])
        effect = -(by_pose @ pose_by_points).reshape(3, -1, 3)
        effect[:, k] += pose[:3, :3]
        total[k] += np.einsum("ina,nab,jnb->ij", effect, blocks, effect)
    return total


def _not_in_model(observation: Observation, model: KeypointModel) -> ClickResidual:
    """Of a click that could not be used."""
    title = keypoint_titles(model.keypoints)[observation.click.keypoint]
    reason = f"the model has no position of keypoint {title}"
    return ClickResidual(observation.click, 0.0, None, None, "none", outlier=False, reason=reason)

"""What became of every click and keypoint, in words for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.solve.bundle_adjustment import State, points_in_cameras
from rpl_data.solve.click_rays import KERNEL_SCALE_SIGMAS, Noise, Rays, misfit
from rpl_data.types import HINTS, Click, ClickResidual, DepthState, Observation, Statement


class ClickFit(NamedTuple):
    """How an answer fits every click, M in all.

    Attributes:
        error_px: distance of the click from the projected keypoint.
        depth_m: depth at the click of the candidate surface taken; NaN where there was none.
        depth_error_m: keypoint minus that surface, along the line of sight; 0 where there was none.
        depth_sigma_m: its standard deviation with the noise as estimated.
        sigma_px: standard deviation of a click, per axis.
    """

    scene_from_model: Float64[np.ndarray, "s 4 4"]
    points_model: Float64[np.ndarray, "k 3"]
    error_px: Float64[np.ndarray, " m"]
    depth_m: Float64[np.ndarray, " m"]
    depth_error_m: Float64[np.ndarray, " m"]
    depth_sigma_m: Float64[np.ndarray, " m"]
    sigma_px: float


def click_fit(rays: Rays, state: State, noise: Noise) -> ClickFit:
    """How an answer fits every click."""
    found = misfit(rays, points_in_cameras(rays, state))
    taken = rays.depths_m[np.arange(len(rays.xy)), found.surface]
    return ClickFit(
        *state,
        error_px=np.linalg.norm(found.error_px, axis=1),
        depth_m=np.where(found.surface >= 0, taken, np.nan),
        depth_error_m=found.depth_error_m,
        depth_sigma_m=noise.depth_ratio * found.depth_sigma_m,
        sigma_px=noise.click_px,
    )


def click_residuals(
    observations: Sequence[Observation], fit: ClickFit, statements: Sequence[Statement] = ()
) -> tuple[ClickResidual, ...]:
    """What became of every click, and what is said of it."""
    said: dict[Click, Statement] = {}
    for statement in sorted(statements, key=lambda s: s.blames):
        if statement.kind not in HINTS:
            said |= dict.fromkeys(statement.clicks, statement)
    return tuple(_residual(o, n, fit, said.get(o.click)) for n, o in enumerate(observations))


def _residual(observation: Observation, n: int, fit: ClickFit, said: Statement | None) -> ClickResidual:
    error_px, depth_m = float(fit.error_px[n]), float(fit.depth_m[n])
    state = _depth_state(observation, depth_m, float(fit.depth_error_m[n] / fit.depth_sigma_m[n]))
    used = state in ("agrees", "other surface")
    lateral_m = error_px * observation.pixel_rad * (depth_m if used else 0)
    return ClickResidual(
        click=observation.click,
        error_px=error_px,
        error_m=float(np.hypot(lateral_m, fit.depth_error_m[n])) if used else None,
        depth_m=depth_m if used else None,
        depth_state=state,
        outlier=said is not None and said.blames,
        reason="" if said is None else said.text,
    )


def _depth_state(observation: Observation, depth_m: float, error_in_sigmas: float) -> DepthState:
    if len(observation.depths_m) == 0:
        return "none"
    if abs(error_in_sigmas) > 2 * KERNEL_SCALE_SIGMAS:
        return "rejected"
    return "agrees" if depth_m == observation.depths_m[0] else "other surface"


def describe_keypoints(
    keypoints: Sequence[str], observations: Sequence[Observation], known: Bool[np.ndarray, " k"]
) -> tuple[str, ...]:
    """Lines about keypoints that have no position."""
    seen_in: dict[int, set[str]] = {k: set() for k in range(len(keypoints))}
    for o in observations:
        seen_in[o.click.keypoint].add(o.click.scene)
    lines = []
    for k, scenes in seen_in.items():
        if not scenes:
            lines.append(f"keypoint {keypoints[k]} was never clicked: it has no position and no label")
        elif not known[k]:
            lines.append(
                f"keypoint {keypoints[k]} was clicked, but neither depth nor other frames tell how far away "
                "it is: it has no position and no label; click it where there is depth, or from another side"
            )
    return tuple(lines)


def click_spreads_m(
    points_scene: Mapping[str, Float64[np.ndarray, "k 3"]], observations: Sequence[Observation]
) -> dict[tuple[str, int], float]:
    """How far the clicks of a keypoint lie apart over the frames of a scene, seen through its poses.

    Every click's ray misses the keypoint's position by a vector; the spread is the standard deviation of
    those, per axis. It holds the hand's error (2 px are 2 mm at 0.6 m) and the drift of the poses.

    Args:
        points_scene: positions of the keypoints by scene, scene frame; NaN where not known.

    Returns:
        By scene and keypoint, of those with clicks in two frames or more.
    """
    misses: dict[tuple[str, int], list[np.ndarray]] = {}
    for o in observations:
        scene, keypoint = o.click.scene, o.click.keypoint
        if scene not in points_scene or not np.isfinite(points_scene[scene][keypoint]).all():
            continue
        ray = o.scene_from_camera[:3, :3] @ o.ray_camera
        ray = ray / np.linalg.norm(ray)
        toward = points_scene[scene][keypoint] - o.scene_from_camera[:3, 3]
        misses.setdefault((scene, keypoint), []).append(toward - (toward @ ray) * ray)
    return {
        clicked: float(np.sqrt(np.var(found, axis=0, ddof=1).sum() / 2))
        for clicked, found in misses.items()
        if len(found) > 1
    }

"""What became of every click and keypoint, in words for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.solve.bundle_adjustment import LET_GO, Bundle
from rpl_data.types import Click, ClickResidual, DepthState, Observation, Statement


def click_residuals(
    observations: Sequence[Observation], bundle: Bundle, statements: Sequence[Statement] = ()
) -> tuple[ClickResidual, ...]:
    """What became of every click, and what is said of it."""
    said: dict[Click, Statement] = {}
    for statement in sorted(statements, key=lambda s: s.blames):
        if statement.kind not in ("unchecked", "weak scene"):
            said |= dict.fromkeys(statement.clicks, statement)
    return tuple(_residual(o, n, bundle, said.get(o.click)) for n, o in enumerate(observations))


def _residual(observation: Observation, n: int, bundle: Bundle, said: Statement | None) -> ClickResidual:
    error_px, depth_m = float(bundle.error_px[n]), float(bundle.depth_m[n])
    state = _depth_state(observation, depth_m, float(bundle.depth_error_m[n] / bundle.depth_sigma_m[n]))
    used = state in ("agrees", "other surface")
    lateral_m = error_px * observation.pixel_rad * (depth_m if used else 0)
    return ClickResidual(
        click=observation.click,
        error_px=error_px,
        error_m=float(np.hypot(lateral_m, bundle.depth_error_m[n])) if used else None,
        depth_m=depth_m if used else None,
        depth_state=state,
        outlier=said is not None and said.blames,
        reason="" if said is None else said.text,
    )


def _depth_state(observation: Observation, depth_m: float, error_in_sigmas: float) -> DepthState:
    if len(observation.depths_m) == 0:
        return "none"
    if abs(error_in_sigmas) > 2 * LET_GO:
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

    Every click's ray misses the keypoint's place by a vector; the spread is the standard deviation of
    those, on an axis. It holds the hand's error (2 px are 2 mm at 0.6 m) and the drift of the poses.

    Args:
        points_scene: places of the keypoints by scene, scene frame; NaN where not known.

    Returns:
        By scene and keypoint, of those with clicks in two frames or more.
    """
    misses: dict[tuple[str, int], list[np.ndarray]] = {}
    for o in observations:
        place = (o.click.scene, o.click.keypoint)
        if o.click.scene not in points_scene or not np.isfinite(points_scene[place[0]][place[1]]).all():
            continue
        ray = o.scene_from_camera[:3, :3] @ o.ray_camera
        ray = ray / np.linalg.norm(ray)
        toward = points_scene[place[0]][place[1]] - o.scene_from_camera[:3, 3]
        misses.setdefault(place, []).append(toward - (toward @ ray) * ray)
    return {
        place: float(np.sqrt(np.var(found, axis=0, ddof=1).sum() / 2))
        for place, found in misses.items()
        if len(found) > 1
    }

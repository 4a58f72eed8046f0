"""Scenes registered on one another: surfaces, print and clicks in one normal matrix.

    min over Q, T of  clicks(Q, T) + sum over pairs of scenes (a, b) and points p_a of
                      rho(n_b . (T_b T_a^-1 p_a - p_b)) + rho(print_b - print_a)

Point-to-plane both ways (Chen and Medioni 1992) and print along its gradient (Park, Zhou and Koltun, ICCV
2017), in a robust kernel, with a gate that shrinks as the scenes come together. The keypoints are unknowns
of the same system, held by the clicks' rays and depths, so that they move along.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.geometry import Transform, invert
from rpl_data.refine.scene_surfaces import Matches, SceneSurface, match, print_differences

GATES_M = (0.012, 0.008, 0.005, 0.004)
"""How far a counterpart may be, from the first pass to the last."""
STEPS = 10
"""Most Gauss-Newton steps per gate."""
STILL = 2e-5
"""Metres and radians: a smaller step ends a pass."""
INDEPENDENT_M = 0.02
"""Errors of a fused surface are alike within about this distance, so a patch of it counts once."""
KERNEL_SCALE_SIGMAS = 3.0
"""Scale of Geman-McClure's robust loss, in standard deviations."""
LEAST_SURFACE_SIGMA_M = 0.0008
LEAST_PRINT_SIGMA = 0.01
LEAST_MATCHES = 10
"""Two scenes that share fewer points are not compared."""

Poses = Float64[np.ndarray, "s 4 4"]
Points = Float64[np.ndarray, "k 3"]
ClickTerms = Callable[[Poses, Points], tuple[Float64[np.ndarray, "u u"], Float64[np.ndarray, " u"]]]
"""``clicks(scene_from_object, points_object)`` -> the normal matrix and the gradient of the clicks' cost by
the unknowns: 6 per scene (rotation, translation, applied on the left), then 3 per keypoint."""


class Registration(NamedTuple):
    """Where the scenes and the keypoints came to rest.

    Attributes:
        scene_from_object: one per scene; the object frame is that of the start, slightly moved.
        points_object: one row per keypoint.
        normal: the normal matrix at the end; its inverse is the covariance of the unknowns.
        surface_sigma_m: spread of the distances between the scenes' surfaces.
        print_sigmas: spread of the differences of their print, one per channel.
    """

    scene_from_object: Poses
    points_object: Points
    normal: Float64[np.ndarray, "u u"]
    surface_sigma_m: float
    print_sigmas: Float64[np.ndarray, " c"]


class _Pair(NamedTuple):
    """Two scenes as they lie now, and what they find in one another."""

    a: int
    b: int
    b_from_a: Transform
    matches: Matches
    print: Float64[np.ndarray, "m c"]


def register_scenes(
    surfaces: Sequence[SceneSurface | None],
    scene_from_object: Poses,
    points_object: Points,
    clicks: ClickTerms,
) -> Registration:
    """Register all scenes of an object from a start that is right to about a centimetre.

    Args:
        surfaces: the object's surface per scene; None where a scene is to be held by its clicks alone.
        scene_from_object: the start, one per scene.
        points_object: the keypoints at the start; unknown ones anywhere finite.
        clicks: the terms of the clicks.
    """
    poses, points = scene_from_object, points_object
    normal, sigma_m, print_sigmas = np.empty((0, 0)), 0.0, np.empty(0)
    for gate_m in GATES_M:
        for _ in range(STEPS):
            pairs = list(_pairs(surfaces, poses, gate_m))
            sigma_m, print_sigmas = _spreads(pairs)
            normal, gradient = clicks(poses, points)
            for pair in pairs:
                _add(normal, gradient, pair, surfaces, sigma_m, print_sigmas)
            step = _solved(normal, gradient)
            poses, points = _moved(poses, points, step)
            if np.abs(step).max() < STILL:
                break
    return Registration(poses, points, normal, sigma_m, print_sigmas)


def _pairs(surfaces: Sequence[SceneSurface | None], poses: Poses, gate_m: float) -> Iterator[_Pair]:
    """Every scene asks every other one."""
    for a, b in permutations(range(len(surfaces)), 2):
        one, other = surfaces[a], surfaces[b]
        if one is None or other is None:
            continue
        b_from_a = poses[b] @ invert(poses[a])
        matches = match(one, other, b_from_a, gate_m=gate_m)
        if len(matches.found) >= LEAST_MATCHES:
            yield _Pair(a, b, b_from_a, matches, print_differences(one, other, matches))


def _spreads(pairs: Sequence[_Pair]) -> tuple[float, Float64[np.ndarray, " c"]]:
    """Robust standard deviations of distances and of print, from their medians."""
    if not pairs:
        return LEAST_SURFACE_SIGMA_M, np.empty(0)
    distance = np.concatenate([pair.matches.distance_m for pair in pairs])
    differences = np.concatenate([pair.print for pair in pairs])
    sigma_m = max(1.4826 * float(np.median(np.abs(distance))), LEAST_SURFACE_SIGMA_M)
    return sigma_m, np.maximum(1.4826 * np.median(np.abs(differences), axis=0), LEAST_PRINT_SIGMA)


def robust_weight(normed: np.ndarray) -> np.ndarray:
    """Weight that Geman-McClure's loss gives residuals in units of their standard deviation."""
    weight: np.ndarray = 1 / (1 + (normed / KERNEL_SCALE_SIGMAS) ** 2) ** 2
    return weight


def _add(
    normal: Float64[np.ndarray, "u u"],
    gradient: Float64[np.ndarray, " u"],
    pair: _Pair,
    surfaces: Sequence[SceneSurface | None],
    sigma_m: float,
    print_sigmas: Float64[np.ndarray, " c"],
) -> None:
    """Add what two scenes say of one another to the system."""
    one, other = surfaces[pair.a], surfaces[pair.b]
    assert one is not None and other is not None
    partners = sum(surface is not None for surface in surfaces) - 1
    share = 2 * (one.spacing_m / INDEPENDENT_M) ** 2 / partners
    points_a = one.cloud.points[one.asking[pair.matches.asking]]
    close = share * robust_weight(pair.matches.distance_m / sigma_m)
    terms = [(other.cloud.normals[pair.matches.found], pair.matches.distance_m / sigma_m, close, sigma_m)]
    for channel, sigma in enumerate(print_sigmas):
        normed = pair.print[:, channel] / sigma
        slope = other.texture.gradients[pair.matches.found, channel]
        terms.append((slope, normed, close * robust_weight(normed), sigma))
    columns = np.r_[6 * pair.a : 6 * pair.a + 6, 6 * pair.b : 6 * pair.b + 6]
    for slope, normed, weight, sigma in terms:
        jacobian = _by_poses(slope / sigma, points_a, pair.matches.points_b, pair.b_from_a)
        weighted = jacobian * weight[:, None]
        normal[np.ix_(columns, columns)] += jacobian.T @ weighted
        gradient[columns] += weighted.T @ normed


def _by_poses(
    slope_b: Float64[np.ndarray, "m 3"],
    points_a: Float64[np.ndarray, "m 3"],
    points_b: Float64[np.ndarray, "m 3"],
    b_from_a: Transform,
) -> Float64[np.ndarray, "m 12"]:
    """Derivative of a residual by small motions of scene a, then of scene b.

    Args:
        slope_b: the residual's derivative by the position of the asking point, scene b.
    """
    slope_a = slope_b @ b_from_a[:3, :3]
    return np.concatenate(
        [np.cross(slope_a, points_a), -slope_a, np.cross(points_b, slope_b), slope_b], axis=1
    )


def _solved(normal: Float64[np.ndarray, "u u"], gradient: Float64[np.ndarray, " u"]) -> np.ndarray:
    """The step; a tiny ridge holds the common frame, which nothing determines, where it is."""
    ridge = 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    step: np.ndarray = np.linalg.solve(normal + ridge, -gradient)
    return step


def _moved(poses: Poses, points: Points, step: np.ndarray) -> tuple[Poses, Points]:
    motions = step[: 6 * len(poses)].reshape(-1, 6)
    moves = np.tile(np.eye(4), (len(poses), 1, 1))
    moves[:, :3, :3] = Rotation.from_rotvec(motions[:, :3]).as_matrix()
    moves[:, :3, 3] = motions[:, 3:]
    return moves @ poses, points + step[6 * len(poses) :].reshape(-1, 3)

"""Scenes registered on one another: surfaces, print and clicks in one normal matrix.

    min over Q, T of  clicks(Q, T) + sum over pairs of scenes (a, b) and points p_a of
                      rho(n_b . (T_b T_a^-1 p_a - p_b)) + rho(print_b - print_a)

Point-to-plane both ways (Chen and Medioni 1992) and print along its gradient (Park, Zhou and Koltun, ICCV
2017), in a robust kernel, with a gate that shrinks as the scenes come together. The keypoints are unknowns
of the same system, held by the clicks' rays and depths, so that they move along.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.geometry import Transform, invert
from rpl_data.motions import adjoint
from rpl_data.refine.overlap import Pairs, all_pairs
from rpl_data.refine.scene_surfaces import Matches, SceneSurface, match, print_differences

GATES_M = (0.012, 0.008, 0.005, 0.004)
"""How far a counterpart may be, from the first pass to the last."""
STEPS = 10
"""Most Gauss-Newton steps per gate."""
STILL_SIGMAS = 0.01
"""A shorter step, in standard deviations of the unknowns (root mean square), ends the steps of a gate.
Counterparts that change from step to step keep the scenes stirring by about a third of it, for ever."""
INDEPENDENT_M = 0.02
"""Errors of a fused surface are alike within about this distance, so a patch of it counts as one point."""
PER_PATCH = 2.0
"""What a patch counts for in each scene that sees it, shared among those it is compared with. Independent
scenes would count for 1 / 2 (of two scenes) to 1 (of many); the errors that are stated of labels were
measured with this (docs/accuracy.md)."""
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
    *,
    pairs: Pairs | None = None,
    gates_m: Sequence[float] = GATES_M,
) -> Registration:
    """Register all scenes of an object from a start that is right to about a centimetre.

    Args:
        surfaces: the object's surface per scene; None where a scene is to be held by its clicks alone.
        scene_from_object: the start, one per scene.
        points_object: the keypoints at the start; unknown ones anywhere finite.
        clicks: the terms of the clicks.
        pairs: the scenes that are compared; every one with every other one when None.
        gates_m: how far a counterpart may be, from the first pass to the last.
    """
    asked = all_pairs(surfaces) if pairs is None else pairs
    poses, points = scene_from_object, points_object
    normal, sigma_m, print_sigmas = np.empty((0, 0)), 0.0, np.empty(0)
    partners = Counter(asking for asking, _ in asked)
    for gate_m in gates_m:
        for _ in range(STEPS):
            compared = list(_compared(surfaces, asked, poses, gate_m))
            sigma_m, print_sigmas = _spreads(compared)
            normal, gradient = clicks(poses, points)
            for pair in compared:
                _add(normal, gradient, pair, surfaces, sigma_m, print_sigmas, partners=partners[pair.a])
            step = _solved(normal, gradient)
            poses, points = _moved(poses, points, step)
            if -step @ gradient < STILL_SIGMAS**2 * len(step):
                break
    return Registration(poses, points, normal, sigma_m, print_sigmas)


def _compared(
    surfaces: Sequence[SceneSurface | None], asked: Pairs, poses: Poses, gate_m: float
) -> Iterator[_Pair]:
    """What the scenes that are compared find in one another."""
    for a, b in asked:
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
    *,
    partners: int,
) -> None:
    """Add what two scenes say of one another to the system.

    Args:
        partners: how many scenes the asking one asks: of what it sees, each says its share.
    """
    one, other = surfaces[pair.a], surfaces[pair.b]
    assert one is not None and other is not None
    found, sigmas = pair.matches.found, np.r_[sigma_m, print_sigmas]
    slopes = np.concatenate([other.cloud.normals[found][:, None], other.texture.gradients[found]], axis=1)
    normed = np.column_stack([pair.matches.distance_m, pair.print]) / sigmas
    weight = robust_weight(normed)
    weight[:, 1:] *= weight[:, :1]
    weight *= PER_PATCH * (one.spacing_m / INDEPENDENT_M) ** 2 / partners
    by_b = _by_pose(slopes / sigmas[:, None], pair.matches.points_b)
    by_a = -adjoint(pair.b_from_a)
    weighted = by_b * weight.reshape(-1, 1)
    block, slope = by_b.T @ weighted, weighted.T @ normed.ravel()
    both = np.hstack([by_a, np.eye(6)])
    columns = np.r_[6 * pair.a : 6 * pair.a + 6, 6 * pair.b : 6 * pair.b + 6]
    normal[np.ix_(columns, columns)] += both.T @ block @ both
    gradient[columns] += both.T @ slope


def _by_pose(
    slopes: Float64[np.ndarray, "m c 3"], points: Float64[np.ndarray, "m 3"]
) -> Float64[np.ndarray, "n 6"]:
    """Derivatives of residuals by a small motion (rotation, translation) of the scene of their points.

    Args:
        slopes: the residuals' derivatives by the position of the point, several per point; n = m c.
    """
    x, y, z = points.T[..., None]
    u, v, w = np.moveaxis(slopes, 2, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u, u, v, w], axis=2).reshape(-1, 6)


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

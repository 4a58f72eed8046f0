"""The paper's own solve: depth of the clicked pixel (III-B), Eq. 2 by SciPy's SLSQP (III-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import minimize

from rpl_data.geometry import depth_sigma_m, rigid, transform
from rpl_data.solve.procrustes import Adjusted, Fragments
from rpl_data.types import Observation


def at_clicked_pixel(observation: Observation) -> Observation:
    """The click with the depth of its pixel as the only candidate; with none where nothing was measured."""
    depths_m = np.array([observation.pixel_depth_m] if observation.pixel_depth_m > 0 else [])
    sigmas_m = np.asarray(depth_sigma_m(depths_m))
    return replace(observation, depths_m=depths_m, depth_sigmas_m=sigmas_m, depth_slopes_m=None)


def measured_fragments(
    observations: Sequence[Observation], scenes: Sequence[str], keypoints: int
) -> Fragments:
    """The paper's W: every click lifted by the depth of its pixel; clicks without depth are left out.

    The paper has one click per keypoint and scene. Of several, the mean is taken with their number as its
    weight, which has the same minimum as one term of Eq. 2 per click.
    """
    points, clicks = np.zeros((len(scenes), keypoints, 3)), np.zeros((len(scenes), keypoints))
    for o in observations:
        if o.pixel_depth_m > 0:
            row = scenes.index(o.click.scene), o.click.keypoint
            points[row] += transform(o.scene_from_camera, o.pixel_depth_m * o.ray_camera)
            clicks[row] += 1
    return Fragments(points / np.maximum(clicks, 1)[..., None], clicks)


def adjust_points_slsqp(fragments: Fragments) -> Adjusted:
    """Minimise Eq. 2 with the constraint that every quaternion has length 1.

    The unknowns are [t_s, q_s (w, x, y, z)] of all scenes but the first, whose frame is the world,
    and Q; all start at 0 except the real part of the quaternions, which starts at 1.
    """
    scenes, keypoints = fragments.clicked.shape
    free = 7 * (scenes - 1)
    start = np.zeros(free + 3 * keypoints)
    start[3:free:7] = 1

    def cost(unknowns: Float64[np.ndarray, " u"]) -> float:
        turns, shifts, points = _unpack(unknowns, scenes)
        predicted = np.einsum("sij,kj->ski", turns, points) + shifts[:, None]
        return float((fragments.clicked[..., None] * (predicted - fragments.points_scene) ** 2).sum())

    def unit_length(unknowns: Float64[np.ndarray, " u"]) -> Float64[np.ndarray, " c"]:
        quaternions = unknowns[:free].reshape(-1, 7)[:, 3:]
        excess: Float64[np.ndarray, " c"] = (quaternions**2).sum(axis=1) - 1
        return excess

    result = minimize(
        cost,
        start,
        method="SLSQP",
        constraints={"type": "eq", "fun": unit_length},
        options={"maxiter": 1000, "ftol": 1e-10},
    )
    turns, shifts, points = _unpack(result.x, scenes)
    proper = [rigid(_nearest_rotation(turn), shift) for turn, shift in zip(turns, shifts, strict=True)]
    return Adjusted(np.stack(proper), points, fragments.clicked)


def _unpack(
    unknowns: Float64[np.ndarray, " u"], scenes: int
) -> tuple[Float64[np.ndarray, "s 3 3"], Float64[np.ndarray, "s 3"], Float64[np.ndarray, "k 3"]]:
    """Turns and shifts of all scenes, those of the first none, and the keypoints."""
    poses = unknowns[: 7 * (scenes - 1)].reshape(-1, 7)
    shifts = np.concatenate([np.zeros((1, 3)), poses[:, :3]])
    quaternions = np.concatenate([[[1.0, 0, 0, 0]], poses[:, 3:]])
    return _matrices(quaternions), shifts, unknowns[7 * (scenes - 1) :].reshape(-1, 3)


def _matrices(quaternions_wxyz: Float64[np.ndarray, "s 4"]) -> Float64[np.ndarray, "s 3 3"]:
    """Matrices of quaternions that need not have length 1 while the solver is under way."""
    w, x, y, z = quaternions_wxyz.T
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.array(rows).transpose(2, 0, 1)


def _nearest_rotation(turn: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    """The solver meets its constraint to ~1e-6 only; the rotation is made exact."""
    u, _, vt = np.linalg.svd(turn)
    rotation: Float64[np.ndarray, "3 3"] = u @ vt
    return rotation

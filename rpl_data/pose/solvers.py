"""Ways to a first pose: EPnP as in the paper, SQPnP, RANSAC, and a consensus of all triples."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations
from math import comb

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import rigid
from rpl_data.pose.correspondences import Correspondences
from rpl_data.pose.refine import reprojection_sigmas, robust_cost

INLIER_SIGMAS = 4.0
"""A keypoint whose reprojection error exceeds this many standard deviations is wrong."""

FEWEST = 4
"""Least number of keypoints: three allow up to four poses."""

MOST_TRIPLES = 120
"""All triples are tried up to 10 keypoints; beyond, this many random ones."""

Attempt = tuple[Float64[np.ndarray, "4 4"], Bool[np.ndarray, " n"]]
"""``camera_from_object``, and which keypoints it is based on."""


def epnp(given: Correspondences) -> Attempt | None:
    """Lepetit, Moreno-Noguer and Fua, IJCV 81 (2009): the paper's choice; every keypoint is trusted."""
    return _closed_form(given, cv2.SOLVEPNP_EPNP)


def sqpnp(given: Correspondences) -> Attempt | None:
    """Terzakis and Lourakis, ECCV 2020: the global minimum of its cost; every keypoint is trusted."""
    return _closed_form(given, cv2.SOLVEPNP_SQPNP)


def ransac(given: Correspondences) -> Attempt | None:
    """OpenCV's RANSAC with EPnP; the threshold is `INLIER_SIGMAS` of the median keypoint."""
    sigma_px = np.median(1 / np.sqrt(np.abs(np.linalg.det(given.whitening))))
    try:
        found, rotvec, translation, rows = cv2.solvePnPRansac(
            given.points_object,
            given.positions_px,
            given.camera_matrix,
            None,
            flags=cv2.SOLVEPNP_EPNP,
            reprojectionError=float(INLIER_SIGMAS * sigma_px),
        )
    except cv2.error:  # OpenCV checks its own intermediate results
        return None
    if not found or rows is None:
        return None
    inliers = np.zeros(len(given), dtype=bool)
    inliers[rows[:, 0]] = True
    return rigid(cv2.Rodrigues(rotvec)[0], translation[:, 0]), inliers


def consensus(given: Correspondences, *, looked_at: int = 12, solved: int = 3) -> Attempt | None:
    """Find the pose that most keypoints agree with, among all from triples; None without a majority.

    Every triple's poses (P3P) are ranked by the robust cost of all keypoints. The keypoints that agree with
    each of the best `looked_at` poses form at most `solved` different sets. SQPnP solves each set, and the
    pose of least robust cost decides which keypoints are right. Up to 10 keypoints nothing is random, so a
    third of wrong keypoints does no harm: the triples of all others are tried.
    """
    from rpl_data.pose.p3p import poses_from_triples

    triples = _triples(len(given))
    rays = np.column_stack([given.positions_px / given.focal_px, np.ones(len(given))])
    poses = poses_from_triples(given.points_object[triples], rays[triples])
    sigmas = reprojection_sigmas(poses, given)
    ranked = np.argsort(robust_cost(sigmas))[:looked_at]
    about = sigmas[ranked] < 2 * INLIER_SIGMAS  # the noise of three keypoints adds to that of the others
    sets = [rows for rows in dict.fromkeys(map(tuple, about.tolist())) if sum(rows) >= FEWEST]
    attempts = [_closed_form(given, cv2.SOLVEPNP_SQPNP, np.array(rows)) for rows in sets[:solved]]
    found = np.array([attempt[0] for attempt in attempts if attempt is not None]).reshape(-1, 4, 4)
    if len(found) == 0:
        return None
    sigmas = reprojection_sigmas(found, given)
    best = int(np.argmin(robust_cost(sigmas)))
    agreeing = sigmas[best] < INLIER_SIGMAS
    return (found[best], agreeing) if agreeing.sum() > len(given) / 2 else None


SOLVERS: dict[str, Callable[[Correspondences], Attempt | None]] = {
    "epnp": epnp,
    "sqpnp": sqpnp,
    "ransac": ransac,
    "consensus": consensus,
}


def _closed_form(
    given: Correspondences, flag: int, rows: Bool[np.ndarray, " n"] | None = None
) -> Attempt | None:
    """Run OpenCV's solver on all rows, or on some."""
    rows = np.ones(len(given), dtype=bool) if rows is None else rows
    try:
        found, rotvec, translation = cv2.solvePnP(
            given.points_object[rows], given.positions_px[rows], given.camera_matrix, None, flags=flag
        )
    except cv2.error:  # OpenCV checks its own intermediate results
        return None
    return (rigid(cv2.Rodrigues(rotvec)[0], translation[:, 0]), rows) if found else None


@cache
def _triples(count: int) -> Int64[np.ndarray, "m 3"]:
    if comb(count, 3) <= MOST_TRIPLES:
        return np.array(list(combinations(range(count), 3)), dtype=np.int64)
    shuffled = np.random.default_rng(count)
    draws = range(4 * MOST_TRIPLES)  # some are drawn twice
    drawn = (tuple(sorted(shuffled.choice(count, 3, replace=False).tolist())) for _ in draws)
    return np.array(list(dict.fromkeys(drawn))[:MOST_TRIPLES], dtype=np.int64)

"""The sparse solve against the paper's SLSQP, and against wrong clicks.

Run: python tests/bench/bench_solve.py [--scenes 10] [--keypoints 12] [--seeds 50]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rows import record
from scipy.spatial.transform import Rotation

from rpl_data.geometry import fit_rigid, rigid, transform
from rpl_data.solve.procrustes import Fragments, eq2_cost
from rpl_data.solve.solve import solve_points


def fragments(scenes: int, keypoints: int, seed: int, wrong: float) -> tuple[np.ndarray, Fragments]:
    """Keypoints in a 0.2 m cube, any rotation, 0.8 m away, 2 mm noise per axis, 60 % seen.

    Every scene sees at least 4 keypoints and scenes sharing at least 3 connect all. A share `wrong`
    of the clicks is off by 5-30 cm.
    """
    random = np.random.default_rng(seed)
    points = random.uniform(-0.1, 0.1, (keypoints, 3))
    clicked = random.random((scenes, keypoints)) < 0.6
    while not tied(clicked):
        clicked |= random.random((scenes, keypoints)) < 0.05
    poses = [
        rigid(Rotation.random(rng=random).as_matrix(), np.array([0, 0, 0.8]) + random.uniform(-0.2, 0.2, 3))
        for _ in range(scenes)
    ]
    w = np.stack([transform(pose, points) for pose in poses]) + random.normal(
        0, 0.002, (scenes, keypoints, 3)
    )
    bad = (random.random((scenes, keypoints)) < wrong) & clicked
    direction = random.normal(size=w.shape)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    w[bad] += (direction * random.uniform(0.05, 0.3, (scenes, keypoints, 1)))[bad]
    return points, Fragments(np.where(clicked[..., None], w, 0.0), clicked.astype(float))


def tied(clicked: np.ndarray) -> bool:
    """Every scene sees 4 keypoints, every keypoint is seen, shared triples connect all scenes."""
    if clicked.sum(axis=1).min() < 4 or not clicked.any(axis=0).all():
        return False
    shared = (clicked.astype(int) @ clicked.T.astype(int)) >= 3
    reached = {0}
    while True:
        grown = reached | {int(b) for a in reached for b in np.flatnonzero(shared[a])}
        if grown == reached:
            return len(reached) == len(clicked)
        reached = grown


def error_m(points: np.ndarray, found: np.ndarray) -> float:
    """Root mean square over keypoints after a rigid fit."""
    errors = transform(fit_rigid(points, found), found) - points
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--keypoints", type=int, default=12)
    parser.add_argument("--seeds", type=int, default=50)
    options = parser.parse_args()
    size = (options.scenes, options.keypoints)

    _, clean = fragments(*size, seed=0, wrong=0.0)
    times = []
    for _ in range(11):
        start = time.process_time()
        ours = solve_points(clean, loss="l2")
        times.append(time.process_time() - start)
    start = time.process_time()
    papers = solve_points(clean, method="slsqp")
    papers_s = time.process_time() - start
    ours_s = float(np.median(times))
    print(f"clean, {size[0]} scenes x {size[1]} keypoints, CPU seconds and Eq. 2 cost (m^2):")
    print(f"  slsqp (baseline)  {papers_s:10.4f} s   cost {eq2_cost(clean, papers):.9e}")
    print(f"  l2                {ours_s:10.4f} s   cost {eq2_cost(clean, ours):.9e}")
    print(f"  ratio             {papers_s / ours_s:10.0f} x")

    work = f"Eq. 2, {size[0]} scenes x {size[1]} keypoints, clean"
    record("solve", work, times, "s CPU", baseline=("the paper's SLSQP, vectorised", papers_s), asked=10_000)

    errors = []
    for seed in range(options.seeds):
        points, dirty = fragments(*size, seed=seed, wrong=0.05)
        errors.append(error_m(points, solve_points(dirty).points_model))
    share = np.mean(np.array(errors) < 0.005)
    record("solve", "5 % wrong clicks: runs under 5 mm", share, "share", asked=0.95, more_is_better=True)
    print(f"5 % of clicks wrong by 5-30 cm, {options.seeds} seeds, robust loss:")
    print(
        f"  under 5 mm {share:.0%}, median {1e3 * np.median(errors):.2f} mm, worst {1e3 * max(errors):.1f} mm"
    )


if __name__ == "__main__":
    main()

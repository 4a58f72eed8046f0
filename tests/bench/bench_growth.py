"""How `solve` and `refine` grow with scenes and keypoints: the exponents that docs/scale.md states.

Made-up objects with as many keypoints as wanted, clicked once per keypoint and scene, 2 px off; and a printed
egg of which each scene sees one half, registered from where its clicks put it. CPU seconds; recorded is the
exponent of the last step, in which what does not grow weighs least.

Run: PYTHONPATH=. python tests/bench/bench_growth.py [--scenes 10 20 40 80] [--keypoints 12 24 48]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rows import record

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "refine"))

from clicked_scenes import cameras, click_scene, pose
from made_surfaces import RADII, egg_seen_from, moved

from rpl_data.refine.refine import refine_scenes
from rpl_data.solve.joint import joint_clicks
from rpl_data.solve.solve import solve
from rpl_data.types import Observation


def clicked(points: np.ndarray, poses: Sequence[np.ndarray]) -> list[Observation]:
    """One click per keypoint and scene, 2 px off, by a camera 0.7 m away."""
    random = np.random.default_rng(1)
    return [
        seen
        for s, at in enumerate(poses)
        for seen in click_scene(f"{s:03d}", points, at, cameras(1), random, noise_px=2.0)
    ]


def solving(scenes: int, keypoints: int) -> Callable[[], object]:
    """`solve`, with its check of the clicks."""
    random = np.random.default_rng(0)
    points = random.uniform(-0.1, 0.1, (keypoints, 3))
    observations = clicked(points, [pose(random) for _ in range(scenes)])
    return lambda: solve("made", [f"k{k}" for k in range(keypoints)], observations)


def refining(scenes: int) -> Callable[[], object]:
    """`refine` from the solution of the clicks, without the growing of the regions; all surfaces are good."""
    random = np.random.default_rng(0)
    points = np.concatenate([np.diag(RADII), -np.diag(RADII)])
    poses = [pose(random) for _ in range(scenes)]
    observations = clicked(points, poses)
    clicks = joint_clicks(solve("egg", [f"k{k}" for k in range(6)], observations), observations)
    regions = {
        name: moved(egg_seen_from(random.normal(size=3), seed=s), at)
        for s, (name, at) in enumerate(zip(clicks.scenes, poses, strict=True))
    }
    start, points_object = clicks.scene_from_object, clicks.points_object
    return lambda: refine_scenes(regions, clicks.scenes, start, points_object, clicks.terms, clicks.costs)


def grown(what: str, of: str, sizes: Sequence[int], work: Callable[[int], Callable[[], object]]) -> None:
    """Print and record the CPU seconds for each size, and the exponent of the last step."""
    seconds = []
    for size in sizes:
        prepared = work(size)
        began = time.process_time()
        prepared()
        seconds.append(time.process_time() - began)
        record("growth", f"{what}, {size} {of}", seconds[-1], "s CPU")
        print(f"  {what}, {size:3d} {of}: {seconds[-1]:7.2f} s", flush=True)
    exponents = np.diff(np.log(seconds)) / np.diff(np.log(sizes))
    record("growth", f"{what}: exponent by {of}, {sizes[-2]} to {sizes[-1]}", exponents[-1], "")
    print(f"  {what}, exponents by {of}: " + ", ".join(f"{one:.1f}" for one in exponents), flush=True)


def main() -> None:
    """Print the seconds and the exponents."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenes", type=int, nargs="+", default=[10, 20, 40, 80], help="for solve")
    parser.add_argument("--keypoints", type=int, nargs="+", default=[12, 24, 48], help="for solve")
    parser.add_argument("--refined", type=int, nargs="+", default=[6, 12, 24], help="scenes for refine")
    told = parser.parse_args()
    solving(2, 6)()  # what is imported where it is needed is not measured
    grown("solve of 12 keypoints", "scenes", told.scenes, lambda scenes: solving(scenes, 12))
    grown("solve of 10 scenes", "keypoints", told.keypoints, lambda keypoints: solving(10, keypoints))
    grown("refine of an egg", "scenes", told.refined, refining)


if __name__ == "__main__":
    main()

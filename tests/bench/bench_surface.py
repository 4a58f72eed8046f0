"""Surfaces of a five-minute recording: what they cost, and how far they are from the truth.

    python tests/bench/bench_surface.py [FRAMES]

A camera goes to and fro before a wall with three boxes, FRAMES (9,000) frames long; 240 images are used again
and again. The baseline is what the first release did: every steady frame is decoded and fused, once per
object.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from rows import record, shared

sys.path.insert(0, str(Path(__file__).parents[1]))

from made_scenes import orbit, scene_of, shot

from rpl_data.geometry import Sphere
from rpl_data.images import depth_reader
from rpl_data.reconstruct.surface import fuse_surface, fuse_surfaces
from rpl_data.types import Frame, Mesh, Scene, Trajectory

IMAGES = 240
BOXES = ((-0.15, 0.1, 0.8, 0.08), (0.12, 0.05, 0.75, 0.07))
"""Centre and half side of boxes that `shot` draws, the scene's frame."""


def recording(folder: Path, count: int) -> tuple[Scene, Trajectory]:
    """Scene and path, true; the images are written once."""
    poses = orbit(IMAGES)
    for number, pose in enumerate(poses):
        _, depth_m = shot(pose, boxes=True, contrast=10.0, rng=np.random.default_rng(number))
        cv2.imwrite(str(folder / f"{number:06d}.png"), np.rint(depth_m * 1000).astype(np.uint16))
    back_and_forth = np.r_[np.arange(IMAGES), np.arange(IMAGES)[::-1]]
    shown = np.resize(back_and_forth, count)
    frames = tuple(
        Frame(n, n / 30, folder / "none.png", folder / f"{k:06d}.png") for n, k in enumerate(shown.tolist())
    )
    return replace(scene_of(1), frames=frames), Trajectory(np.arange(count), poses[shown])


def off_mm(meshes: list[Mesh]) -> float:
    """Median distance of the meshes from the boxes, of vertices that are near them and not at the wall."""
    distances = []
    for mesh, (x, y, z, half) in zip(meshes, BOXES, strict=True):
        beyond = np.abs(mesh.vertices - (x, y, z)) - half
        outside = np.linalg.norm(beyond.clip(0), axis=1) + beyond.max(axis=1).clip(max=0)
        distances.append(np.abs(outside[(np.abs(outside) < 0.012) & (mesh.vertices[:, 2] < 0.88)]))
    return 1e3 * float(np.median(np.concatenate(distances)))


def timed(work: Callable[[], list[Mesh]]) -> tuple[float, list[Mesh]]:
    """CPU seconds, and the meshes."""
    start = time.process_time()
    meshes = work()
    return time.process_time() - start, meshes


def main(count: int) -> None:
    """Print times, their ratio and both distances."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as place:
        scene, path = recording(Path(place), count)
        read = depth_reader(scene)
        spheres = [Sphere(np.array([x, y, z]), 2.2 * half) for x, y, z, half in BOXES]

        def every_frame() -> list[Mesh]:
            every = {"most_frames": count}
            return [
                fuse_surface(
                    scene, path, scene.frames, read, centre_scene=s.centre_m, radius_m=s.radius_m, **every
                )
                for s in spheres
            ]

        chosen_s, chosen = timed(lambda: fuse_surfaces(scene, path, scene.frames, read, spheres=spheres))
        every_s, every = timed(every_frame)
    print(f"every steady frame, once per object  {every_s:7.2f} s CPU  {off_mm(every):.3f} mm off")
    print(f"chosen frames, once                  {chosen_s:7.2f} s CPU  {off_mm(chosen):.3f} mm off")
    print(f"ratio {every_s / chosen_s:.1f} (asked 10)")
    name = "every steady frame, once per object"
    record("surface", f"{count} frames, two objects", chosen_s, "s CPU", baseline=(name, every_s), asked=10.0)
    record(
        "surface", "distance to the truth", off_mm(chosen), "mm", baseline=(name, off_mm(every)), asked=1.0
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else shared(9_000, least=3_000))

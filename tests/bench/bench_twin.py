"""The twin on one core: frames/s with light, shadows and sensor, beside the bare casting of rays; accuracy.

    python tests/bench/bench_twin.py [FRAMES]

640x480, two objects of ours, five other things, a room. Times are the processor's, so that a busy machine
does not distort them. The baseline is Open3D's `cast_rays` for one ray a pixel into the same scene: depth
and nothing else, the least any ray caster needs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before Open3D starts its threads

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from rows import record

from rpl_data.geometry import invert
from rpl_data.raycast import pixel_rays, rays_in_object
from rpl_data.twin import TwinSpec, write_twin
from rpl_data.twin.film import Film, film

LEAST_FRAMES_A_S = 2.0


def seconds_a_frame(work: Callable[[int], object], frames: int) -> float:
    """Processor time of one call, after one that is not counted."""
    work(0)
    start = time.process_time()
    for frame in range(1, frames + 1):
        work(frame)
    return (time.process_time() - start) / frames


def bare_rays(video: Film) -> Callable[[int], object]:
    """One ray a pixel, through Open3D alone."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for surface in video.scene.surfaces:
        scene.add_triangles(
            surface.vertices.astype(np.float32), np.ascontiguousarray(surface.triangles, dtype=np.uint32)
        )
    intrinsics = video.spec.intrinsics
    size = {"width": intrinsics.width, "height": intrinsics.height}
    directions = pixel_rays(intrinsics, left_px=0, top_px=0, **size).astype(np.float32)

    def cast(frame: int) -> object:
        rays = rays_in_object(directions, invert(video.table_from_camera[frame]))
        return scene.cast_rays(o3d.core.Tensor(np.ascontiguousarray(rays)), nthreads=1)

    return cast


def main(frames: int = 12) -> None:
    """Print times and ratios; fail below two frames a second."""
    cv2.setNumThreads(1)
    spec = TwinSpec(scenes=1, seconds=(frames + 1) / 3, keep_hz=3.0)
    video = film(spec, 0)
    rays_s = seconds_a_frame(bare_rays(video), frames)
    shaded_s = seconds_a_frame(lambda n: video.renderer.render(video.table_from_camera[n]), frames)
    whole_s = seconds_a_frame(video.shoot, frames)
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        write_twin(Path(folder) / "twin", spec, workers=1)
        disk_s = (time.process_time() - start) / spec.total_frames
        size_kb = sum(f.stat().st_size for f in Path(folder).rglob("*.*g")) / spec.total_frames / 1024
    rows = (
        ("baseline: Open3D's rays alone", rays_s),
        ("rendered with light and shadows", shaded_s),
        ("as the sensor gives it, labelled", whole_s),
        ("written to disk, scene prepared", disk_s),
    )
    for name, seconds in rows:
        print(f"{name:34s} {1 / seconds:6.2f} frames/s a core  {seconds / rays_s:5.2f} x the baseline's time")
        record("twin", name, 1 / seconds, "frames/s", baseline=("bare rays", 1 / rays_s), more_is_better=True)
    print(f"{size_kb:.0f} kB a frame on disk")
    assert 1 / shaded_s >= LEAST_FRAMES_A_S, f"{1 / shaded_s:.2f} frames/s; expected {LEAST_FRAMES_A_S}"


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))

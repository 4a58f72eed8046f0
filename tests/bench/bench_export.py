"""Frames per second and peak memory of each export format on one core, and the ratio to `coco`.

    python tests/bench/bench_export.py

Each format is written in a process of its own, from 50 and from 200 frames of 640 x 480 with two objects;
memory that grows with the frames shows in the last column. `coco` is made from the labels, the others from
it. The objects have no meshes, whose textures are computed per object, not per frame.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from labelled_scenes import BOX, CAN, labelled_scene, rle
from rows import record

import rpl_data.export as exports
from rpl_data.export import ExportScene, export_coco
from rpl_data.export.split import SplitRule
from rpl_data.types import InstanceLabel, Intrinsics

SIZES = (50, 200)
CAMERA = Intrinsics(600.0, 601.0, 319.5, 239.5, 640, 480)
PER_SCENE = 50
FORMATS = ("coco", "coco_per_object", "yolo", "bop", "bop_onboarding", "ycb_video", "linemod", "okt")
FORMATS += ("foundationpose", "bundlesdf", "nerfstudio", "huggingface", "webdataset")
UNITS = {"bop", "bop_onboarding", "ycb_video", "linemod", "foundationpose", "bundlesdf", "nerfstudio"}


def labels(root: Path, frames: int) -> list[ExportScene]:
    """Scenes of 50 frames; the images are there once, and every frame links to one of them."""
    scenes = []
    for number in range(frames // PER_SCENE):
        made = labelled_scene(root / f"{frames}", f"s{number}", frames=PER_SCENE, suffix=".jpg", seed=number)
        for frame in made.scene.frames:
            for path in (frame.color, frame.depth):
                stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
                cv2.imwrite(str(path), cv2.resize(stored, (640, 480), interpolation=cv2.INTER_NEAREST))
        grown = [replace(label, instances=tuple(map(_grown, label.instances))) for label in made.labels]
        scene = replace(made.scene, intrinsics=CAMERA)
        scenes.append(ExportScene(scene, made.trajectory, grown))
    return scenes


def _grown(instance: InstanceLabel) -> InstanceLabel:
    """Its masks at four times the width and height: an ellipse with a hole."""
    full = np.zeros((480, 640), np.uint8)
    x0, y0, x1, y1 = (int(4 * side) for side in instance.box_full)
    cv2.ellipse(full, (((x0 + x1) / 2, (y0 + y1) / 2), (x1 - x0, y1 - y0), 20.0), 1, -1)
    seen = full.copy()
    cv2.circle(seen, ((x0 + x1) // 2, (y0 + y1) // 2), 12, 0, -1)
    return replace(instance, mask=rle(seen > 0), mask_full=rle(full > 0))


def write(name: str, root: str, frames: int) -> tuple[float, float]:
    """Write a format; returns its CPU seconds and the peak memory of this process in MiB."""
    cv2.setNumThreads(1)
    place, started = Path(root), time.process_time()
    if name == "coco":
        scenes = labels(place, frames)
        started = time.process_time()
        export_coco(place / f"coco-{frames}", scenes, [BOX, CAN], split=SplitRule())
    else:
        units = ({f"s{n}": 0.001 for n in range(frames // PER_SCENE)},) if name in UNITS else ()
        getattr(exports, f"export_{name}")(place / f"{name}-{frames}", place / f"coco-{frames}", *units)
    seconds = time.process_time() - started
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Print the table."""
    os.environ["OMP_NUM_THREADS"] = "1"
    few, many = SIZES
    print(f"{'format':16s} frames/s  of coco  peak MiB, {few} frames  {many} frames")
    base = None
    with tempfile.TemporaryDirectory() as root:
        for name in FORMATS:
            found = []
            for frames in SIZES:
                with multiprocessing.get_context("spawn").Pool(1) as pool:
                    found.append(pool.apply(write, (name, root, frames)))
            rate = many / found[1][0]
            base = base or rate
            record("export", name, rate, "frames/s", baseline=("coco", base), more_is_better=True)
            memory = f"{found[0][1]:20.0f} {found[1][1]:11.0f}"
            print(f"{name:16s} {rate:8.0f} {rate / base:8.2f} {memory}", flush=True)


if __name__ == "__main__":
    main()

"""Samples a second of KeypointDataset from JPEG, PNG and its caches, and heatmaps against the loop.

One core, no photometric augmentation: python tests/bench/bench_torch.py
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from pycocotools import mask as masks

from rpl_data.formats.coco import CocoObject, image_to_coco, instance_to_coco, writing_coco
from rpl_data.geometry import box_around, from_rotvec, project, square_box, transform
from rpl_data.torch.heatmaps import draw_heatmaps
from rpl_data.torch.keypoints import KeypointDataset
from rpl_data.torch.transforms import Augmentation
from rpl_data.types import Frame, InstanceLabel, Intrinsics, KeypointModel, Rle

CAMERA = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
CUBE = KeypointModel(
    "cube",
    tuple(f"k{n}" for n in range(8)),
    np.array([[x, y, z] for x in (-0.04, 0.04) for y in (-0.04, 0.04) for z in (-0.04, 0.04)]),
)
FRAMES = 60


def photo_like(rng: np.random.Generator) -> np.ndarray:
    """Coarse structure and sensor noise: about as many bytes as a real photograph of this size."""
    coarse = rng.integers(30, 220, (30, 40, 3)).astype(np.float32)
    image = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC) + rng.normal(0, 2, (480, 640, 3))
    return np.clip(image, 0, 255).astype(np.uint8)


def label(rng: np.random.Generator) -> InstanceLabel:
    """The cube at 0.7 m, somewhere in the image."""
    pose = from_rotvec(rng.uniform(-1, 1, 3), np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.1, 0.1), 0.7]))
    uv = project(CAMERA, transform(pose, CUBE.points_object))
    x0, y0, x1, y1 = box = tuple(float(side) for side in np.round(box_around(uv)))
    pixels = np.zeros((480, 640), dtype=np.uint8, order="F")
    pixels[int(y0) : int(y1), int(x0) : int(x1)] = 1
    encoded = masks.encode(pixels)
    rle = Rle(size=list(encoded["size"]), counts=encoded["counts"].decode())
    seen = np.full(8, 2, dtype=np.int64)
    return InstanceLabel(
        "cube", pose, uv, seen, np.ones(8), square_box(uv), box, box, rle, rle, 1.0, False, 1.0
    )


def write_dataset(folder: Path, suffix: str) -> Path:
    """A COCO file with its images."""
    rng = np.random.default_rng(0)
    with writing_coco(folder / f"{suffix}.json", [CocoObject(CUBE)]) as writer:
        for n in range(FRAMES):
            name = f"{n:06d}.{suffix}"
            cv2.imwrite(str(folder / name), photo_like(rng))
            image = image_to_coco(
                n + 1,
                Frame(n, n / 30, folder / name, None),
                scene="s",
                intrinsics=CAMERA,
                scene_from_camera=np.eye(4),
                file_name=name,
                depth_file_name=None,
            )
            annotation = instance_to_coco(n + 1, n + 1, 1, label(rng))
            writer.add(image, [] if annotation is None else [annotation])
    return folder / f"{suffix}.json"


def samples_per_second(dataset: KeypointDataset) -> float:
    """CPU time of the best of three passes, so that other people's load on the machine does not count."""
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        for row in range(len(dataset)):
            dataset[row]
        best = min(best, time.process_time() - start)
    return len(dataset) / best


def seconds(work: Callable[[], object], times: int) -> float:
    """CPU seconds a call, the best of five rounds."""
    work()
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        for _ in range(times):
            work()
        best = min(best, time.process_time() - start)
    return best / times


def naive_heatmaps(positions_px: np.ndarray, size_px: int) -> np.ndarray:
    """A Gaussian over the whole grid, a keypoint at a time: what trainers usually do."""
    maps = np.zeros((len(positions_px), size_px, size_px), dtype=np.float32)
    for k, (u, v) in enumerate(positions_px):
        columns, rows = np.meshgrid(np.arange(size_px), np.arange(size_px))
        maps[k] = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 2)
    return maps


def main() -> None:
    """Print the table."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    geometric = Augmentation(gain=0.0, offset=0.0)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        files = {suffix: write_dataset(folder, suffix) for suffix in ("jpg", "png")}
        for name, suffix, cache, target in (
            ("JPEG", "jpg", False, 150),
            ("PNG", "png", False, 80),
            ("cache in memory", "jpg", True, 700),
            ("cache on disk", "jpg", folder / "cache", 700),
        ):
            plain = samples_per_second(KeypointDataset(files[suffix], cache=cache))
            turned = samples_per_second(KeypointDataset(files[suffix], cache=cache, augment=geometric))
            print(
                f"{name:16s} {plain:6.0f} samples/s; {turned:6.0f} with shift, scale, turn (asked {target})"
            )
    positions = np.random.default_rng(0).uniform(0, 63, (8, 2))
    tensor = torch.from_numpy(positions)
    loop = seconds(lambda: naive_heatmaps(positions, 64), 50)
    batch = tensor.expand(32, 8, 2).contiguous()
    one = seconds(lambda: draw_heatmaps(tensor, size_px=64), 500)
    many = seconds(lambda: draw_heatmaps(batch, size_px=64), 50) / 32
    print(
        f"8 heatmaps 64 x 64: loop {loop * 1e6:.0f} us, one sample {one * 1e6:.0f} us ({loop / one:.1f}x), "
        f"batch of 32 {many * 1e6:.0f} us a sample ({loop / many:.1f}x) (asked 10x)"
    )


if __name__ == "__main__":
    main()

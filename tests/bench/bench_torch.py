"""Time per sample of KeypointDataset, a loop that resizes and torchvision v2; its share of a training step.

One core: python tests/bench/bench_torch.py
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image
from pycocotools import mask as masks
from rows import record
from torchvision import tv_tensors
from torchvision.io import decode_image
from torchvision.transforms import v2
from torchvision.transforms.v2 import functional

from rpl_data.formats.datasets.coco import (
    CocoObject,
    image_to_coco,
    instance_from_coco,
    instance_to_coco,
    read_coco,
    writing_coco,
)
from rpl_data.geometry import box_around, from_rotvec, project, square_box, transform
from rpl_data.torch.keypoints import KeypointDataset
from rpl_data.torch.transforms import Augmentation
from rpl_data.types import Frame, InstanceLabel, Intrinsics, KeypointModel, Rle
from training.keypoints.module import untrained
from training.runs.options import Learning, Network

CAMERA = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
CUBE = KeypointModel(
    "cube",
    tuple(f"k{n}" for n in range(8)),
    np.array([[x, y, z] for x in (-0.04, 0.04) for y in (-0.04, 0.04) for z in (-0.04, 0.04)]),
)
FRAMES = 60
CPU = Network(stacks=1, features=64, input_px=128, heatmap_px=32, loss="entropy")
"""Of training/configs/keypoints_cpu.yaml."""


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


def instances(coco_json: Path) -> list[tuple[Path, InstanceLabel]]:
    """Image and label of each annotation."""
    data = read_coco(coco_json)
    files = {image["id"]: coco_json.parent / image["file_name"] for image in data["images"]}
    return [(files[a["image_id"]], instance_from_coco(a, "cube")) for a in data["annotations"]]


def samples_per_second(dataset: KeypointDataset | LoopAndResize | TorchvisionPipeline) -> float:
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


class LoopAndResize:
    """What the paper's trainer does for a sample, step by step, with libraries of today.

    Labels from three text files; the whole image as floats, its channels times a gain each; the box cut out
    into an array of zeros and resized by PIL (as scipy.misc.imresize did); a map a keypoint with a 7 x 7
    Gaussian pasted at whole pixels. The box is shifted and scaled, never turned.
    """

    def __init__(self, folder: Path, files: list[Path], labels: list[InstanceLabel]) -> None:
        self._files, self._folder = files, folder
        for row, one in enumerate(labels):
            box = one.square_box
            np.savetxt(folder / f"label_{row}.txt", one.keypoints_px)
            np.savetxt(folder / f"centre_{row}.txt", [box.cx_px, box.cy_px])
            np.savetxt(folder / f"scale_{row}.txt", [box.side_px])

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, row: int) -> tuple[torch.Tensor, torch.Tensor]:
        keypoints, centre, side = (
            np.loadtxt(self._folder / f"{name}_{row}.txt") for name in ("label", "centre", "scale")
        )
        whole = torch.from_numpy(np.array(Image.open(self._files[row])).transpose(2, 0, 1)).float()
        if whole.max() > 1:
            whole /= 255
        centre, side = centre * np.random.uniform(0.75, 1.25), float(side) * np.random.uniform(0.75, 1.25)
        for channel in whole:
            channel.mul_(np.random.uniform(0.8, 1.2)).clamp_(0, 1)
        crop = self._cut(whole.numpy().transpose(1, 2, 0), centre, side)
        maps = np.zeros((len(keypoints), 64, 64), dtype=np.float32)
        for heatmap, position in zip(maps, (keypoints - centre + side / 2) * 64 / side, strict=True):
            self._paste(heatmap, *position.astype(int))
        return torch.from_numpy(crop.transpose(2, 0, 1).copy()).float().div(255) - 0.5, torch.from_numpy(maps)

    @staticmethod
    def _cut(image: np.ndarray, centre: np.ndarray, side: float) -> np.ndarray:
        left, top = (centre - side / 2).astype(int)
        size = int(side)
        cut = np.zeros((size, size, 3))
        x0, y0, x1, y1 = max(0, left), max(0, top), min(640, left + size), min(480, top + size)
        cut[y0 - top : y1 - top, x0 - left : x1 - left] = image[y0:y1, x0:x1]
        grey_levels = ((cut - cut.min()) * (255 / np.ptp(cut))).astype(np.uint8)
        return np.asarray(Image.fromarray(grey_levels).resize((256, 256), Image.Resampling.BILINEAR))

    @staticmethod
    def _paste(heatmap: np.ndarray, u: int, v: int) -> None:
        steps = np.arange(-3.0, 4.0)
        patch = np.exp(-(steps**2 + steps[:, None] ** 2) / 2)
        u0, v0, u1, v1 = max(0, u - 3), max(0, v - 3), min(64, u + 4), min(64, v + 4)
        if u0 < u1 and v0 < v1:
            heatmap[v0:v1, u0:u1] = patch[v0 - v + 3 : v1 - v + 3, u0 - u + 3 : u1 - u + 3]


class TorchvisionPipeline:
    """What one would write with torchvision v2 and tune no further: turn, crop, resize, colours, maps."""

    def __init__(self, files: list[Path], labels: list[InstanceLabel]) -> None:
        self._files, self._labels = files, labels
        self._whole = v2.RandomAffine(
            30, (0.1, 0.1), (0.75, 1.25), interpolation=v2.InterpolationMode.BILINEAR
        )
        self._crop = v2.Compose(
            [v2.Resize((256, 256)), v2.ColorJitter(0.2, 0.2), v2.ToDtype(torch.float32, scale=True)]
        )

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, row: int) -> tuple[torch.Tensor, torch.Tensor]:
        image = tv_tensors.Image(decode_image(str(self._files[row])))
        positions = torch.from_numpy(self._labels[row].keypoints_px + 0.5).float()
        image, points = self._whole(image, tv_tensors.KeyPoints(positions, canvas_size=image.shape[-2:]))
        low, high = points.amin(dim=0), points.amax(dim=0)
        side = int((high - low).max() * 1.5)
        left, top = ((low + high - side) / 2).int().tolist()
        cut = [functional.crop(one, top, left, side, side) for one in (image, points)]
        image, points = self._crop(*cut)
        grid = torch.arange(64) + 0.5
        away = (grid - points[:, :1] / 4).square()[:, None, :] + (grid - points[:, 1:] / 4).square()[
            :, :, None
        ]
        return image, torch.exp(-away / 2)


def step_seconds(network: Network, batch: int) -> float:
    """CPU seconds an image of a training step, without loading."""
    module = untrained(CUBE, network, Learning(channels_last=True))
    optimizer = torch.optim.Adam(module.parameters())
    side = network.heatmap_px
    sample = {"heatmaps": torch.rand(batch, 8, side, side), "weights": torch.ones(batch, 8)}
    images = torch.rand(batch, 3, network.input_px, network.input_px)
    images = images.contiguous(memory_format=torch.channels_last)

    def step() -> None:
        loss = module.loss_of(module.network(images), sample)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return seconds(step, 2) / batch


def main() -> None:
    """Print the table."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        files = {suffix: write_dataset(folder, suffix) for suffix in ("jpg", "png")}
        images, labels = zip(*instances(files["jpg"]), strict=True)
        loop = samples_per_second(LoopAndResize(folder, list(images), list(labels)))
        plain = samples_per_second(TorchvisionPipeline(list(images), list(labels)))
        print(f"{'loop and resize':24s} {1e3 / loop:6.2f} ms a sample")
        print(f"{'torchvision v2, untuned':24s} {1e3 / plain:6.2f} ms a sample: {plain / loop:.1f}x")
        full = {"rotation_deg": 180.0}
        moves = v2.RandomAffine(30, scale=(0.75, 1.25), interpolation=v2.InterpolationMode.BILINEAR)
        for name, suffix, options in (
            ("JPEG", "jpg", {}),
            ("PNG", "png", {}),
            ("cache in memory", "jpg", {"cache": True}),
            ("cache on disk", "jpg", {"cache": folder / "cache"}),
            ("cache, no heatmaps", "jpg", {"cache": True, "heatmaps": False}),
            ("cache, full turns", "jpg", {"cache": True, "augment": Augmentation(**full)}),
            ("cache, light", "jpg", {"cache": True, "augment": Augmentation(light=0.4)}),
            ("cache, blur", "jpg", {"cache": True, "augment": Augmentation(blur_px=1.0)}),
            ("cache, noise", "jpg", {"cache": True, "augment": Augmentation(noise=0.03)}),
            ("cache, background", "jpg", {"cache": True, "augment": Augmentation(background=1.0)}),
            ("cache, torchvision moves", "jpg", {"cache": True, "transforms": moves}),
        ):
            rate = samples_per_second(KeypointDataset(files[suffix], **{"augment": Augmentation()} | options))
            ratios = f"{rate / loop:.1f}x the loop, {rate / plain:.1f}x torchvision's"
            print(f"{name:24s} {1e3 / rate:6.2f} ms a sample: {ratios}")
            for beside, other in (("loop and resize", loop), ("torchvision v2, untuned", plain)):
                work = f"keypoint sample, {name}, beside {beside}"
                record("torch", work, 1e3 / rate, "ms", baseline=(beside, 1e3 / other))
        print("asked: 20x the loop with the cache")
        for name, network in (("cpu preset", CPU), ("paper's network", Network())):
            sizes = {"input_px": network.input_px, "heatmap_px": network.heatmap_px}
            cached = KeypointDataset(files["jpg"], cache=True, augment=Augmentation(), **sizes)
            loading, learning = 1 / samples_per_second(cached), step_seconds(network, 4)
            share = loading / (loading + learning)
            print(
                f"{name}: loading {1e3 * loading:.2f} ms, learning {1e3 * learning:.1f} ms an image: "
                f"{share:.1%} of a step"
            )


if __name__ == "__main__":
    main()

"""Mask R-CNN: 8 images overfitted, cost of a step a preset, share of loading.

One core: python tests/bench/bench_masks.py [DATA], DATA a folder with train.json that `rpl export` wrote
(workspaces/demo/export/coco of `make demo` when left out).
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import cv2
import torch
from rows import record

from rpl_data.torch.transforms import Augmentation
from training.masks.crops import SquareCrops
from training.masks.evaluation import evaluate
from training.masks.mask_rcnn import build_model, with_norm
from training.masks.settings import MaskSettings, load_settings
from training.masks.weights import load_segmenter
from training.reproduce.segmentation.experiment import given
from training.train_masks import train_masks

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "training/configs"


def some_images(data: Path, count: int, folder: Path) -> Path:
    """A train.json of `count` images spread over `data`, all of which show an object."""
    content = json.loads((data / "train.json").read_text())
    shown = {annotation["image_id"] for annotation in content["annotations"]}
    images = [image for image in content["images"] if image["id"] in shown]
    images = images[:: max(1, len(images) // count)][:count]
    kept = {image["id"] for image in images}
    content["annotations"] = [a for a in content["annotations"] if a["image_id"] in kept]
    content["images"] = [{**i, "file_name": str((data / i["file_name"]).resolve())} for i in images]
    (folder / "train.json").write_text(json.dumps(content))
    return folder


def overfit(data: Path, epochs: int) -> None:
    """Train on 8 images until they are known by heart."""
    still = Augmentation(scale=0.0, shift=0.0, rotation_deg=0.0, gain=0.0, offset=0.0)
    cpu = load_settings(CONFIGS / "masks_cpu.yaml")
    larger, learning = replace(cpu.network, size_px=192), replace(cpu.learning, epochs=epochs, batch=2)
    settings = replace(cpu, network=larger, augment=still, learning=learning, validate_every=0)
    with tempfile.TemporaryDirectory() as place:
        folder = some_images(data, 8, Path(place))
        start = time.process_time()
        checkpoint = train_masks(folder, Path(place) / "run", **given(settings))
        score = evaluate(load_segmenter(checkpoint), folder / "train.json")
    for what, found, asked in (
        ("box AP50", score.box_ap50, 1.0),
        ("mask AP50", score.mask_ap50, 1.0),
        ("mean IoU", score.mean_iou, 0.9),
    ):
        work = f"8 images overfitted at 192 px: {what}"
        record("masks", work, found, "share", asked=asked, more_is_better=True)
    print(
        f"8 images, 192 px, {epochs} epochs: box AP50 {score.box_ap50:.3f}, mask AP50 {score.mask_ap50:.3f} "
        f"(asked 1.0), mean IoU {score.mean_iou:.3f} (asked 0.9); {time.process_time() - start:.0f} CPU s"
    )


@dataclass(frozen=True)
class Cost:
    """Of training, an image: CPU seconds of the step and of loading; memory in MB; the last step's loss."""

    step_s: float
    load_s: float
    memory_mb: float
    process_mb: float
    loss: float


def cost_of(settings: MaskSettings, data: Path, steps: int) -> Cost:
    """The best of `steps` training steps on one core, measured in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        return alone.submit(_cost, settings, data, steps).result()


def _cost(settings: MaskSettings, data: Path, steps: int) -> Cost:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    network, count = with_norm(settings.network, "scratch"), settings.learning.batch
    torch.manual_seed(0)
    crops = SquareCrops(data / "train.json", network.size_px, settings.augment)
    model = build_model(network, len(crops.names) - 1)
    optimizer = torch.optim.SGD(model.parameters(), lr=1e-4)
    before_mb = _peak_mb()
    loading, training = [], []
    for step in range(steps):
        start = time.process_time()
        batch = [crops[(step * count + n) % len(crops)] for n in range(count)]
        loaded = time.process_time()
        loss = sum(model([image for image, _ in batch], [target for _, target in batch]).values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        loading.append((loaded - start) / count)
        training.append((time.process_time() - loaded) / count)
    taken_mb = (_peak_mb() - before_mb) / count
    return Cost(min(training), min(loading), taken_mb, _peak_mb(), loss.item())


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def show(name: str, settings: MaskSettings, cost: Cost) -> None:
    """A line."""
    share = cost.load_s / (cost.step_s + cost.load_s)
    record("masks", f"{name}: a step per image", cost.step_s, "s CPU")
    record("masks", f"{name}: share of loading", share, "share", asked=0.05)
    print(
        f"{name:30s} {cost.step_s:6.3f} CPU s an image, loading {1e3 * cost.load_s:4.1f} ms = {share:.1%} "
        f"(asked < 5 %); {cost.memory_mb:.0f} MB an image in batches of {settings.learning.batch}, "
        f"the process {cost.process_mb:.0f} MB; loss from scratch {cost.loss:.2f}",
        flush=True,
    )


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?", default=ROOT / "workspaces/demo/export/coco")
    parser.add_argument("--epochs", type=int, default=80, help="of the overfitting")
    options = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    cpu, paper = (load_settings(CONFIGS / f"masks_{name}.yaml") for name in ("cpu", "paper"))
    wide = replace(cpu.network, size_px=192, stages=4, channels=256, hidden=1024, proposals=2000, rois=512)
    runs = {
        "cpu preset": (cpu, 5),
        "ResNet-18, 192 px, full width": (
            replace(cpu, network=wide, learning=replace(cpu.learning, batch=2)),
            2,
        ),
        "paper preset": (paper, 2),
    }
    costs = {name: cost_of(settings, options.data, steps) for name, (settings, steps) in runs.items()}
    for name, (settings, _) in runs.items():
        show(name, settings, costs[name])
    wide_s, cpu_s = (costs[name].step_s for name in ("ResNet-18, 192 px, full width", "cpu preset"))
    record("masks", "cpu preset", cpu_s, "s CPU", baseline=("torchvision's sizes at 192 px", wide_s))
    print(
        f"the cpu preset costs {wide_s / cpu_s:.1f} times less an image than torchvision's sizes at 192 px",
        flush=True,
    )
    overfit(options.data, options.epochs)


if __name__ == "__main__":
    main()

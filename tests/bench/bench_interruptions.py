"""Trainings that are killed again and again, against trainings that are not: do they end with equal weights?

Each training (hourglass, detector, Mask R-CNN) runs once without interruption. Then it runs again several
times; at a random step its process kills itself with SIGKILL, and the next process goes on with the run.

Run: python bench_interruptions.py [DATA] [--runs 5] [--kills 2] [--images 24]
DATA is a folder that `rpl export` wrote, workspaces/demo/export/coco of `make demo` when left out.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import tempfile
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rows import record, shared

from training.runs.callbacks import Steps
from training.runs.options import DetectorNetwork, Learning, Machine, MaskNetwork, Network
from training.train_detector import train_detector
from training.train_keypoints import train_keypoints
from training.train_masks import train_masks

ROOT = Path(__file__).parents[2]
EPOCHS, BATCH = 4, 4
ONE = Machine(accelerator="cpu", threads=1)
CYCLE = Learning(epochs=EPOCHS, batch=BATCH, optimizer="adam", rate=2e-3, schedule="one_cycle")
STAGED = Learning(
    epochs=EPOCHS, batch=BATCH, optimizer="adamw", rate=1e-3, warmup_steps=4, cooldown=0.5, clip=5.0
)


def keypoints(coco: Path, out: Path) -> None:
    """The hourglass of the first object."""
    name = json.loads((coco / "train.json").read_text())["categories"][0]["name"]
    network = Network(stacks=1, features=32, levels=3, input_px=64, heatmap_px=16, loss="entropy")
    train_keypoints(coco, name, out, network, CYCLE, machine=ONE, resume=True)


def detector(coco: Path, out: Path) -> None:
    """The small FCOS."""
    train_detector(coco, out, DetectorNetwork(width_px=128, features=32), CYCLE, machine=ONE, resume=True)


def ssdlite(coco: Path, out: Path) -> None:
    """Torchvision's SSDLite."""
    train_detector(coco, out, DetectorNetwork("ssdlite"), CYCLE, machine=ONE, resume=True)


def masks(coco: Path, out: Path) -> None:
    """Mask R-CNN, its heads for two epochs, then all of it."""
    network = MaskNetwork("resnet18", 64, stages=3, channels=32, hidden=64, proposals=100, rois=32)
    train_masks(
        coco, out, network, STAGED, machine=ONE, weights="scratch", head_epochs=EPOCHS // 2, resume=True
    )


def small_export(data: Path, folder: Path, images: int) -> Path:
    """Some images of an export's train and val, spread over it."""
    for split in ("train", "val"):
        content = json.loads((data / f"{split}.json").read_text())
        content["images"] = content["images"][:: max(1, len(content["images"]) // images)][:images]
        for image in content["images"]:
            image["file_name"] = str((data / image["file_name"]).resolve())
        kept = {image["id"] for image in content["images"]}
        content["annotations"] = [a for a in content["annotations"] if a["image_id"] in kept]
        (folder / f"{split}.json").write_text(json.dumps(content))
    return folder


def killed(train: Callable[[Path, Path], None], coco: Path, out: Path, step: int | None) -> int:
    """Run a training in a process that kills itself before a step, counted from its start; its exit code."""
    process = get_context("fork").Process(target=_killing, args=(train, coco, out, step))
    process.start()
    process.join()
    return process.exitcode or 0


def _killing(train: Callable[[Path, Path], None], coco: Path, out: Path, step: int | None) -> None:
    original, seen = Steps.on_train_batch_start, iter(range(10**9))

    def hooked(self: Steps, *arguments: Any) -> None:
        if next(seen) == step:
            os.kill(os.getpid(), signal.SIGKILL)
        original(self, *arguments)

    Steps.on_train_batch_start = hooked  # type: ignore[method-assign]
    # Only the verdict is of interest, not the lines of every run.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    train(coco, out)


def weights(run: Path) -> dict[str, torch.Tensor]:
    """Of its last checkpoint."""
    return dict(torch.load(run / "last.ckpt", weights_only=True)["state_dict"])


def equal(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    """Bit by bit."""
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def measure(train: Callable[[Path, Path], None], coco: Path, folder: Path, *, runs: int, kills: int) -> None:
    """Print how many of the killed runs end with the weights of the straight one."""
    straight = folder / "straight"
    killed(train, coco, straight, None)
    wanted, rng, same, moments = weights(straight), np.random.default_rng(0), 0, []
    steps = torch.load(straight / "last.ckpt", weights_only=True)["global_step"]
    for number in range(runs):
        out = folder / f"killed{number}"
        at = [int(rng.integers(1, steps)) for _ in range(kills)]
        deaths = [killed(train, coco, out, step) for step in at]
        moments.append("+".join(str(step) for step, code in zip(at, deaths, strict=True) if code < 0))
        killed(train, coco, out, None)
        same += equal(wanted, weights(out))
    work = f"{train.__name__}: killed runs that end with equal weights"
    record("interruptions", work, same / runs, "share", asked=1.0, more_is_better=True)
    said = f"{same} of {runs} killed runs end with equal weights (asked {runs})"
    print(f"{train.__name__:10s} {steps} steps, killed before step {', '.join(moments)}: {said}", flush=True)


def main() -> None:
    """Print one line per training."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?", default=ROOT / "workspaces/demo/export/coco")
    parser.add_argument("--runs", type=int, default=shared(5), help="runs that are killed, per training")
    parser.add_argument("--kills", type=int, default=2, help="how often each is killed, at most")
    parser.add_argument("--images", type=int, default=24, help="images of the export that are trained on")
    told = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as place:
        coco = small_export(told.data, Path(place), told.images)
        for train in (keypoints, detector, ssdlite, masks):
            measure(train, coco, Path(place) / train.__name__, runs=told.runs, kills=told.kills)


if __name__ == "__main__":
    main()

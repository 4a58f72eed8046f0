"""The share of a training step that is spent loading, per preset: our programs, one core, some images.

The first epoch decodes; the share is that of the epochs after it. Loading is in the training process
(`machine.workers 0`), so the share is also what worker processes can save. A GPU that trains N crops a second
needs N times the time per sample, in worker processes.

Run: python tests/bench/bench_loading.py [DATA] [--only keypoints_cpu ...]
DATA is a folder that `rpl export` wrote, workspaces/demo/export/coco of `make demo` when left out.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rows import record

import training.runs.trainer as trainer
from rpl_data.dataset import Wanted, filter_dataset
from rpl_data.files import read_json
from training.runs.callbacks import Steps

ROOT = Path(__file__).parents[2]
EPOCHS = 3


@dataclass(frozen=True)
class Little:
    """What a preset is measured on.

    Attributes:
        program: of `training/`.
        images: about how many images.
        batch: samples per step; the preset's when None.
    """

    program: str
    images: int
    batch: int | None = None


PRESETS = {
    "keypoints_cpu": Little("train_keypoints", 120),
    "keypoints_scenes": Little("train_keypoints", 120),
    "keypoints_paper": Little("train_keypoints", 10, batch=2),
    "detector_cpu": Little("train_detector", 48),
    "masks_cpu": Little("train_masks", 32),
}


class Timed(Steps):
    """Keeps when each epoch began and ended, and how long it had waited for images by then."""

    marks: list[tuple[float, float, int]] = []  # noqa: RUF012 (emptied before each training)

    def on_train_epoch_start(self, *told: Any) -> None:
        """Mark the start."""
        super().on_train_epoch_start(*told)
        self._mark(told[0])

    def on_train_epoch_end(self, loop: Any, module: Any) -> None:
        """Mark the end."""
        self._mark(loop)

    def _mark(self, loop: Any) -> None:
        self.marks.append((time.perf_counter(), self.waiting_s, loop.global_step))


def some(coco: Path, out: Path, count: int) -> str:
    """Write about so many images, of a few per second; the name of an object in them comes back."""
    data = read_json(coco / "train.json")
    times: dict[str, list[float]] = {}
    for image in data["images"]:
        times.setdefault(image["scene"], []).append(image["timestamp_s"])
    seconds = sum(max(one) - min(one) for one in times.values())
    filter_dataset(out, coco, Wanted(rate_hz=max(count / max(seconds, 1e-3), 0.01)))
    return str(data["categories"][0]["name"])


def measure(coco: Path, preset: str, little: Little, folder: Path) -> None:
    """Train for some epochs; record the share of loading, and its time per sample."""
    name = some(coco, folder / preset, little.images)
    program = getattr(import_module(f"training.{little.program}"), little.program)
    told = [
        str(folder / preset), "--config", preset, "--out", str(folder / f"{preset}_run"),
        "--learning.epochs", str(EPOCHS), "--machine.workers", "0", "--machine.threads", "1",
        "--machine.accelerator", "cpu", "--validate_every", "0",
    ]  # fmt: skip
    told += ["--object", name] if little.program == "train_keypoints" else []
    told += ["--learning.batch", str(little.batch)] if little.batch else []
    Timed.marks.clear()
    from training.runs.program import main

    if main(program, told, presets=True):
        raise SystemExit(f"{preset} failed")
    marks = np.array(Timed.marks[2:]).reshape(-1, 2, 3)  # without the first epoch
    wall_s, waiting_s, steps = (marks[:, 1] - marks[:, 0]).sum(axis=0)
    record("loading", f"{preset}: share of a step spent loading", 100 * waiting_s / wall_s, "%")
    print(
        f"{preset}: {waiting_s / wall_s:.1%} of a step of {1e3 * wall_s / steps:.0f} ms spent loading "
        f"({1e3 * waiting_s / steps:.1f} ms)"
    )


def main() -> None:
    """Measure the presets that are asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("data", nargs="?", type=Path, default=ROOT / "workspaces/demo/export/coco")
    parser.add_argument("--only", nargs="+", choices=list(PRESETS), default=list(PRESETS))
    told = parser.parse_args()
    trainer.Steps = Timed  # type: ignore[misc]  # a wrapper around what every training does
    with tempfile.TemporaryDirectory() as folder:
        for preset in told.only:
            measure(told.data, preset, PRESETS[preset], Path(folder))


if __name__ == "__main__":
    main()

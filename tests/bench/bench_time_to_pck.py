"""CPU time to the same PCK: the paper's hourglass against the cpu preset, and what each of its choices buys.

The paper's network (2 stacks of 256 features at 256 px, fp32, its loss, optimizer and rate) trains for a
while on one thread; the presets then train on the same instances until they reach its PCK on val. Time
counts training and loading, not validation.

No PCK is above 1: `--goal 0.99 --minutes 30` says how much sooner than 30 minutes the presets have nearly
all there is, whatever the paper's network has by then.

Run: python bench_time_to_pck.py [DATA] [--object NAME] [--minutes 30] [--goal PCK] [--only cpu ...]
DATA is a folder that `rpl export` wrote, workspaces/demo/export/coco of `make demo` when left out.
"""

from __future__ import annotations

import argparse
import logging
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from pytorch_lightning import Callback, LightningModule, Trainer, seed_everything
from rows import record, shared

from rpl_data.torch.datamodule import KeypointDataModule
from rpl_data.torch.transforms import Augmentation
from training.keypoints.module import PCK_SHARE, distances_by_box, untrained
from training.runs.callbacks import Steps
from training.runs.options import Learning, Network
from training.train_keypoints import train_keypoints

ROOT = Path(__file__).parents[2]
PAPER_BATCH = 4
"""Images a step of the paper's network here: as much of an epoch's worth of steps as the time allows."""

ASKED = 5.0
LEAST_GOAL = 0.3
"""A PCK below this tells nothing: a network that puts all keypoints into the middle of the box is near it."""


@dataclass(frozen=True)
class Preset:
    """What is trained, and how."""

    network: Network
    learning: Learning
    augment: Augmentation


def preset(name: str) -> Preset:
    """Of training/configs/keypoints_<name>.yaml."""
    from jsonargparse import ArgumentParser

    parser = ArgumentParser()
    parser.add_argument("--config", action="config")
    parser.add_function_arguments(train_keypoints)
    told = parser.parse_args([f"--config={ROOT}/training/configs/keypoints_{name}.yaml", "--coco=."])
    made = parser.instantiate_classes(told)
    return Preset(made.network, made.learning, made.augment)


def presets() -> dict[str, Preset]:
    """The cpu preset, and the cpu preset with one of its choices undone, or all about the learning."""
    cpu, paper = preset("cpu"), preset("paper")
    paper_rule = {name: getattr(paper.learning, name) for name in ("optimizer", "rate", "schedule")}
    wide = replace(cpu.network, stacks=paper.network.stacks, features=paper.network.features)
    return {
        "cpu": cpu,
        "cpu, the paper's loss": replace(cpu, network=replace(cpu.network, loss="squares")),
        "cpu, the paper's optimizer": replace(cpu, learning=replace(cpu.learning, **paper_rule)),
        "cpu, the paper's width and stacks": replace(cpu, network=wide),
    }


class Clock(Callback):
    """PCK on val every so many seconds of training; stops at a PCK or when the time is up.

    Attributes:
        seen: (CPU seconds of training, PCK) of each validation.
    """

    def __init__(self, data: KeypointDataModule, *, every_s: float, most_s: float, goal: float) -> None:
        self._data, self._every_s, self._most_s, self._goal = data, every_s, most_s, goal
        self._started, self._validating_s = 0.0, 0.0
        self.seen: list[tuple[float, float]] = []

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """The clock starts."""
        self._started = time.process_time()

    def on_train_batch_end(self, trainer: Trainer, module: LightningModule, *_: Any) -> None:
        """Validate when it is time."""
        now = time.process_time()
        trained_s = now - self._started - self._validating_s
        if trained_s >= self._every_s * (len(self.seen) + 1) or trained_s >= self._most_s:
            self.seen.append((trained_s, pck(module, self._data)))
            trainer.should_stop = self.seen[-1][1] >= self._goal or trained_s >= self._most_s
            self._validating_s += time.process_time() - now


@torch.no_grad()
def pck(module: LightningModule, data: KeypointDataModule) -> float:
    """Share of val's keypoints within `PCK_SHARE` of the box."""
    module.eval()
    right = torch.cat(
        [
            distances_by_box(
                module.keypoints_in_image(batch["image"], batch["crop_from_image"]).positions, batch
            )
            < PCK_SHARE
            for batch, _ in data.val_dataloader()
        ]
    )
    module.train()
    return float(right.double().mean())


def trained(
    coco: Path, name: str | None, given: Preset, *, most_s: float, every_s: float, goal: float = 2.0
) -> list[tuple[float, float]]:
    """CPU seconds and PCK at each validation of a training; `goal` above 1 is never reached."""
    logging.getLogger("pytorch_lightning").setLevel(
        logging.ERROR
    )  # about workers, which cached crops need not
    seed_everything(0, verbose=False)
    sizes = {key: getattr(given.network, key) for key in ("input_px", "heatmap_px", "sigma_px")}
    data = KeypointDataModule(coco, object=name, batch=given.learning.batch, augment=given.augment, **sizes)
    clock = Clock(data, every_s=every_s, most_s=most_s, goal=goal)
    trainer = Trainer(
        max_epochs=given.learning.epochs,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        use_distributed_sampler=False,
        callbacks=[Steps(given.learning, seed=0), clock],
    )
    trainer.fit(untrained(data.train.model, given.network, given.learning), data.train_dataloader())
    return clock.seen


def main() -> None:
    """Print time and PCK of each, and how much sooner the presets are there."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, default=ROOT / "workspaces/demo/export/coco")
    parser.add_argument("--object", default="carton", help="one of the dataset's objects")
    parser.add_argument(
        "--minutes", type=float, default=float(shared(5, least=2)), help="CPU minutes of the paper's network"
    )
    parser.add_argument("--only", nargs="+", choices=list(presets()), default=list(presets())[: shared(4)])
    parser.add_argument("--goal", type=float, help="a PCK to reach; the paper's network is left out")
    told = parser.parse_args()
    torch.set_num_threads(1)
    if told.goal is not None:
        reach(told.data, told.object, told.only, needed_s=60 * told.minutes, goal=told.goal)
    else:
        measure(told.data, told.object, most_s=60 * told.minutes, names=told.only)


def measure(coco: Path, name: str | None, *, most_s: float, names: list[str]) -> None:
    """The paper's network first, then the presets against it."""
    paper = preset("paper")
    paper = replace(paper, learning=replace(paper.learning, batch=PAPER_BATCH, epochs=10_000))
    seen = trained(coco, name, paper, most_s=most_s, every_s=most_s / 5)
    print("paper's network: " + ", ".join(f"{s:.0f} s PCK {right:.3f}" for s, right in seen), flush=True)
    needed_s, goal = max(seen, key=lambda each: each[1])  # its best, when it first had it
    if goal < LEAST_GOAL:
        print(f"in {most_s:.0f} s it learnt too little to compare; give it more --minutes", flush=True)
        return
    reach(coco, name, names, needed_s=needed_s, goal=goal)


def reach(coco: Path, name: str | None, names: list[str], *, needed_s: float, goal: float) -> None:
    """How much sooner than `needed_s` the presets have that PCK; half of it is the most they get."""
    for key in names:
        seen = trained(coco, name, presets()[key], most_s=needed_s / 2, every_s=needed_s / 200, goal=goal)
        took_s, right = seen[-1]
        if right >= goal:
            longer = ("the paper's network", needed_s)
            record("time_to_pck", f"{key}, to PCK {goal:.2f}", took_s, "s CPU", baseline=longer, asked=ASKED)
        said = f"{needed_s / took_s:.1f}x sooner (asked {ASKED:.0f})" if right >= goal else "not reached"
        print(f"{key}: {took_s:.0f} s PCK {right:.3f}: {said}", flush=True)


if __name__ == "__main__":
    main()

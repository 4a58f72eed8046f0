"""Train Mask R-CNN on an exported dataset: `python -m training.train_masks --help`."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import torch

from training.masks.module import train
from training.masks.settings import Settings


def train_masks(
    settings: Settings,
    data: Path,
    out: Path = Path("runs/masks"),
    threads: int | None = None,
) -> None:
    """Train Mask R-CNN; interrupt it whenever you like and run it again: it goes on after its last epoch.

    Args:
        settings: training/configs/masks_cpu.yaml and masks_paper.yaml hold them (`--config FILE`).
        data: folder of train.json, as `rpl export` writes it (export/coco of a workspace).
        out: folder for the checkpoint and the logs.
        threads: processor cores to use; as many as there are when left out.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    done = train(settings, data, out)
    share = done.seconds_waiting / done.seconds
    print(f"{done.checkpoint}: {done.epochs} epochs, {done.seconds:.0f} s, {share:.1%} of it loading images")


if __name__ == "__main__":
    from training.runs.program import main

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    sys.exit(main(train_masks))

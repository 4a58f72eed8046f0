"""Train one object's stacked hourglass: `python -m training.train_keypoints --help`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError
from training.runs.options import Learning, Machine, Network

if TYPE_CHECKING:
    from training.keypoints.module import KeypointTraining


def train_keypoints(
    coco: Path,
    object: str | None = None,  # noqa: A002 (the recipe's and the CLI's word for it)
    out: Path = Path("runs/keypoints"),
    network: Network = Network(),  # noqa: B008 (frozen)
    learning: Learning = Learning(),  # noqa: B008
    augment: Augmentation = Augmentation(),  # noqa: B008
    machine: Machine = Machine(),  # noqa: B008
    cache: bool = True,
    validate_every: int = 1,
    seed: int = 0,
    resume: bool = False,
) -> Path:
    """Train an hourglass on one object; the path of its last checkpoint comes back.

    Presets: --config training/configs/keypoints_paper.yaml (a GPU) or keypoints_cpu.yaml (minutes on a
    CPU); any option after it wins. Writes last.ckpt, best.ckpt, metrics.csv and TensorBoard's events.

    Args:
        coco: folder of `rpl export`: export/coco, or export/coco_truth for true labels.
        object: its name; may be left out when the dataset has one object.
        out: folder of the run.
        network: its size, its input, its loss.
        learning: how long, how fast.
        augment: how far training crops may stray from the box.
        machine: device, precision, processes.
        cache: keep the decoded pixels around the boxes in memory.
        validate_every: epochs.
        seed: of everything drawn at random.
        resume: go on from last.ckpt of `out`.
    """
    import torch
    from pytorch_lightning import seed_everything

    from rpl_data.torch.datamodule import KeypointDataModule
    from training.keypoints.module import untrained
    from training.runs.trainer import trainer_of

    if machine.threads is not None:
        torch.set_num_threads(machine.threads)
    seed_everything(seed, workers=True, verbose=False)
    data = KeypointDataModule(
        coco,
        object=object,
        input_px=network.input_px,
        heatmap_px=network.heatmap_px,
        sigma_px=network.sigma_px,
        batch=learning.batch,
        augment=augment,
        workers=machine.workers,
        cache=cache,
    )
    module = untrained(data.train.model, network, learning)
    last = out / "last.ckpt"
    if resume and last.exists():
        check_resumable(last, module)
    trainer = trainer_of(
        out,
        epochs=learning.epochs,
        machine=machine,
        validate_every=validate_every,
        monitor="val_pck" if data.val is not None else None,
    )
    print(f"{data.train.model.name}: {len(data.train)} instances to train, {len(data.val or [])} to validate")
    started = time.process_time()
    trainer.fit(module, data, ckpt_path=str(last) if resume and last.exists() else None, weights_only=True)
    print(f"{last}: {time.process_time() - started:.0f} s of CPU time")
    for message, count in sorted(module.unreadable.items()):
        print(f"left out {count} times: {message}")
    return last


def check_resumable(checkpoint: Path, module: KeypointTraining) -> None:
    """DataError unless the checkpoint is of the same object and network."""
    from training.keypoints.module import check_same_object, load_keypoints

    trained = load_keypoints(checkpoint)
    check_same_object(trained, module.model, source=str(checkpoint))
    if trained.options != module.options:
        raise DataError(
            f"{checkpoint} is of a network {trained.options}, asked for is {module.options}; resume with the "
            "options it was started with, or train into another folder"
        )


if __name__ == "__main__":
    from training.runs.program import main

    sys.exit(main(train_keypoints))

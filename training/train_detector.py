"""Train the detector of all objects of a dataset: `python -m training.train_detector --help`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError
from training.runs.options import DetectorNetwork, Learning, Machine

if TYPE_CHECKING:
    from rpl_data.torch.detection import DetectionDataset

UPRIGHT = Augmentation(rotation_deg=0.0)


def train_detector(
    coco: Path,
    out: Path = Path("runs/detector"),
    network: DetectorNetwork = DetectorNetwork(),  # noqa: B008 (frozen)
    learning: Learning = Learning(),  # noqa: B008
    augment: Augmentation = UPRIGHT,
    machine: Machine = Machine(),  # noqa: B008
    validate_every: int = 1,
    seed: int = 0,
    resume: bool = False,
) -> Path:
    """Train one detector on all objects; the path of its last checkpoint comes back.

    Presets: --config training/configs/detector_paper.yaml (a GPU) or detector_cpu.yaml (minutes on a CPU);
    any option after it wins. Writes last.ckpt, best.ckpt, metrics.csv and TensorBoard's events.

    Args:
        coco: folder of `rpl export`: export/coco, or export/coco_truth for true labels.
        out: folder of the run.
        network: which, and how large.
        learning: how long, how fast.
        augment: shift (a share of the width), zoom and colours; rotation_deg must be 0.
        machine: device, precision, processes.
        validate_every: epochs.
        seed: of everything drawn at random.
        resume: go on from last.ckpt of `out`.
    """
    import torch
    from pytorch_lightning import seed_everything

    from rpl_data.torch.detection import DetectionDataset
    from training.detection.module import load_detector, untrained_detector
    from training.runs.trainer import trainer_of

    if machine.threads is not None:
        torch.set_num_threads(machine.threads)
    seed_everything(seed, workers=True, verbose=False)
    train = DetectionDataset(coco / "train.json", width_px=network.width_px, augment=augment)
    module = untrained_detector(train.names, network, learning)
    last = out / "last.ckpt"
    going_on = resume and last.exists()
    if going_on and (load_detector(last).names, load_detector(last).options) != (module.names, network):
        raise DataError(f"{last} is of other objects or another network; train into another folder")
    val = _loaders(coco / "val.json", network, learning, machine)
    trainer = trainer_of(
        out,
        epochs=learning.epochs,
        machine=machine,
        validate_every=validate_every,
        monitor="val_found" if val else None,
    )
    print(f"{', '.join(train.names[1:])}: {len(train)} images to train")
    started = time.process_time()
    trainer.fit(
        module,
        _loader(train, learning, machine, shuffle=True),
        val or None,
        ckpt_path=str(last) if going_on else None,
        weights_only=True,
    )
    print(f"{last}: {time.process_time() - started:.0f} s of CPU time")
    for message, count in sorted(module.unreadable.items()):
        print(f"left out {count} times: {message}")
    return last


def _loaders(coco_json: Path, network: DetectorNetwork, learning: Learning, machine: Machine) -> list[Any]:
    """The validation set's loader; none where there is nothing to validate on."""
    from rpl_data.formats.datasets.coco import read_coco
    from rpl_data.torch.detection import DetectionDataset

    if not coco_json.exists() or not read_coco(coco_json)["images"]:
        return []
    return [_loader(DetectionDataset(coco_json, width_px=network.width_px), learning, machine, shuffle=False)]


def _loader(dataset: DetectionDataset, learning: Learning, machine: Machine, *, shuffle: bool) -> Any:
    from torch.utils.data import DataLoader

    from rpl_data.torch.readable import Readable
    from training.detection.module import collate_detection

    return DataLoader(
        Readable(dataset),
        batch_size=learning.batch,
        shuffle=shuffle,
        num_workers=machine.workers,
        persistent_workers=machine.workers > 0,
        collate_fn=collate_detection,
    )


if __name__ == "__main__":
    from training.runs.program import main

    sys.exit(main(train_detector))

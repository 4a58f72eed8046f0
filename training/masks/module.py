"""Mask R-CNN in training: a Lightning module whose every step depends on seed and epoch only."""

from __future__ import annotations

import logging
import sys
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import pytorch_lightning as lightning
import torch
from pytorch_lightning.callbacks import ModelCheckpoint
from pytorch_lightning.loggers import CSVLogger, TensorBoardLogger
from torch import Tensor
from torch.utils.data import DataLoader

from rpl_data.torch.instances import InstanceSample, InstanceTarget
from rpl_data.types import DataError
from training.masks.crops import SquareCrops, crop_loader
from training.masks.mask_rcnn import build_model, train_body, with_norm
from training.masks.settings import Settings, comparable, learning_rate
from training.masks.weights import description, load_weights, read_file

log = logging.getLogger(__name__)

CHECKPOINT = "last.ckpt"

Batch = tuple[list[Tensor], list[InstanceTarget]]


class MaskTraining(lightning.LightningModule):
    """A network in training. Everything random depends on seed, epoch and step, so a run can be resumed."""

    def __init__(self, settings: Settings, data: Path) -> None:
        """Build the network and read the annotations of `data`/train.json."""
        super().__init__()
        self.settings = settings
        self.crops = SquareCrops(
            data / "train.json", settings.model.size_px, settings.augmentation, settings.seed
        )
        if not len(self.crops):
            raise DataError(f"{data / 'train.json'} has no images; export a dataset with a train split")
        torch.manual_seed(settings.seed)
        self.model = build_model(settings.model, len(self.crops.images.names) - 1)
        self.seconds_waiting, self._ready_s = 0.0, 0.0

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """All parameters from the start; those of a frozen ResNet have no gradient."""
        settings, parameters = self.settings, self.model.parameters()
        if settings.optimizer == "adamw":
            return torch.optim.AdamW(
                parameters, lr=settings.rate, weight_decay=settings.weight_decay, fused=True
            )
        return torch.optim.SGD(
            parameters, lr=settings.rate, momentum=0.9, weight_decay=settings.weight_decay, nesterov=True
        )

    def train_dataloader(self) -> DataLoader[InstanceSample]:
        """The batches of the current epoch."""
        settings = self.settings
        self.crops.epoch = self.current_epoch
        return crop_loader(self.crops, batch=settings.batch, workers=settings.workers, seed=settings.seed)

    def on_train_epoch_start(self) -> None:
        """Heads first, then all."""
        train_body(self.model, self.current_epoch >= self.settings.head_epochs)
        self._ready_s = time.perf_counter()

    def on_train_batch_start(self, batch: Batch, batch_idx: int) -> None:
        """Seed the network's own sampling of boxes, and set the learning rate."""
        self.seconds_waiting += time.perf_counter() - self._ready_s
        torch.manual_seed(self.settings.seed * 1_000_003 + self.global_step)
        steps = max(1, int(self.trainer.num_training_batches))
        rate = learning_rate(self.settings, self.global_step, steps)
        for group in self.optimizers().param_groups:
            group["lr"] = rate
        self.log("rate", rate)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """The sum of torchvision's five losses; DataError naming the images when it is not finite."""
        images, targets = batch
        losses: dict[str, Tensor] = self.model(images, targets)
        total = torch.stack([*losses.values()]).sum()
        if not torch.isfinite(total):
            raise DataError(self._not_finite(losses, targets))
        for name, value in {**losses, "loss": total}.items():
            self.log(
                name, value, on_step=True, on_epoch=False, batch_size=len(images), prog_bar=name == "loss"
            )
        return total

    def on_train_batch_end(self, outputs: Any, batch: Batch, batch_idx: int) -> None:
        """From here to the next batch is the time that loading takes."""
        self._ready_s = time.perf_counter()

    def _not_finite(self, losses: dict[str, Tensor], targets: list[InstanceTarget]) -> str:
        bad = ", ".join(f"{name} = {value.item()}" for name, value in losses.items() if not value.isfinite())
        files = ", ".join(self.crops.images.file_name(target["image_id"]) for target in targets)
        return (
            f"epoch {self.current_epoch}, step {self.global_step}: {bad} on {files}; choose a lower rate or "
            "more warmup_steps, or look at these images"
        )

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """What is needed to build the network again, and to refuse to resume another run."""
        checkpoint["masks"] = description(self.settings.model, tuple(self.crops.images.names))
        checkpoint["settings"] = comparable(self.settings)


@dataclass(frozen=True)
class Trained:
    """A finished (or paused) run.

    Attributes:
        seconds: of this call. seconds_waiting: of these, for images to be loaded.
    """

    checkpoint: Path
    epochs: int
    seconds: float
    seconds_waiting: float


def train(settings: Settings, data: Path, out: Path, *, until: int | None = None) -> Trained:
    """Train, or go on where `out`/last.ckpt stopped.

    Args:
        settings: what to do; `settings.epochs` may differ from that of the run that is resumed.
        data: folder of train.json, as `rpl export` writes it.
        out: folder for the checkpoint and the logs (csv/, tensorboard/).
        until: pause after this epoch; the learning rate still follows `settings.epochs`.

    Raises:
        DataError: the data or weights cannot be read, `out` holds another run, or a loss is not finite.
    """
    _quiet()
    settings = replace(settings, model=with_norm(settings.model, settings.weights))
    module = MaskTraining(settings, data)
    checkpoint = out / CHECKPOINT
    if checkpoint.exists():
        _check_same_run(checkpoint, module)
    else:
        log.info(load_weights(module.model, settings.model, settings.weights))
    cv2.setNumThreads(1)  # its threads would fight with torch's
    trainer = _trainer(settings, out, until or settings.epochs)
    start = time.perf_counter()
    trainer.fit(module, ckpt_path=str(checkpoint) if checkpoint.exists() else None, weights_only=True)
    return Trained(checkpoint, trainer.current_epoch, time.perf_counter() - start, module.seconds_waiting)


def _trainer(settings: Settings, out: Path, epochs: int) -> lightning.Trainer:
    saver = ModelCheckpoint(
        dirpath=out, filename=Path(CHECKPOINT).stem, enable_version_counter=False, save_on_exception=False
    )
    return lightning.Trainer(
        max_epochs=epochs,
        accelerator=settings.accelerator,
        devices=1,
        precision=settings.precision,
        gradient_clip_val=settings.clip or None,
        callbacks=[saver],
        logger=[
            CSVLogger(out, name="csv", flush_logs_every_n_steps=20),
            TensorBoardLogger(out, name="tensorboard"),
        ],
        log_every_n_steps=1,
        reload_dataloaders_every_n_epochs=1,
        enable_model_summary=False,
        enable_progress_bar=sys.stderr.isatty(),
    )


def _quiet() -> None:
    """Silence what Lightning says at every start; its other warnings stay."""
    logging.getLogger("pytorch_lightning.utilities.rank_zero").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", message=".*Checkpoint directory .* exists and is not empty")
    warnings.filterwarnings("ignore", message=".*LeafSpec.*is deprecated")


def _check_same_run(checkpoint: Path, module: MaskTraining) -> None:
    found = read_file(checkpoint)
    wanted = comparable(module.settings)
    names = list(module.crops.images.names)
    if found["settings"] != wanted or found["masks"]["names"] != names:
        changed = [key for key in wanted if found["settings"].get(key) != wanted[key]] or ["classes"]
        raise DataError(
            f"{checkpoint} belongs to a run with another {', '.join(changed)}; choose another --out, or the "
            "settings it was started with"
        )

"""What all training programs share: learning options, a Lightning trainer, checkpoints."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar

import torch
from pytorch_lightning import Callback, LightningModule, Trainer
from pytorch_lightning.callbacks import ModelCheckpoint
from pytorch_lightning.loggers import CSVLogger, TensorBoardLogger

from rpl_data.types import DataError
from training.runs.options import Learning, Machine

Module = TypeVar("Module", bound=LightningModule)


class EpochLines(Callback):
    """One line an epoch on the terminal."""

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Loss, and what was validated."""
        validated = (trainer.current_epoch + 1) % (trainer.check_val_every_n_epoch or 1) == 0
        names = ["train_loss", *(("val_pck", "val_error", "val_found") if validated else ())]
        names = [name for name in names if name in trainer.callback_metrics]
        figures = ", ".join(f"{name} {float(trainer.callback_metrics[name]):.4f}" for name in names)
        print(f"epoch {trainer.current_epoch + 1}/{trainer.max_epochs}: {figures}", flush=True)


def trainer_of(
    out: Path, *, epochs: int, machine: Machine, validate_every: int = 1, monitor: str | None = None
) -> Trainer:
    """A trainer that writes last.ckpt (and best.ckpt by `monitor`), CSV and TensorBoard logs into `out`.

    Args:
        monitor: a logged figure of which more is better.
    """
    logging.getLogger("pytorch_lightning").setLevel(logging.WARNING)  # what it is not using is no news
    # Lightning advises more worker processes; cached crops want none.
    warnings.filterwarnings("ignore", message=".*does not have many workers.*")
    warnings.filterwarnings("ignore", message=".*number of training batches.*")
    warnings.filterwarnings("ignore", message=".*exists and is not empty.*")
    logs = _new_logs(out)
    loggers = [CSVLogger(out, name="", version=logs), TensorBoardLogger(out, name="", version=logs)]
    last = ModelCheckpoint(
        out, filename="last", enable_version_counter=False, every_n_epochs=1, save_on_train_epoch_end=True
    )
    best = ModelCheckpoint(out, filename="best", monitor=monitor, mode="max", enable_version_counter=False)
    return Trainer(
        max_epochs=epochs,
        accelerator=machine.accelerator,
        devices=machine.devices,
        precision=machine.precision,
        logger=loggers,
        callbacks=[EpochLines(), last, *([best] if monitor else [])],
        check_val_every_n_epoch=validate_every,
        num_sanity_val_steps=0,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=1,
    )


def _new_logs(out: Path) -> str:
    """A folder for logs that is not there yet: a run that goes on leaves what it logged before."""
    number = len(list(out.glob("logs*")))
    return f"logs{number}" if number else "logs"


def optimizer_of(module: LightningModule, learning: Learning) -> Any:
    """What `configure_optimizers` returns."""
    if learning.optimizer == "adam":
        optimizer: torch.optim.Optimizer = torch.optim.Adam(module.parameters(), lr=learning.rate)
    else:
        optimizer = torch.optim.RMSprop(module.parameters(), lr=learning.rate)
    if learning.schedule == "constant":
        return optimizer
    steps = int(module.trainer.estimated_stepping_batches)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, learning.rate, total_steps=steps)
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def stop_if_not_finite(loss: torch.Tensor, epoch: int, batch: int, image_ids: Sequence[int]) -> None:
    """DataError that names the batch when its loss is no number."""
    if not torch.isfinite(loss):
        raise DataError(
            f"the loss is {loss.item()} in epoch {epoch}, batch {batch}, images "
            f"{', '.join(str(image_id) for image_id in image_ids)} (ids of the COCO file); look at their "
            "labels, or lower the learning rate, and resume from the last checkpoint"
        )


def load_module(kind: type[Module], checkpoint: Path, program: str) -> Module:
    """The trained module of a checkpoint, ready to predict.

    Raises:
        DataError: it is missing, or no checkpoint of the program.
    """
    if not checkpoint.exists():
        raise DataError(f"there is no checkpoint {checkpoint}; train one with {program}")
    try:
        loaded = kind.load_from_checkpoint(checkpoint, map_location="cpu", weights_only=True)
    except (KeyError, TypeError, RuntimeError, OSError, UnpicklingError) as error:
        raise DataError(f"{checkpoint} is no checkpoint of {program}: {error}") from error
    return loaded.eval()


def trained_epochs(checkpoint: Path) -> int:
    """Epochs behind a checkpoint; 0 where there is none."""
    if not checkpoint.exists():
        return 0
    epochs: int = torch.load(checkpoint, map_location="cpu", weights_only=True)["epoch"] + 1
    return epochs

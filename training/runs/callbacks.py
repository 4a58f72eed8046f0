"""What happens during every training: reproducible steps, checkpoints, a line per epoch."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pytorch_lightning import Callback, LightningModule, Trainer
from torch import Tensor

from rpl_data.torch.epochs import seed_of

from .folder import BEST, LAST
from .options import Learning
from .schedule import set_step


class Steps(Callback):
    """Sets the seed and the learning rate of every step, so that they depend on the step alone.

    Attributes:
        waiting_s: seconds that the training waited for images.
        begun: whether the first epoch of this process has begun.
    """

    def __init__(self, learning: Learning, seed: int) -> None:
        self._learning, self._seed = learning, seed
        self.waiting_s, self._ready_s, self.begun = 0.0, 0.0, False

    def on_train_epoch_start(self, trainer: Trainer, module: LightningModule) -> None:
        """From here on the training waits for its first batch."""
        self._ready_s, self.begun = time.perf_counter(), True

    def on_train_batch_start(
        self, trainer: Trainer, module: LightningModule, batch: object, batch_idx: int
    ) -> None:
        """The seed is for what networks draw themselves, as Mask R-CNN draws boxes."""
        self.waiting_s += time.perf_counter() - self._ready_s
        torch.manual_seed(seed_of(self._seed, trainer.current_epoch, batch_idx, trainer.global_rank))
        per_epoch = int(trainer.num_training_batches)
        step = trainer.current_epoch * per_epoch + batch_idx
        rate = set_step(trainer.optimizers[0], self._learning, step, per_epoch)
        module.log("rate", rate, on_step=False, on_epoch=True, batch_size=1)

    def on_train_batch_end(
        self, trainer: Trainer, module: LightningModule, outputs: object, batch: object, batch_idx: int
    ) -> None:
        """From here on the training waits for its next batch."""
        self._ready_s = time.perf_counter()


class Checkpoints(Callback):
    """Writes last.ckpt after every epoch, and best.ckpt when a validated figure is better than ever.

    Each file is written under another name and then renamed. An interruption within an epoch therefore leaves
    the checkpoint of the epoch before, from which the interrupted epoch is trained again.
    """

    def __init__(self, out: Path, *, monitor: str, settings: Mapping[str, Any]) -> None:
        """`monitor` is a validated figure of which more is better; `settings` go into every checkpoint."""
        self._out, self._monitor, self._settings = out, monitor, settings
        self._best = -math.inf

    def on_validation_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Write best.ckpt; images that cannot be read may leave nothing to judge by."""
        figure = trainer.callback_metrics.get(self._monitor)
        better = figure is not None and float(figure) > self._best
        if figure is not None and trainer.strategy.broadcast(better):
            self._best = float(figure)
            trainer.save_checkpoint(self._out / BEST)

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Write last.ckpt."""
        trainer.save_checkpoint(self._out / LAST)

    def on_save_checkpoint(
        self, trainer: Trainer, module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """The settings are compared when the run is resumed."""
        checkpoint["run"] = dict(self._settings)

    def state_dict(self) -> dict[str, float]:
        """The best figure so far."""
        return {"best": self._best}

    def load_state_dict(self, state_dict: dict[str, float]) -> None:
        """The best figure before the interruption."""
        self._best = state_dict["best"]

    def on_load_checkpoint(
        self, trainer: Trainer, module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """In checkpoints of version 0.1 the best figure is that of Lightning's ModelCheckpoint."""
        for name, state in checkpoint.get("callbacks", {}).items():
            score = state.get("best_model_score") if name.startswith("ModelCheckpoint") else None
            if isinstance(score, Tensor):
                self._best = float(score)


class EpochLines(Callback):
    """Prints one line per epoch, and logs the CPU time at each validation."""

    def on_validation_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """CPU seconds of this process so far, as `cpu_s`."""
        module.log("cpu_s", time.process_time())

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """The loss, and the figures of the validation where there was one."""
        if not trainer.is_global_zero:
            return
        metrics = trainer.callback_metrics
        validated = (trainer.current_epoch + 1) % (trainer.check_val_every_n_epoch or 1) == 0
        names = [name for name in metrics if name.startswith("val_") and name != "val_loss" and validated]
        shown = [f"{name} {float(metrics[name]):.4f}" for name in ["train_loss", *names] if name in metrics]
        print(f"epoch {trainer.current_epoch + 1}/{trainer.max_epochs}: {', '.join(shown)}", flush=True)

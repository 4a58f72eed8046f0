"""What happens during every training: reproducible steps, checkpoints, a line per epoch."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pytorch_lightning import Callback, LightningModule, Trainer
from torch import Tensor

from rpl_data.torch.epochs import seed_of
from rpl_data.types import DataError
from rpl_data.wording import counted

from .folder import BEST, LAST
from .network_module import NetworkModule
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
        self.waiting_s, self._ready_s, self.begun, self._learned = 0.0, 0.0, False, False

    def on_train_epoch_start(self, trainer: Trainer, module: LightningModule) -> None:
        """From here on the training waits for its first batch."""
        self._ready_s, self.begun, self._learned = time.perf_counter(), True, False

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
        self, trainer: Trainer, module: LightningModule, outputs: object, batch: Any, batch_idx: int
    ) -> None:
        """From here on the training waits for its next batch.

        Raises:
            DataError: no process could read an image of the epoch, so that nothing was learned in it.
        """
        self._ready_s = time.perf_counter()
        self._learned |= bool(batch[0])  # processes that train together take a step without images, too
        if not trainer.is_last_batch:
            return
        learned = torch.tensor(float(self._learned), device=module.device)
        if not trainer.strategy.reduce(learned, reduce_op="sum"):
            assert isinstance(module, NetworkModule)
            raise DataError(
                f"no image of epoch {trainer.current_epoch + 1} could be read, so nothing was learned; "
                f"the first of them: {next(iter(module.unreadable), 'another process names it')}"
            )


class Checkpoints(Callback):
    """Writes last.ckpt after every epoch, and best.ckpt when a validated figure is better than ever.

    Each file is written under another name and then renamed. An interruption within an epoch therefore leaves
    the checkpoint of the epoch before, from which the interrupted epoch is trained again.
    """

    def __init__(self, out: Path, *, monitor: str, settings: Mapping[str, Any], patience: int = 0) -> None:
        """Start without a best figure.

        Args:
            out: folder of the checkpoints.
            monitor: a validated figure of which more is better.
            settings: go into every checkpoint.
            patience: the training ends after so many validations in a row without a better figure; 0 trains
                on.
        """
        self._out, self._monitor, self._settings, self._patience = out, monitor, settings, patience
        self._best, self._in_vain = -math.inf, 0

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """A training that had ended for want of a better figure does not go on."""
        self._stop_in_vain(trainer)

    def on_validation_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Write best.ckpt; images that cannot be read may leave nothing to judge by."""
        figure = trainer.callback_metrics.get(self._monitor)
        better = figure is not None and float(figure) > self._best
        if figure is None:
            return
        if trainer.strategy.broadcast(better):
            self._best, self._in_vain = float(figure), 0
            trainer.save_checkpoint(self._out / BEST)
        else:
            self._in_vain += 1
            self._stop_in_vain(trainer)

    def _stop_in_vain(self, trainer: Trainer) -> None:
        if self._patience and self._in_vain >= self._patience:
            trainer.should_stop = True
            if trainer.is_global_zero:
                validations = counted(self._in_vain, "validation")
                print(f"stops: {self._monitor} is no better after {validations} (learning.patience)")

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Write last.ckpt."""
        trainer.save_checkpoint(self._out / LAST)

    def on_save_checkpoint(
        self, trainer: Trainer, module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """The settings are compared when the run is resumed."""
        checkpoint["run"] = dict(self._settings)

    def state_dict(self) -> dict[str, float]:
        """The best figure so far, and how many validations were no better since."""
        return {"best": self._best, "in_vain": self._in_vain}

    def load_state_dict(self, state_dict: dict[str, float]) -> None:
        """The best figure before the interruption."""
        self._best = state_dict["best"]
        self._in_vain = int(state_dict.get("in_vain", 0))

    def on_load_checkpoint(
        self, trainer: Trainer, module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """In checkpoints of version 0.1 the best figure is that of Lightning's ModelCheckpoint."""
        for name, state in checkpoint.get("callbacks", {}).items():
            score = state.get("best_model_score") if name.startswith("ModelCheckpoint") else None
            if isinstance(score, Tensor):
                self._best = float(score)


def refuse_idle_patience(learning: Learning, *, can_validate: bool) -> None:
    """Raise a DataError where a training would wait for better validations without images for them."""
    if learning.patience and not can_validate:
        raise DataError(
            "learning.patience counts validations, and the export has no images to validate on; hold some "
            "out by --validate_scenes, write `split: {val_fraction: 0.1}` in the recipe, or leave it out"
        )


class LastEpochValidated(Callback):
    """Validates after the last epoch, whatever `validate_every` says: a short run has a best.ckpt, too."""

    def __init__(self, epochs: int) -> None:
        """`epochs` are those of the whole run."""
        self._epochs = epochs

    def on_train_epoch_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Let Lightning validate at the end of this epoch."""
        if trainer.current_epoch + 1 == self._epochs:
            trainer.check_val_every_n_epoch = 1


class EpochLines(Callback):
    """Prints one line per epoch with the time left, and logs the CPU time at each validation.

    Where a person watches, a line that is written over says how far the epoch is.
    """

    def __init__(self) -> None:
        self._started_s, self._first, self._shown_s = 0.0, 0, 0.0

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """From here on time is measured; a resumed training begins at a later epoch."""
        self._started_s, self._first = time.perf_counter(), trainer.current_epoch

    def on_train_batch_end(
        self, trainer: Trainer, module: LightningModule, outputs: object, batch: object, batch_idx: int
    ) -> None:
        """Twice a second on a terminal: epoch, step, time left."""
        now_s = time.perf_counter()
        if not (trainer.is_global_zero and sys.stderr.isatty()) or now_s - self._shown_s < 0.5:
            return
        self._shown_s = now_s
        steps = int(trainer.num_training_batches)
        done = trainer.current_epoch + (batch_idx + 1) / steps
        where = f"epoch {trainer.current_epoch + 1}/{trainer.max_epochs}, step {batch_idx + 1}/{steps}"
        print(f"\r{where}{self._left(trainer, done)}\x1b[K", end="", file=sys.stderr, flush=True)

    def on_validation_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """CPU seconds of this process so far, as `cpu_s`."""
        module.log("cpu_s", time.process_time())

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """The loss, the figures of the validation where there was one, and the time left."""
        metrics, done = trainer.callback_metrics, trainer.current_epoch + 1  # all processes average them
        if not trainer.is_global_zero:
            return
        validated = done % (trainer.check_val_every_n_epoch or 1) == 0
        names = [name for name in metrics if name.startswith("val_") and not name.endswith("_loss")]
        names = ["train_loss", *(names if validated else [])]
        shown = [f"{name} {float(metrics[name]):.4f}" for name in names if name in metrics]
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
        left = self._left(trainer, done)
        print(f"epoch {done}/{trainer.max_epochs}: {', '.join(shown)}{left}", flush=True)

    def _left(self, trainer: Trainer, done: float) -> str:
        """How long the other epochs will take, if they take as long as those before."""
        epochs = max(done - self._first, 1e-9)
        left_s = (time.perf_counter() - self._started_s) / epochs * ((trainer.max_epochs or 0) - done)
        return f"; {time_left(left_s)} left" if left_s >= 1 else ""


def time_left(seconds: float) -> str:
    """A duration as a person would say it: 42 s, 7 min, 3 h 20 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"

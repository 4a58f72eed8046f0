"""A moving average of the weights (EMA), which is validated and kept in place of the last step's weights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from pytorch_lightning import Callback, LightningModule, Trainer
from torch import Tensor

TRAINED = "trained_state_dict"
"""Where checkpoints hold the weights of the last step; their `state_dict` is the average."""


class WeightAverage(Callback):
    """Averages the weights over the steps; every checkpoint's `state_dict` is the average.

    The share of the average that a step leaves is ``min(decay, (1 + t) / (10 + t))`` after t steps, so that
    the random weights of the beginning are soon forgotten. Running statistics of batch normalisation are
    averaged alike.
    """

    def __init__(self, decay: float) -> None:
        """`decay` is the share of the average that a step leaves, once there were many: 0.999, say."""
        self._decay, self._steps = decay, 0
        self._average: dict[str, Tensor] = {}
        self._trained: dict[str, Tensor] = {}

    @torch.no_grad()
    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Start at the weights as they are, or go on with the average of a checkpoint."""
        for key, value in module.state_dict().items():
            self._average[key] = self._average.get(key, value).to(value.device, copy=True)

    @torch.no_grad()
    def on_train_batch_end(
        self, trainer: Trainer, module: LightningModule, outputs: object, batch: object, batch_idx: int
    ) -> None:
        """Move the average towards the weights after a step; counters are taken as they are."""
        self._steps += 1
        share = 1 - min(self._decay, (1 + self._steps) / (10 + self._steps))
        averages, values = [], []
        for key, value in module.state_dict().items():
            if value.is_floating_point():
                averages.append(self._average[key])
                values.append(value)
            else:
                self._average[key].copy_(value)
        torch._foreach_lerp_(averages, values, share)

    def on_validation_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Validate the average."""
        self._trained = {key: value.clone() for key, value in module.state_dict().items()}
        module.load_state_dict(self._average)

    def on_validation_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Train on with the weights of the last step."""
        module.load_state_dict(self._trained)
        self._trained = {}

    def on_save_checkpoint(
        self, trainer: Trainer, module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Whoever loads the checkpoint gets the average; a resumed training needs both."""
        checkpoint[TRAINED] = checkpoint["state_dict"]
        checkpoint["state_dict"] = {key: value.clone() for key, value in self._average.items()}

    def on_load_checkpoint(
        self, trainer: Trainer, module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Go on with the average and the weights of the last step; before, there may have been no average."""
        self._average = {key: value.clone() for key, value in checkpoint["state_dict"].items()}
        if TRAINED in checkpoint:
            module.load_state_dict(checkpoint[TRAINED])

    def state_dict(self) -> dict[str, int]:
        """How many steps were averaged."""
        return {"steps": self._steps}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """As before the interruption."""
        self._steps = int(state_dict["steps"])

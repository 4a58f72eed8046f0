"""What the three networks share while they are trained: finite losses, figures, pictures, compiling."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence

import torch
from pytorch_lightning import LightningModule
from pytorch_lightning.loggers import TensorBoardLogger
from torch import Tensor, nn

from rpl_data.types import DataError

RANDOM_FRAMES, UNSEEN_SCENES = "val", "val_scenes"
"""What a network is validated on; begins the names of the figures: val_pck, val_scenes_pck."""


class NetworkModule(LightningModule, ABC):
    """A network in training.

    Attributes:
        validated_on: what each validation loader holds, `RANDOM_FRAMES` or `UNSEEN_SCENES`.
        unreadable: how often images could not be read, by message.
    """

    def __init__(self) -> None:
        super().__init__()
        self.validated_on: tuple[str, ...] = (RANDOM_FRAMES,)
        self.unreadable: Counter[str] = Counter()

    @abstractmethod
    def compiled_part(self) -> nn.Module:
        """What torch.compile compiles: what takes the time and sees images of few sizes."""

    def stop_if_not_finite(
        self, losses: Mapping[str, Tensor], batch_number: int, image_ids: Sequence[int]
    ) -> None:
        """Stop a training whose loss is not a finite number.

        Args:
            losses: the parts of the loss, by name.
            batch_number: number of the batch in the epoch, from 0.
            image_ids: the images of the batch, by their ids in the COCO file.

        Raises:
            DataError: a loss is not finite.
        """
        bad = [f"{name} is {loss.item()}" for name, loss in losses.items() if not torch.isfinite(loss)]
        if bad:
            raise DataError(
                f"epoch {self.current_epoch + 1}, batch {batch_number + 1}, images "
                f"{', '.join(map(str, image_ids))} (ids of the COCO file): {', '.join(bad)}; look at the "
                "labels of these images, or lower --learning.rate and go on with --resume true"
            )

    def log_validated(self, name: str, value: Tensor | float, *, loader: int, batch_size: int) -> None:
        """Log a figure of a validation batch, under the name of what the batch is from."""
        full = f"{self.validated_on[loader]}_{name}"
        self.log(full, value, batch_size=batch_size, add_dataloader_idx=False)

    def wants_picture(self, batch_number: int) -> bool:
        """Whether a picture of this validation batch would be kept: the first one's is, by TensorBoard."""
        return batch_number == 0 and self.trainer.is_global_zero and bool(self._boards())

    def show(self, picture: Tensor, *, loader: int) -> None:
        """Log a picture (3 x height x width, uint8) to TensorBoard."""
        for board in self._boards():
            board.experiment.add_image(self.validated_on[loader], picture, self.current_epoch + 1)

    def _boards(self) -> list[TensorBoardLogger]:
        return [logger for logger in self.trainer.loggers if isinstance(logger, TensorBoardLogger)]

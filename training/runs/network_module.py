"""What the three networks have in common while they are trained: validated figures, pictures, compiling."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter

from pytorch_lightning import LightningModule
from pytorch_lightning.loggers import TensorBoardLogger
from torch import Tensor, nn

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

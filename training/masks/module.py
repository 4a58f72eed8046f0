"""Mask R-CNN as a Lightning module: the paper's stages, losses, validation, checkpoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from rpl_data.torch.instances import InstanceTarget

from ..runs.network_module import NetworkModule
from ..runs.options import Learning, MaskNetwork
from ..runs.schedule import optimizer_of
from ..runs.together import nothing_read
from .mask_rcnn import build_model, train_body
from .pictures import tinted
from .results import MASK_THRESHOLD
from .settings import SCORE_THRESHOLD
from .weights import description

Collated = tuple[list[Tensor], list[InstanceTarget], Sequence[str]]
"""What `collate_readable_lists` makes of a batch: images, targets, messages about unreadable images."""


class MaskTraining(NetworkModule):
    """A Mask R-CNN in training. First its heads alone are trained, then all of it.

    Attributes:
        model: torchvision's network.
        network: the options it was built with.
        names: of the labels; `names[0]` is the background.
    """

    def __init__(
        self, names: Sequence[str], network: MaskNetwork, learning: Learning, *, head_epochs: int
    ) -> None:
        """A network with random weights.

        Args:
            names: of the labels, the background first.
            network: its norm must be decided (`with_norm`).
            learning: how it is trained.
            head_epochs: how many epochs, from the first one, the ResNet is frozen.
        """
        super().__init__()
        self.names, self.network, self._learning = tuple(names), network, learning
        self._head_epochs = head_epochs
        self.model = build_model(network, len(names) - 1)
        if learning.channels_last:
            self.model = self.model.to(memory_format=torch.channels_last)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """The optimizer that the options name; `Steps` sets its rate."""
        return optimizer_of(self, self._learning, fused=self.trainer.precision == "32-true")

    def on_train_batch_start(self, batch: Collated, batch_idx: int) -> None:
        """At the start of an epoch, freeze or free the ResNet."""
        if batch_idx == 0:
            train_body(self.model, self.current_epoch >= self._head_epochs)

    def training_step(self, collated: Collated, number: int) -> Tensor | None:
        """The sum of torchvision's five losses; None when no image of the batch could be read."""
        images, targets, messages = collated
        self.unreadable.update(messages)
        if not images:
            return nothing_read(self)
        losses: dict[str, Tensor] = self.model(images, targets)
        self.stop_if_not_finite(losses, number, [target["image_id"] for target in targets])
        total = torch.stack([*losses.values()]).sum()
        shown = {"train_loss": total, **{f"train_{name}": loss for name, loss in losses.items()}}
        self.log_dict(shown, on_step=False, on_epoch=True, batch_size=len(images))
        return total

    def validation_step(self, collated: Collated, number: int, dataloader_idx: int = 0) -> None:
        """Mean IoU over the images and the classes that each of them shows (the paper's figure)."""
        images, targets, messages = collated
        self.unreadable.update(messages)
        found = self.model(images) if images else []
        ious = [
            iou for output, target in zip(found, targets, strict=True) for iou in class_ious(output, target)
        ]
        if ious:
            self.log_validated("iou", sum(ious) / len(ious), loader=dataloader_idx, batch_size=len(ious))
        if images and self.wants_picture(number):
            sure = found[0]["scores"] >= SCORE_THRESHOLD
            masks, labels = found[0]["masks"][sure, 0] > MASK_THRESHOLD, found[0]["labels"][sure]
            self.show(tinted(images[0], masks, labels, len(self.names)), loader=dataloader_idx)

    def compiled_part(self) -> nn.Module:
        """ResNet and pyramid; the heads see another number of boxes every time."""
        part: nn.Module = self.model.backbone
        return part

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """All that building the network again needs."""
        checkpoint["masks"] = description(self.network, self.names)


def class_ious(output: dict[str, Tensor], target: InstanceTarget) -> list[float]:
    """For each class that an image shows, the IoU of all its predicted with all its true pixels.

    Predictions with a score below `SCORE_THRESHOLD` do not count, nor does what is found in crowds.
    """
    sure, real = output["scores"] >= SCORE_THRESHOLD, target["iscrowd"] == 0
    ious = []
    for label in torch.unique(target["labels"][real]):
        same = target["labels"] == label
        true, crowd = ((target["masks"][same & kind] > 0).any(dim=0) for kind in (real, ~real))
        found = (output["masks"][sure & (output["labels"] == label), 0] > MASK_THRESHOLD).any(dim=0)
        found &= true | ~crowd
        ious.append(float((true & found).sum() / (true | found).sum().clamp_min(1)))
    return ious

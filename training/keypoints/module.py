"""The keypoint network of one object as a Lightning module: losses, validation, checkpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from rpl_data.torch.decoding import Keypoints, in_image, locate, probabilities
from rpl_data.torch.heatmaps import positions_in_image
from rpl_data.torch.keypoints import KeypointSample
from rpl_data.types import DataError, KeypointModel

from ..runs.folder import load_module
from ..runs.network_module import NetworkModule
from ..runs.options import Learning, Network
from ..runs.schedule import optimizer_of
from ..runs.together import EMPTY_SIDE_PX, share_of_mean
from .hourglass import cross_entropy, mean_squares
from .networks import network_of
from .pictures import heatmap_picture

Collated = tuple[KeypointSample | None, Sequence[str]]
"""What `collate_readable` makes of a batch: samples, and messages about unreadable images."""

PCK_SHARE = 0.1
"""A keypoint counts as correct (PCK) within this share of the side of its square box."""


class KeypointTraining(NetworkModule):
    """A keypoint network with its object. Its checkpoint holds all that predicting poses needs.

    Attributes:
        model: the sparse model whose keypoints the heatmaps are.
        options: the options of the network.
    """

    def __init__(self, model: dict[str, Any], options: dict[str, Any], learning: dict[str, Any]) -> None:
        """Build a network with random weights.

        Args:
            model: name, keypoints and points_object (rows of metres, None where never clicked).
            options: fields of `Network`.
            learning: fields of `Learning`.
        """
        super().__init__()
        self.save_hyperparameters()
        self.model = _model_from(model)
        self.options, self._learning = Network(**options), Learning(**learning)
        self.network = network_of(len(self.model.keypoints), self.options)
        if self._learning.channels_last:
            self.network = self.network.to(memory_format=torch.channels_last)

    def forward(self, images: Tensor) -> Keypoints:
        """Find the keypoints of crops, in pixels of the heatmap."""
        return self.located(self.network(self._laid_out(images))[-1])

    def located(self, output: Tensor) -> Keypoints:
        """Decode the output of the last stack into keypoints, in pixels of the heatmap."""
        return locate(self._heatmaps(output), sigma_px=self.options.sigma_px)

    def _heatmaps(self, output: Tensor) -> Tensor:
        """The output of the last stack as heatmaps, 1 high where it is sure."""
        if self.options.loss == "entropy":
            return probabilities(output.float(), sigma_px=self.options.sigma_px)
        return output.float()

    def keypoints_in_image(self, images: Tensor, crop_from_image: Tensor) -> Keypoints:
        """Find the keypoints of crops, in pixels of the full images, float64."""
        return self._in_image(self(images), crop_from_image)

    def _in_image(self, found: Keypoints, crop_from_image: Tensor) -> Keypoints:
        """Keypoints in pixels of the full images instead of the heatmaps."""
        sizes = {"input_px": self.options.input_px, "heatmap_px": self.options.heatmap_px}
        return Keypoints(
            positions_in_image(found.positions, crop_from_image, **sizes),
            found.confidence,
            in_image(found.covariance, crop_from_image, **sizes),
        )

    def loss_of(self, outputs: list[Tensor], batch: KeypointSample) -> Tensor:
        """The loss, averaged over the stacks; every stack is supervised."""
        return self._loss(outputs, batch["heatmaps"], batch["weights"])

    def _loss(self, outputs: list[Tensor], heatmaps: Tensor, weights: Tensor) -> Tensor:
        one = cross_entropy if self.options.loss == "entropy" else mean_squares
        return torch.stack([one(output.float(), heatmaps, weights) for output in outputs]).mean()

    def _nothing(self) -> tuple[Tensor, Tensor, Tensor]:
        """Images, heatmaps and weights of no crop."""
        images = torch.zeros(0, 3, EMPTY_SIDE_PX, EMPTY_SIDE_PX, device=self.device)
        weights = torch.zeros(0, len(self.model.keypoints), device=self.device)
        side = EMPTY_SIDE_PX * self.options.heatmap_px // self.options.input_px
        return images, weights.new_zeros(*weights.shape, side, side), weights

    def training_step(self, collated: Collated, number: int) -> Tensor | None:
        """The loss; None when no image of the batch could be read."""
        batch = self._read(collated)
        if batch is None and self.trainer.world_size == 1:
            return None
        # Processes that train together take each step together, if need be with a batch of nothing.
        images, heatmaps, weights = self._nothing() if batch is None else _lesson(batch)
        outputs = self.network(self._laid_out(images))
        loss = self._loss(outputs, heatmaps, weights) * share_of_mean(weights.sum())
        if batch is not None:
            self.stop_if_not_finite({"the loss": loss}, number, _ids(batch))
        asked = len(images) + len(collated[1])  # every process counts alike, whatever it could read
        self.log("train_loss", loss, on_step=False, on_epoch=True, sync_dist=True, batch_size=asked)
        return loss

    def validation_step(self, collated: Collated, number: int, dataloader_idx: int = 0) -> None:
        """Log the share of correct keypoints (PCK), and their mean distance as a share of the box's side."""
        batch = self._read(collated)
        if batch is None:
            return
        output = self.network(self._laid_out(batch["image"]))
        size = len(batch["image"])
        self.log_validated("loss", self.loss_of(output, batch), loader=dataloader_idx, batch_size=size)
        found = self._in_image(self.located(output[-1]), batch["crop_from_image"])
        distances = distances_by_box(found.positions, batch)
        if count := distances.numel():  # the mean of none would be NaN, and that of the epoch with it
            right = (distances < PCK_SHARE).double().mean()
            self.log_validated("pck", right, loader=dataloader_idx, batch_size=count)
            off = distances.clamp_max(1).mean()
            self.log_validated("error", off, loader=dataloader_idx, batch_size=count)
        if self.wants_picture(number):
            heatmaps = self._heatmaps(output[-1])
            self.show(heatmap_picture(batch["image"], heatmaps), loader=dataloader_idx)

    def compiled_part(self) -> nn.Module:
        """The network; decoding is not worth it."""
        return self.network

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """The optimizer that the options name; `Steps` sets its rate."""
        return optimizer_of(self, self._learning, fused=self.trainer.precision == "32-true")

    def _read(self, collated: Collated) -> KeypointSample | None:
        """The samples that could be read; the others are counted by their messages."""
        batch, messages = collated
        self.unreadable.update(messages)
        return batch

    def _laid_out(self, images: Tensor) -> Tensor:
        if self._learning.channels_last:
            return images.contiguous(memory_format=torch.channels_last)
        return images


def _lesson(batch: KeypointSample) -> tuple[Tensor, Tensor, Tensor]:
    return batch["image"], batch["heatmaps"], batch["weights"]


def _ids(batch: KeypointSample) -> list[int]:
    """The images of a batch, whose ids were collated to a tensor."""
    ids: list[int] = torch.as_tensor(batch["image_id"]).tolist()
    return ids


def distances_by_box(positions_px: Tensor, batch: KeypointSample) -> Tensor:
    """Distances of the labelled keypoints inside their crops, as shares of the square box's side; 1-D."""
    off: Tensor = (positions_px - batch["keypoints_px"]).norm(dim=-1) / batch["square_box"][:, 2:]
    return off[batch["weights"] > 0]


def untrained(model: KeypointModel, options: Network, learning: Learning) -> KeypointTraining:
    """Build a new network for an object."""
    rows = [row.tolist() if np.isfinite(row).all() else None for row in model.points_object]
    plain = {"name": model.name, "keypoints": list(model.keypoints), "points_object": rows}
    return KeypointTraining(plain, asdict(options), asdict(learning))


def load_keypoints(checkpoint: Path) -> KeypointTraining:
    """Load the trained network of a checkpoint, ready to predict.

    Raises:
        DataError: the checkpoint is missing, or another program wrote it.
    """
    return load_module(KeypointTraining, checkpoint, "`rpl train keypoints`")


def check_same_object(trained: KeypointTraining, model: KeypointModel, *, source: str) -> None:
    """Refuse, with a DataError, a checkpoint whose keypoints are not those of the dataset."""
    if trained.model.name != model.name or trained.model.keypoints != model.keypoints:
        raise DataError(
            f"{source}: the checkpoint is of {trained.model.name} with {len(trained.model.keypoints)} "
            f"keypoints ({', '.join(trained.model.keypoints)}), the dataset of {model.name} with "
            f"{len(model.keypoints)} ({', '.join(model.keypoints)}); train again or choose another checkpoint"
        )


def _model_from(plain: dict[str, Any]) -> KeypointModel:
    rows = [[np.nan] * 3 if row is None else row for row in plain["points_object"]]
    points = np.array(rows, dtype=float).reshape(-1, 3)
    return KeypointModel(plain["name"], tuple(plain["keypoints"]), points)

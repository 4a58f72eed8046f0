"""The detector in front of the hourglass, as a Lightning module. The paper uses YOLO, we torchvision's."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torchvision.models.detection import fcos_resnet50_fpn, ssdlite320_mobilenet_v3_large
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.fcos import FCOS, FCOSHead
from torchvision.ops import box_iou
from torchvision.utils import draw_bounding_boxes

from rpl_data.torch.detection import DetectionTarget, shrunk, square_from_box
from rpl_data.torch.image_files import to_unit_range

from ..keypoints.hourglass import Hourglass, Residual
from ..runs.folder import load_module
from ..runs.network_module import NetworkModule
from ..runs.options import DetectorNetwork, Learning
from ..runs.schedule import optimizer_of
from ..runs.together import nothing_read
from ..runs.weights import Start

Collated = tuple[list[Tensor], list[DetectionTarget], Sequence[str]]
"""What `collate_readable_lists` makes of a batch: images, targets, messages about unreadable images."""


LIKELY = 0.3
"""Least score of the detections that pictures show."""


class HourglassBackbone(nn.Module):
    """A backbone with one feature map of stride 8, and an hourglass that gives it context."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.out_channels = features
        self.layers = nn.Sequential(
            nn.Conv2d(3, features // 2, 5, stride=2, padding=2),
            nn.BatchNorm2d(features // 2),
            nn.ReLU(inplace=True),
            nn.MaxPool2d(2),
            Residual(features // 2, features),
            nn.MaxPool2d(2),
            Residual(features, features),
            Hourglass(2, features),
        )

    def forward(self, images: Tensor) -> OrderedDict[str, Tensor]:
        """The feature map, under the name that torchvision looks for."""
        return OrderedDict(p3=self.layers(images))


def small_fcos(classes: int, options: DetectorNetwork) -> nn.Module:
    """FCOS (Tian, Shen, Chen and He, ICCV 2019) on one feature map; a few sizes need no pyramid."""
    backbone = HourglassBackbone(options.features)
    network: nn.Module = FCOS(
        backbone,
        num_classes=classes,
        anchor_generator=AnchorGenerator(sizes=((8,),), aspect_ratios=((1.0,),)),
        head=FCOSHead(backbone.out_channels, 1, classes, num_convs=1),
        score_thresh=0.05,
        **_size(options),
    )
    return network


def fcos(classes: int, options: DetectorNetwork) -> nn.Module:
    """Torchvision's FCOS. Its batch normalisation learns, since nothing is pretrained."""
    network: nn.Module = fcos_resnet50_fpn(
        weights=None,
        weights_backbone=None,
        num_classes=classes,
        norm_layer=nn.BatchNorm2d,
        trainable_backbone_layers=5,
        **_size(options),
    )
    return network


def ssdlite(classes: int, options: DetectorNetwork) -> nn.Module:
    """Torchvision's SSDLite, which resizes every image to 320 x 320 px."""
    network: nn.Module = ssdlite320_mobilenet_v3_large(
        weights=None, weights_backbone=None, num_classes=classes
    )
    return network


ARCHITECTURES: dict[str, Callable[[int, DetectorNetwork], nn.Module]] = {
    "small_fcos": small_fcos,
    "fcos": fcos,
    "ssdlite": ssdlite,
}


def _size(options: DetectorNetwork) -> dict[str, Any]:
    """The size of the network's images: 4:3 images keep theirs, others are made to fit into it."""
    return {"min_size": options.width_px * 3 // 4, "max_size": options.width_px}


class Detection(NamedTuple):
    """An object found in an image: the paper's square in pixels of the full image, and the score."""

    square_px: np.ndarray
    score: float


class DetectorTraining(NetworkModule):
    """One detector for all objects of a dataset.

    Attributes:
        names: of the labels; `names[0]` is the background.
        options: the options of the network.
    """

    def __init__(self, names: list[str], network: dict[str, Any], learning: dict[str, Any]) -> None:
        """Build a detector with random weights.

        Args:
            names: of the labels, the background first.
            network: fields of `DetectorNetwork`.
            learning: fields of `Learning`.
        """
        super().__init__()
        self.save_hyperparameters()
        self.names, self.options, self._learning = names, DetectorNetwork(**network), Learning(**learning)
        self.detector = ARCHITECTURES[self.options.architecture](len(names), self.options)
        if self._learning.channels_last:
            self.detector = self.detector.to(memory_format=torch.channels_last)

    def training_step(self, collated: Collated, number: int) -> Tensor | None:
        """The sum of torchvision's losses; None when no image of the batch could be read."""
        images, targets, messages = collated
        self.unreadable.update(messages)
        if not images:
            return nothing_read(self)
        losses: dict[str, Tensor] = self.detector(images, targets)
        loss = torch.stack(list(losses.values())).sum()
        self.stop_if_not_finite(losses, number, [target["image_id"] for target in targets])
        self.log("train_loss", loss, on_step=False, on_epoch=True, batch_size=len(images))
        return loss

    def validation_step(self, collated: Collated, number: int, dataloader_idx: int = 0) -> None:
        """Log the share of objects whose best detection overlaps them with an IoU of at least 0.5."""
        images, targets, messages = collated
        self.unreadable.update(messages)
        found = self.detector(images) if images else []
        hits = [hit for output, target in zip(found, targets, strict=True) for hit in _hits(output, target)]
        if hits:
            self.log_validated("found", sum(hits) / len(hits), loader=dataloader_idx, batch_size=len(hits))
        if images and self.wants_picture(number):
            self.show(_boxed(images[0], found[0], self.names), loader=dataloader_idx)

    def compiled_part(self) -> nn.Module:
        """What makes the feature maps; the rest sees another number of boxes every time."""
        return self.detector.get_submodule("backbone")

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """The optimizer that the options name; `Steps` sets its rate."""
        return optimizer_of(self, self._learning, fused=self.trainer.precision == "32-true")

    @torch.no_grad()
    def detect(self, image: np.ndarray) -> dict[str, Detection]:
        """Detect objects in an RGB image of any size; the best detection of each that is found, by name."""
        small = shrunk(image, self.options.width_px)
        output = self.detector([to_unit_range(small).to(self.device)])[0]
        zoom = image.shape[1] / self.options.width_px
        best: dict[str, Detection] = {}
        for box, label, score in zip(output["boxes"], output["labels"], output["scores"], strict=True):
            name = self.names[int(label)]
            if name not in best or float(score) > best[name].score:
                square = square_from_box(box.cpu().numpy().astype(float) * zoom)
                best[name] = Detection(square, float(score))
        return best


def start_of(training: DetectorTraining) -> Start:
    """What of the detector can be given weights: heads stay random where other objects were trained."""
    detector, name = training.detector, training.options.architecture
    if name == "fcos":
        return Start(detector, "resnet50", body="backbone.body.", prefix="detector.")
    return Start(detector, name, body="", must=("backbone.",), prefix="detector.")


def untrained_detector(names: list[str], network: DetectorNetwork, learning: Learning) -> DetectorTraining:
    """Build a new detector."""
    return DetectorTraining(names, asdict(network), asdict(learning))


def load_detector(checkpoint: Path) -> DetectorTraining:
    """Load the trained detector of a checkpoint, ready to detect.

    Raises:
        DataError: the checkpoint is missing, or another program wrote it.
    """
    return load_module(DetectorTraining, checkpoint, "`rpl train detector`")


def _boxed(image: Tensor, output: dict[str, Tensor], names: list[str]) -> Tensor:
    """The image with the boxes of the likely detections, for TensorBoard; uint8."""
    likely = output["scores"] >= LIKELY
    words = [names[int(label)] for label in output["labels"][likely]]
    picture = (255 * image.detach().float().cpu().clamp(0, 1)).round().to(torch.uint8)
    if not words:  # of which torchvision warns
        return picture
    drawn: Tensor = draw_bounding_boxes(picture, output["boxes"][likely].cpu(), words)
    return drawn


def _hits(output: dict[str, Tensor], target: DetectionTarget) -> list[bool]:
    """Whether the best detection of an object's label overlaps it with an IoU of at least 0.5, per object."""
    hits = []
    for box, label in zip(target["boxes"], target["labels"], strict=True):
        mine = output["boxes"][output["labels"] == label]  # best score first
        hits.append(len(mine) > 0 and float(box_iou(mine[:1], box[None])[0, 0]) >= 0.5)
    return hits

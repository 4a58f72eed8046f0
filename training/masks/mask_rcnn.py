"""Mask R-CNN (He et al., ICCV 2017) with a ResNet and a feature pyramid, made of torchvision's parts.

Built here instead of by torchvision's own constructors because those know one width only, and because their
frozen batch norm without trained weights starts with losses in the thousands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from torch import Tensor, nn
from torch.nn.functional import interpolate
from torchvision.models import resnet
from torchvision.models.detection import MaskRCNN
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.backbone_utils import BackboneWithFPN, LastLevelMaxPool
from torchvision.models.detection.faster_rcnn import FastRCNNPredictor, TwoMLPHead
from torchvision.models.detection.mask_rcnn import MaskRCNNHeads, MaskRCNNPredictor
from torchvision.models.detection.rpn import RPNHead
from torchvision.models.detection.transform import GeneralizedRCNNTransform
from torchvision.ops import FrozenBatchNorm2d, MultiScaleRoIAlign

from rpl_data.types import DataError

MEAN, STD = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
"""Of ImageNet's colours: what trained ResNets expect."""


@dataclass(frozen=True)
class ModelConfig:
    """What is needed to build the network again; the defaults are the paper's.

    Attributes:
        size_px: shorter side of the image as the network sees it; anchors are 1/16 to 1 of it.
        stages: of the ResNet's four that are used; the last one's grid is too coarse for small images.
        channels: of the feature pyramid and of the mask head.
        hidden: width of the box head's two layers.
        proposals: boxes of the first stage that the second may look at, an image.
        rois: of these, how many the second stage trains on.
        detections: most objects found in an image.
        norm: of the ResNet; `auto` is frozen with trained weights and batch norm from scratch.
    """

    backbone: Literal["resnet18", "resnet34", "resnet50", "resnet101"] = "resnet101"
    size_px: int = 512
    stages: int = 4
    channels: int = 256
    hidden: int = 1024
    proposals: int = 2000
    rois: int = 512
    detections: int = 100
    norm: Literal["auto", "batch", "group", "frozen"] = "auto"

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        if self.size_px < 64 or self.size_px % 16:
            raise DataError(f"model.size_px must be a multiple of 16 from 64 on, got {self.size_px}")
        if not 2 <= self.stages <= 4:
            raise DataError(f"model.stages must be 2, 3 or 4, got {self.stages}")
        if min(self.channels, self.hidden, self.proposals, self.rois, self.detections) < 1:
            raise DataError("model: channels, hidden, proposals, rois and detections must be at least 1")


def with_norm(config: ModelConfig, weights: str) -> ModelConfig:
    """The config with `auto` decided: frozen statistics make sense only when there are some."""
    if config.norm != "auto":
        return config
    return replace(config, norm="batch" if weights == "scratch" else "frozen")


def build_model(config: ModelConfig, classes: int) -> MaskRCNN:
    """The network with random weights; `classes` is without the background."""
    size, channels = config.size_px, config.channels
    levels = [str(level) for level in range(config.stages)]
    model = MaskRCNN(
        _backbone(config),
        min_size=size,
        max_size=size * 4,
        image_mean=MEAN,
        image_std=STD,
        rpn_anchor_generator=AnchorGenerator(
            tuple((size * 2**level // 16,) for level in range(config.stages + 1)),
            ((0.5, 1.0, 2.0),) * (config.stages + 1),  # pooling adds a level to the pyramid
        ),
        rpn_head=RPNHead(channels, 3),
        rpn_pre_nms_top_n_train=config.proposals,
        rpn_post_nms_top_n_train=config.proposals,
        rpn_pre_nms_top_n_test=config.proposals // 2,
        rpn_post_nms_top_n_test=config.proposals // 2,
        box_roi_pool=MultiScaleRoIAlign(levels, output_size=7, sampling_ratio=2),
        box_head=TwoMLPHead(channels * 7**2, config.hidden),
        box_predictor=FastRCNNPredictor(config.hidden, classes + 1),
        box_batch_size_per_image=config.rois,
        box_detections_per_img=config.detections,
        mask_roi_pool=MultiScaleRoIAlign(levels, output_size=14, sampling_ratio=2),
        mask_head=MaskRCNNHeads(channels, (channels,) * 4, dilation=1),
        mask_predictor=MaskRCNNPredictor(channels, channels, classes + 1),
    )
    model.transform = SmoothResize(size, size * 4, MEAN, STD)
    return model


def _backbone(config: ModelConfig) -> BackboneWithFPN:
    norms: dict[str, Callable[[int], nn.Module]] = {
        "batch": nn.BatchNorm2d,
        "group": lambda channels: nn.GroupNorm(32, channels),
        "frozen": FrozenBatchNorm2d,
    }
    if config.norm not in norms:
        raise ValueError("decide the norm with `with_norm` first")
    body = getattr(resnet, config.backbone)(weights=None, norm_layer=norms[config.norm])
    widths = [body.inplanes // 8 * 2**level for level in range(config.stages)]
    layers = {f"layer{level + 1}": str(level) for level in range(config.stages)}
    return BackboneWithFPN(body, layers, widths, config.channels, extra_blocks=LastLevelMaxPool())


class SmoothResize(GeneralizedRCNNTransform):
    """torchvision's resizing of whole images, without its aliasing: 640 px become 256 in the `cpu` preset."""

    def resize(
        self, image: Tensor, target: dict[str, Tensor] | None = None
    ) -> tuple[Tensor, dict[str, Tensor] | None]:
        """An image alone is smoothed as it shrinks; training crops come in the right size."""
        height, width = image.shape[-2:]
        zoom = min(self.min_size[-1] / min(height, width), self.max_size / max(height, width))
        if target is not None or zoom >= 1:
            resized: tuple[Tensor, dict[str, Tensor] | None] = super().resize(image, target)
            return resized
        size = max(1, round(height * zoom)), max(1, round(width * zoom))
        small = interpolate(image[None], size=size, mode="bilinear", align_corners=False, antialias=True)
        return small[0], None


def train_body(model: MaskRCNN, trained: bool) -> None:
    """Freeze or free the ResNet alone: the pyramid, part of `backbone` too, is one of the paper's heads."""
    model.backbone.body.requires_grad_(trained)

"""Mask R-CNN (He et al., ICCV 2017) with a ResNet and a feature pyramid, made of torchvision's parts.

Torchvision's own constructors are not used: they know one width only, and their frozen batch norm without
trained weights starts with losses in the thousands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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

from ..runs.options import MaskNetwork

MEAN, STD = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
"""Mean and standard deviation of ImageNet's colours, which trained ResNets expect."""


def with_norm(config: MaskNetwork, weights: str) -> MaskNetwork:
    """Decide an `auto` norm: frozen statistics make sense only with trained weights."""
    if config.norm != "auto":
        return config
    return replace(config, norm="batch" if weights == "scratch" else "frozen")


def build_model(config: MaskNetwork, classes: int) -> MaskRCNN:
    """Build the network with random weights; `classes` does not count the background."""
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


def _backbone(config: MaskNetwork) -> BackboneWithFPN:
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


class SmoothResize(GeneralizedRCNNTransform):  # type: ignore[misc]  # torchvision has no types
    """torchvision's resizing of whole images, without its aliasing."""

    def resize(
        self, image: Tensor, target: dict[str, Tensor] | None = None
    ) -> tuple[Tensor, dict[str, Tensor] | None]:
        """Resize an image; training crops, which have a target, have the right size already."""
        height, width = image.shape[-2:]
        zoom = min(self.min_size[-1] / min(height, width), self.max_size / max(height, width))
        if target is not None or zoom >= 1:
            resized: tuple[Tensor, dict[str, Tensor] | None] = super().resize(image, target)
            return resized
        size = max(1, round(height * zoom)), max(1, round(width * zoom))
        small = interpolate(image[None], size=size, mode="bilinear", align_corners=False, antialias=True)
        return small[0], None


def train_body(model: MaskRCNN, trained: bool) -> None:
    """Freeze or free the ResNet alone. The pyramid, also part of `backbone`, is one of the paper's heads."""
    model.backbone.body.requires_grad_(trained)

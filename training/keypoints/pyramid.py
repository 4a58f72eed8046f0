"""A heatmap head on torchvision's ResNets and ConvNeXt, for trainings that start from trained weights.

The body's four feature maps (strides 4 to 32) are brought to one width, and from the coarsest on each is
enlarged and added to the next finer one, as in a feature pyramid (Lin et al., CVPR 2017). So the heatmaps
have the body's context, and places as fine as its first stage knows them. Shapes are (batch, channels, rows,
columns).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torchvision import models

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet's colours, which trained bodies expect."""

COARSEST = 32
"""Input pixels per pixel of the body's last feature map, on each axis."""


class HeatmapPyramid(nn.Module):
    """Turns images into one set of heatmaps, in a list as the hourglass gives its own.

    Attributes:
        shrink: input pixels per heatmap pixel, on each axis.
        body: torchvision's network, without what comes after its last feature map.
    """

    shrink = 4

    def __init__(self, keypoints: int, body: str, *, features: int = 256) -> None:
        """Build the network with random weights.

        Args:
            keypoints: how many heatmaps.
            body: resnet18, resnet34, resnet50 or convnext_tiny.
            features: channels of the pyramid.
        """
        super().__init__()
        self.mean: Tensor
        self.std: Tensor
        self.register_buffer("mean", torch.tensor(MEAN).reshape(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).reshape(1, 3, 1, 1), persistent=False)
        self.body, widths = _body(body)
        self._stages = _stages_of(body)
        self.beside = nn.ModuleList(nn.Conv2d(width, features, 1) for width in widths)
        self.smooth = nn.ModuleList(_block(features) for _ in widths)
        self.head = nn.Conv2d(features, keypoints, 1)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Compute the heatmaps: batch x keypoints x rows / 4 x columns / 4.

        Args:
            images: batch x 3 x rows x columns, 0 to 1; both sides multiples of 32.
        """
        maps = self._maps((images - self.mean) / self.std)
        x: Tensor = self.smooth[-1](self.beside[-1](maps[-1]))
        for level in range(len(maps) - 2, -1, -1):
            larger = nn.functional.interpolate(x, scale_factor=2, mode="nearest")
            x = self.smooth[level](self.beside[level](maps[level]) + larger)
        return [self.head(x)]

    def _maps(self, x: Tensor) -> list[Tensor]:
        """The feature maps at the ends of the body's stages, finest first."""
        found = []
        for stage in self._stages:
            for name in stage:
                x = self.body.get_submodule(name)(x)
            found.append(x)
        return found


def _body(name: str) -> tuple[nn.Module, list[int]]:
    """A body with random weights, and the channels of its four feature maps."""
    body: nn.Module = models.get_model(name, weights=None)
    if name == "convnext_tiny":
        del body.avgpool, body.classifier
        return body, [96, 192, 384, 768]
    del body.avgpool, body.fc
    last = 2048 if name == "resnet50" else 512
    return body, [last // 8, last // 4, last // 2, last]


def _stages_of(name: str) -> list[list[str]]:
    """The submodules that lead to each feature map, in their order."""
    if name == "convnext_tiny":  # each stage begins with what halves the map
        return [[f"features.{2 * level}", f"features.{2 * level + 1}"] for level in range(4)]
    return [["conv1", "bn1", "relu", "maxpool", "layer1"], ["layer2"], ["layer3"], ["layer4"]]


def _block(features: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(features, features, 3, padding=1, bias=False),
        nn.BatchNorm2d(features),
        nn.ReLU(inplace=True),
    )

"""The stacked hourglass of Newell, Yang and Deng (ECCV 2016), the paper's keypoint network.

Layer for layer the authors' own network (pre-activation bottlenecks, one residual block per level, batch
normalisation, nearest-neighbour upsampling), with options for its size: `StackedHourglass(keypoints=16)` is
the published one with two stacks. Shapes are (batch, channels, rows, columns).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


class StackedHourglass(nn.Module):
    """Turns images into one set of heatmaps per stack. All sets are trained, the last one is used.

    Attributes:
        shrink: input pixels per heatmap pixel, on each axis.
    """

    shrink = 4

    def __init__(self, keypoints: int, *, stacks: int = 2, features: int = 256, levels: int = 4) -> None:
        """Build the network with random weights.

        Args:
            keypoints: heatmaps per stack.
            stacks: hourglasses one behind the other; the paper has 2.
            features: channels of the hourglasses; the paper has 256.
            levels: how often an hourglass halves its feature map; heatmaps must be 2^levels pixels or wider.
        """
        super().__init__()
        half, quarter = max(features // 2, 16), max(features // 4, 16)
        self.stem = nn.Sequential(
            nn.Conv2d(3, quarter, 7, stride=2, padding=3),
            nn.BatchNorm2d(quarter),
            nn.ReLU(inplace=True),
            Residual(quarter, half),
            nn.MaxPool2d(2),
            Residual(half, half),
            Residual(half, features),
        )
        self.hourglasses = nn.ModuleList(Hourglass(levels, features) for _ in range(stacks))
        self.necks = nn.ModuleList(_neck(features) for _ in range(stacks))
        self.heads = nn.ModuleList(nn.Conv2d(features, keypoints, 1) for _ in range(stacks))
        self.features_back = nn.ModuleList(nn.Conv2d(features, features, 1) for _ in range(stacks - 1))
        self.heatmaps_back = nn.ModuleList(nn.Conv2d(keypoints, features, 1) for _ in range(stacks - 1))

    def forward(self, images: Tensor) -> list[Tensor]:
        """Compute the heatmaps of every stack, each batch x keypoints x rows / 4 x columns / 4.

        Args:
            images: batch x 3 x rows x columns, 0 to 1; both sides multiples of 4 * 2^levels.
        """
        x = self.stem(images)
        found: list[Tensor] = []
        for number, (hourglass, neck, head) in enumerate(
            zip(self.hourglasses, self.necks, self.heads, strict=True)
        ):
            neck_features = neck(hourglass(x))
            found.append(head(neck_features))
            if number < len(self.features_back):
                x = x + self.features_back[number](neck_features) + self.heatmaps_back[number](found[-1])
        return found


class Hourglass(nn.Module):
    """Halves a feature map `levels` times and enlarges it again, with a residual block beside every level."""

    def __init__(self, levels: int, features: int) -> None:
        super().__init__()
        self.beside = Residual(features, features)
        self.down = nn.Sequential(nn.MaxPool2d(2), Residual(features, features))
        self.inner = Hourglass(levels - 1, features) if levels > 1 else Residual(features, features)
        self.up = Residual(features, features)

    def forward(self, x: Tensor) -> Tensor:
        """The shape stays the same."""
        below = self.up(self.inner(self.down(x)))
        raised: Tensor = self.beside(x) + nn.functional.interpolate(below, scale_factor=2, mode="nearest")
        return raised


class Residual(nn.Module):
    """Pre-activation bottleneck (He et al. 2016): 1x1, 3x3 and 1x1 convolutions, half as wide in between."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        middle = after // 2
        self.body = nn.Sequential(
            *_activated(before, middle, 1),
            *_activated(middle, middle, 3),
            *_activated(middle, after, 1),
        )
        self.skip = nn.Identity() if before == after else nn.Conv2d(before, after, 1)

    def forward(self, x: Tensor) -> Tensor:
        """`after` channels, the same size."""
        result: Tensor = self.body(x) + self.skip(x)
        return result


def _activated(before: int, after: int, size: int) -> list[nn.Module]:
    convolution = nn.Conv2d(before, after, size, padding=size // 2)
    return [nn.BatchNorm2d(before), nn.ReLU(inplace=True), convolution]


def _neck(features: int) -> nn.Sequential:
    return nn.Sequential(
        Residual(features, features),
        nn.Conv2d(features, features, 1),
        nn.BatchNorm2d(features),
        nn.ReLU(inplace=True),
    )


def mean_squares(heatmaps: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
    """Mean squared difference over the pixels of the keypoints with a weight.

    Args:
        heatmaps, targets: batch x k x rows x columns.
        weights: batch x k; 0 where a keypoint is not labelled or outside the crop.
    """
    pixels = heatmaps.shape[-1] * heatmaps.shape[-2]
    squares = (heatmaps - targets).square().sum(dim=(-1, -2)) / pixels
    return (squares * weights).sum() / weights.sum().clamp_min(1)


def cross_entropy(logits: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
    """Cross entropy between the predicted and the target distribution of each keypoint over the pixels.

    It teaches the position alone, not the height of the peak, so the first epochs are not spent on learning
    that most pixels are empty. Arguments as of `mean_squares`.
    """
    wanted = targets.flatten(-2)
    wanted = wanted / wanted.sum(dim=-1, keepdim=True).clamp_min(1e-6)
    entropies = -(wanted * torch.log_softmax(logits.flatten(-2), dim=-1)).sum(dim=-1)
    return (entropies * weights).sum() / weights.sum().clamp_min(1)

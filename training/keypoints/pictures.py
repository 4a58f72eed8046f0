"""Pictures of heatmaps, for TensorBoard: what the network sees and where it looks."""

from __future__ import annotations

import torch
from torch import Tensor
from torchvision.utils import make_grid

MOST_CROPS = 8


def heatmap_picture(images: Tensor, heatmaps: Tensor) -> Tensor:
    """The first crops of a batch, reddened where a heatmap is high; 3 x height x width, uint8.

    Args:
        images: batch x 3 x rows x columns, 0 to 1.
        heatmaps: batch x keypoints x rows / 4 x columns / 4, near 1 where a keypoint is.
    """
    shown = images[:MOST_CROPS].detach().float().cpu()
    highest = heatmaps[:MOST_CROPS].detach().float().cpu().amax(dim=1, keepdim=True).clamp(0, 1)
    glow = torch.nn.functional.interpolate(highest, size=shown.shape[-2:], mode="bilinear")
    red = torch.tensor([1.0, 0.1, 0.1]).reshape(1, 3, 1, 1)
    tinted = shown * (1 - glow) + red * glow
    picture: Tensor = make_grid(tinted, nrow=4)
    return (255 * picture.clamp(0, 1)).round().to(torch.uint8)

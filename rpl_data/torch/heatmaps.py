"""Draw keypoints as heatmaps (a Gaussian at the sub-pixel position); take positions back to the image.

Positions are (u, v) = (column, row) in pixels of the heatmap; pixel centres are whole numbers.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rpl_data.torch.device import widest_float

SMALLEST_EXPONENT = -20.0
"""Exponent below which the Gaussian is 0: products of two tails would be denormal, which CPUs are slow at."""


def draw_heatmaps(
    positions_px: Float[Tensor, "*batch k 2"], *, size_px: int, sigma_px: float = 1.0
) -> Float[Tensor, "*batch k size size"]:
    """Draw one map per keypoint: a Gaussian of height 1 at its position, zeros when the position is NaN.

    The Gaussian is separable, so each map is the product of one row and one column.
    """
    grid = torch.arange(size_px, dtype=torch.float32, device=positions_px.device)
    # NaN becomes a position far outside the map, so that all of its Gaussian is cut off.
    positions = positions_px.to(torch.float32).nan_to_num(nan=-1e6).unsqueeze(-1)
    exponent = (grid - positions).square_().mul_(-0.5 / sigma_px**2)
    profile = torch.threshold_(exponent, SMALLEST_EXPONENT, -torch.inf).exp_()
    columns, rows = profile.unbind(-2)  # (*batch, k, size) each
    maps: Tensor = rows.unsqueeze(-1) * columns.unsqueeze(-2)
    return maps


def positions_in_image(
    positions_px: Float[Tensor, "*batch k 2"],
    crop_from_image: Float[Tensor, "*batch 2 3"],
    *,
    input_px: int,
    heatmap_px: int,
) -> Float[Tensor, "*batch k 2"]:
    """Convert heatmap positions to pixels of the full image, float64 (float32 on MPS)."""
    zoom, wide = input_px / heatmap_px, widest_float(positions_px.device)
    crop = (positions_px.to(wide) + 0.5) * zoom - 0.5  # edges coincide, centres do not
    affine = crop_from_image.to(wide)
    offset = (crop - affine[..., None, :, 2]).transpose(-1, -2)
    image: Tensor = torch.linalg.solve(affine[..., :2], offset).transpose(-1, -2)
    return image

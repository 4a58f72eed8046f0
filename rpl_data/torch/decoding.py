"""Decode a network's heatmaps: position, confidence and covariance of each keypoint."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from rpl_data.torch.device import widest_float

SMALLEST_VARIANCE_PX2 = 0.3**2
"""Smallest variance of a position per axis, in heatmap pixels squared: no network is surer than that."""

LOWEST_SHARE = 0.05
"""Share of the peak's height below which a pixel is noise, not another possible position."""

CUT_VARIANCE = 1 + LOWEST_SHARE * math.log(LOWEST_SHARE) / (1 - LOWEST_SHARE)
"""Share of a Gaussian's second moments left after that cut: 1 - share L / (1 - share), L = -ln(share)."""


class Keypoints(NamedTuple):
    """Keypoints as heatmaps show them, in pixels of the heatmap.

    Attributes:
        positions: (u, v).
        confidence: height of each peak, 0 to 1.
        covariance: covariance of each position.
    """

    positions: Float[Tensor, "*batch k 2"]
    confidence: Float[Tensor, "*batch k"]
    covariance: Float[Tensor, "*batch k 2 2"]


def locate(heatmaps: Float[Tensor, "*batch k height width"], *, sigma_px: float) -> Keypoints:
    """Locate each keypoint to a fraction of a pixel, with its confidence and covariance.

    The position is DARK's (Zhang, Zhu, Dai, Ye and Zhu, "Distribution-aware coordinate representation for
    human pose estimation", CVPR 2020): smooth the map with the Gaussian it was trained on, and take the
    vertex of the quadratic fitted to its logarithm at the peak. Exact for a Gaussian of any covariance;
    within one sigma of the map's edge the position is drawn inwards by up to 0.6 px.

    A network that minimises squared error or cross entropy predicts the mean of the target maps it holds
    possible: the distribution of the position, blurred by the target's Gaussian. So its second moments minus
    `sigma_px` squared are the covariance of the position.

    Args:
        heatmaps: values near 1 where a keypoint is.
        sigma_px: sigma of the Gaussians in the training targets, heatmap pixels.
    """
    maps = heatmaps.clamp_min(0)
    height, width = maps.shape[-2:]
    smooth = _smoothed(maps, sigma_px).flatten(-2)
    flat = smooth.argmax(dim=-1)
    column, row = flat % width, flat // width
    offset = _vertex(smooth, column, row, width=width, height=height)
    positions = torch.stack([column, row], dim=-1) + offset
    confidence = maps.flatten(-2).amax(dim=-1).clamp_max(1)
    return Keypoints(positions, confidence, _covariance(maps, positions, sigma_px))


def probabilities(
    logits: Float[Tensor, "*batch k height width"], *, sigma_px: float
) -> Float[Tensor, "*batch k height width"]:
    """Turn the logits of a network trained with `cross_entropy` into heatmaps; a sure peak is 1 high."""
    share = torch.softmax(logits.flatten(-2), dim=-1) * (2 * math.pi * sigma_px**2)
    return share.reshape(logits.shape)


def in_image(
    covariance_px: Float[Tensor, "batch k 2 2"],
    crop_from_image: Float[Tensor, "batch 2 3"],
    *,
    input_px: int,
    heatmap_px: int,
) -> Float[Tensor, "batch k 2 2"]:
    """Convert covariances from heatmap pixels to pixels of the full image, float64 (float32 on MPS)."""
    wide = widest_float(covariance_px.device)
    image_from_heatmap = torch.linalg.inv(crop_from_image[:, None, :, :2].to(wide)) * (input_px / heatmap_px)
    turned: Tensor = image_from_heatmap @ covariance_px.to(wide) @ image_from_heatmap.transpose(-1, -2)
    return turned


def _smoothed(maps: Tensor, sigma_px: float) -> Tensor:
    """Convolve each map with a Gaussian of that width, cut off at three sigmas."""
    reach = max(1, math.ceil(3 * sigma_px))
    steps = torch.arange(-reach, reach + 1, dtype=maps.dtype, device=maps.device)
    profile = torch.exp(-0.5 * (steps / sigma_px) ** 2)
    profile = profile / profile.sum()
    one = maps.reshape(-1, 1, *maps.shape[-2:])
    one = torch.conv2d(one, profile.reshape(1, 1, -1, 1), padding=(reach, 0))
    one = torch.conv2d(one, profile.reshape(1, 1, 1, -1), padding=(0, reach))
    return one.reshape(maps.shape)


def _vertex(smooth: Tensor, column: Tensor, row: Tensor, *, width: int, height: int) -> Tensor:
    """Offset from the peak to the vertex of the quadratic through the logarithms of its neighbours.

    At the map's edge the neighbours of the nearest inner pixel are used; the vertex is not trusted
    farther than a pixel from the peak.
    """
    middle_u, middle_v = column.clamp(1, width - 2), row.clamp(1, height - 2)

    def at(du: int, dv: int) -> Tensor:
        index = (middle_v + dv) * width + middle_u + du
        return smooth.gather(-1, index.unsqueeze(-1)).squeeze(-1).clamp_min(1e-12).log()

    here, left, right, above, below = at(0, 0), at(-1, 0), at(1, 0), at(0, -1), at(0, 1)
    slope = torch.stack([right - left, below - above], dim=-1) / 2
    across = (at(1, 1) - at(-1, 1) - at(1, -1) + at(-1, -1)) / 4
    bend_u, bend_v = (right - 2 * here + left).clamp_max(-1e-6), (below - 2 * here + above).clamp_max(-1e-6)
    determinant = bend_u * bend_v - across**2
    across = torch.where(determinant > 1e-12, across, 0.0)  # not a peak: each axis on its own
    determinant = (bend_u * bend_v - across**2).unsqueeze(-1)
    along = torch.stack(
        [bend_v * slope[..., 0] - across * slope[..., 1], bend_u * slope[..., 1] - across * slope[..., 0]],
        dim=-1,
    )
    from_peak = torch.stack([middle_u - column, middle_v - row], dim=-1) - along / determinant
    return from_peak.clamp(-1, 1)


def _covariance(maps: Tensor, positions: Tensor, sigma_px: float) -> Tensor:
    """Second moments about the positions minus those of the target; at least SMALLEST_VARIANCE_PX2."""
    height, width = maps.shape[-2:]
    peak = maps.amax(dim=(-1, -2), keepdim=True).clamp_min(1e-12)
    mass = torch.where(maps >= LOWEST_SHARE * peak, maps, 0.0)
    mass = mass / mass.sum(dim=(-1, -2), keepdim=True).clamp_min(1e-12)
    u = torch.arange(width, device=maps.device) - positions[..., 0:1]
    v = torch.arange(height, device=maps.device) - positions[..., 1:2]
    uu = (mass.sum(dim=-2) * u**2).sum(dim=-1)
    vv = (mass.sum(dim=-1) * v**2).sum(dim=-1)
    uv = torch.einsum("...vu,...u,...v->...", mass, u, v)
    moments = torch.stack([torch.stack([uu, uv], dim=-1), torch.stack([uv, vv], dim=-1)], dim=-2)
    values, axes = torch.linalg.eigh(moments)
    values = (values / CUT_VARIANCE - sigma_px**2).clamp_min(SMALLEST_VARIANCE_PX2)
    covariance: Tensor = (axes * values.unsqueeze(-2)) @ axes.transpose(-1, -2)
    return covariance

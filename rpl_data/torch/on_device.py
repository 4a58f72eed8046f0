"""Take batches of keypoint samples to a device, and draw their heatmaps there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from rpl_data.torch.device import widest_float
from rpl_data.torch.heatmaps import draw_heatmaps


def batch_on_device(
    batch: Mapping[str, Any],
    device: str | torch.device,
    *,
    input_px: int,
    heatmap_px: int,
    sigma_px: float,
) -> dict[str, Any]:
    """Move a collated batch to a device, and draw its heatmaps there where it has none.

    float64 becomes float32 on a device that has no float64 (Apple's MPS).

    Args:
        batch: of `KeypointDataset`.
        device: "cuda", "mps", "cpu" or another of torch's.
        input_px, heatmap_px, sigma_px: of the dataset.
    """
    place = torch.device(device)
    moved = {key: _moved(value, place) for key, value in batch.items()}
    if "heatmaps" not in moved:
        on_crop = _positions_on_crop(moved["keypoints_px"], moved["crop_from_image"])
        zoom = heatmap_px / input_px
        on_heatmap = on_crop * zoom + (zoom - 1) / 2  # edges coincide, centres do not
        inside = (moved["weights"] > 0).unsqueeze(-1)
        positions = torch.where(inside, on_heatmap, torch.nan)
        moved["heatmaps"] = draw_heatmaps(positions, size_px=heatmap_px, sigma_px=sigma_px)
    return moved


def _moved(value: Any, device: torch.device) -> Any:
    if not isinstance(value, Tensor):
        return value
    kind = widest_float(device) if value.dtype == torch.float64 else value.dtype
    return value.to(device, kind, non_blocking=True)


def _positions_on_crop(keypoints_px: Tensor, crop_from_image: Tensor) -> Tensor:
    """Positions in the crop of positions in the image, batch x k x 2; NaN stays NaN."""
    turned: Tensor = keypoints_px @ crop_from_image[..., :2].transpose(-1, -2)
    return turned + crop_from_image[..., None, :, 2]

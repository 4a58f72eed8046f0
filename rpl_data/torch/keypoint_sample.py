"""One crop with its keypoints as tensors: what the Datasets of keypoints give."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NotRequired, TypedDict

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from rpl_data.torch.heatmaps import draw_heatmaps
from rpl_data.torch.image_files import to_unit_range
from rpl_data.torch.transforms import Affine, Image, heatmap_from_crop, moved


class KeypointSample(TypedDict):
    """One instance: `KeypointDataset` says what each key holds.

    A default-collated batch has the same keys with a leading batch axis.
    """

    image: Tensor
    heatmaps: NotRequired[Tensor]
    weights: Tensor
    keypoints_px: Tensor
    visibility: Tensor
    crop_from_image: Tensor
    camera_matrix: Tensor
    distortion: Tensor
    camera_from_object: Tensor
    points_object: Tensor
    square_box: Tensor
    image_id: int
    annotation_id: int


def keypoint_sample(
    crop: Image,
    crop_from_image: Affine,
    keypoints: Float64[np.ndarray, "k 3"],
    square_box: Float64[np.ndarray, "3"],
    *,
    camera: Sequence[np.ndarray],
    points_object: Tensor,
    ids: tuple[int, int],
    heatmaps: tuple[int, float] | None,
) -> KeypointSample:
    """Make the sample of a square crop.

    Args:
        keypoints: u, v in pixels of the image, and COCO's visibility.
        camera: camera matrix, distortion and `camera_from_object`.
        ids: of the image and of the annotation.
        heatmaps: their side and the sigma of their Gaussians, in heatmap pixels; None draws none.
    """
    input_px, visibility = len(crop), keypoints[:, 2]
    keypoints_px = np.where(visibility[:, None] > 0, keypoints[:, :2], np.nan)
    on_crop = moved(crop_from_image, keypoints_px)
    # Within the edges of the crop; False for NaN.
    inside = np.all((on_crop >= -0.5) & (on_crop < input_px - 0.5), axis=1)
    matrix, distortion, pose = (torch.from_numpy(values.copy()) for values in camera)
    sample: KeypointSample = {
        "image": to_unit_range(crop),
        "weights": torch.from_numpy(inside.astype(np.float32)),
        "keypoints_px": torch.from_numpy(keypoints_px),
        "visibility": torch.from_numpy(visibility.astype(np.int64)),
        "crop_from_image": torch.from_numpy(crop_from_image),
        "camera_matrix": matrix,
        "distortion": distortion,
        "camera_from_object": pose,
        "points_object": points_object,
        "square_box": torch.from_numpy(square_box.copy()),
        "image_id": ids[0],
        "annotation_id": ids[1],
    }
    if heatmaps is not None:
        heatmap_px, sigma_px = heatmaps
        to_heatmap = heatmap_from_crop(input_px=input_px, heatmap_px=heatmap_px)
        on_heatmap = np.where(inside[:, None], moved(to_heatmap, on_crop), np.nan)
        positions = torch.from_numpy(on_heatmap)
        sample["heatmaps"] = draw_heatmaps(positions, size_px=heatmap_px, sigma_px=sigma_px)
    return sample

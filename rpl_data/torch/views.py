"""The image that crops are cut from: as it was recorded, or after transforms of whole images.

The transforms take what `InstanceDataset` gives, an image and its target, here with the one instance; so one
transform serves both Datasets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, UInt8
from torch import Tensor
from torchvision import tv_tensors

from rpl_data.geometry import Pixels, square_box
from rpl_data.json_arrays import asdict_values
from rpl_data.torch.image_files import to_unit_range
from rpl_data.torch.keypoint_rows import KeypointRows
from rpl_data.torch.targets import (
    EDGE_FROM_CENTRE_PX,
    InstanceSample,
    InstanceTarget,
    pair_of,
    points_from_keypoints,
)
from rpl_data.torch.transforms import Affine, Image
from rpl_data.types import DataError

Transforms = Callable[[Tensor, InstanceTarget], InstanceSample]
"""Moves and colours a whole image and all that its target holds, as torchvision.transforms.v2 does."""

MOVED_PX = 0.01
"""Keypoints that go farther than this have been moved; float32 rounds to a hundredth of that."""


@dataclass(frozen=True)
class View:
    """An image with one labelled instance.

    Attributes:
        pixels: the image, or the part of it that the crops may need.
        image_from_pixels: map from that part to the whole image.
        keypoints: u, v (pixel centres are whole numbers) and visibility.
        square_box: centre and side, px.
        mask: returns the visible mask of the instance in the whole image.
        moved: whether the transforms moved the object, so that the camera is no longer known.
    """

    pixels: Image
    image_from_pixels: Affine
    keypoints: Float64[np.ndarray, "k 3"]
    square_box: Float64[np.ndarray, "3"]
    mask: Callable[[], UInt8[np.ndarray, "height width"]]
    moved: bool = False


STRAY = 0.5
"""How far noise and interpolation may take brightnesses beyond 0 and 1, where they are cut off."""

LEAST_SPREAD_PX = 1.0
"""Points that are nearer to a line do not say whether they were mirrored."""

WHOLE: Affine = np.array([[1.0, 0, 0], [0, 1, 0]])
"""Map between images of which one is all of the other."""


def transformed(pixels: Image, rows: KeypointRows, row: int, transforms: Transforms) -> View:
    """Run the transforms on the whole image of a row.

    Where they leave nothing of the instance, the image comes back as it was.

    Raises:
        DataError: they dropped the types by which torchvision tells points from other tensors, returned
            something else than an image and its target, or mirrored the object.
    """
    before = _target(rows, row)
    image, after = pair_of(transforms(tv_tensors.Image(to_unit_range(pixels)), before))
    _check_image(image)
    if not isinstance(after["points"], tv_tensors.KeyPoints):
        raise DataError(
            "the transforms returned a plain tensor for points; wrap them as they came: "
            "tv_tensors.wrap(moved, like=target['points'])"
        )
    unmoved = View(pixels, WHOLE, rows.keypoints[row], rows.square_boxes[row], lambda: rows.mask(row))
    if len(after["points"]) != 1 or not bool((after["visibility"] > 0).any()):
        return unmoved
    keypoints = _keypoints(after)
    known = keypoints[:, 2] > 0
    if not known.any():
        return unmoved
    if _mirrored(rows.keypoints[row][known, :2], keypoints[known, :2]):
        raise DataError("the transforms mirror: a mirrored object is another object; leave flips out")
    moved = np.abs(keypoints - rows.keypoints[row])[known].max() > MOVED_PX
    box = _square_box(keypoints[known, :2], after) if moved else rows.square_boxes[row]
    if not box[2] > 0:
        return unmoved
    levels = (image.as_subclass(Tensor).clamp(0, 1) * 255).round_().to(torch.uint8)
    mask = after["masks"][0].as_subclass(Tensor).numpy()
    pixels = np.ascontiguousarray(levels.permute(1, 2, 0).numpy())
    return View(pixels, WHOLE, keypoints, box, lambda: mask, moved=bool(moved))


def _check_image(image: Tensor) -> None:
    """DataError unless an image is as it was given to the transforms: float, three channels, 0 to 1."""
    if image.ndim != 3 or len(image) != 3 or not image.is_floating_point():
        raise DataError(
            f"the transforms returned an image of {image.dtype}, {' x '.join(map(str, image.shape))}; "
            "expected float, 3 x height x width"
        )
    low, high = float(image.min()), float(image.max())
    if not (low >= -STRAY and high <= 1 + STRAY):  # nor NaN
        raise DataError(
            f"the transforms returned brightnesses from {low:.3g} to {high:.3g}; expected 0 to 1: normalise "
            "the crops, after the dataset"
        )


def _mirrored(before_px: Pixels, after_px: Pixels) -> bool:
    """Whether points were mirrored, by the affine map that fits them best.

    Not where they are as near to a line as that map leaves them apart: then its sign is chance.
    """
    one, other = (points - points.mean(axis=0) for points in (before_px, after_px))
    if len(one) < 3:
        return False
    fitted = np.linalg.lstsq(one, other, rcond=None)[0]
    spread = min(np.linalg.svd(points, compute_uv=False)[-1] for points in (one, other))
    if spread < max(LEAST_SPREAD_PX, 2 * np.linalg.norm(one @ fitted - other)):
        return False
    return bool(np.linalg.det(fitted) < 0)


def _target(rows: KeypointRows, row: int) -> InstanceTarget:
    """The target of a row: its image with one instance."""
    width, height = rows.sizes[row].tolist()
    size = (height, width)
    keypoints = torch.from_numpy(rows.keypoints[row].astype(np.float32))[None]
    mask = rows.mask(row)
    columns, lines = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    edges = [columns[0], lines[0], columns[-1] + 1, lines[-1] + 1]
    boxes = torch.tensor([[float(edge) for edge in edges]])
    return {
        "boxes": tv_tensors.BoundingBoxes(boxes, format=tv_tensors.BoundingBoxFormat.XYXY, canvas_size=size),
        "labels": torch.ones(1, dtype=torch.int64),
        "masks": tv_tensors.Mask(torch.from_numpy(mask)[None]),
        "image_id": int(rows.image_ids[row]),
        "area": torch.tensor([float(mask.sum())]),
        "iscrowd": torch.zeros(1, dtype=torch.int64),
        "keypoints": keypoints,
        "points": points_from_keypoints(keypoints, size),
        "visibility": keypoints[..., 2].to(torch.int64),
    }


def _square_box(known_px: Pixels, target: InstanceTarget) -> Float64[np.ndarray, "3"]:
    """The square around the moved keypoints; around the moved mask where fewer than two are known."""
    if len(known_px) < 2:
        edges = target["boxes"].as_subclass(Tensor).numpy().astype(float)
        known_px = edges.reshape(2, 2) - EDGE_FROM_CENTRE_PX
    return np.array(asdict_values(square_box(known_px)))


def _keypoints(target: InstanceTarget) -> Float64[np.ndarray, "k 3"]:
    """The moved keypoints of the one instance, also those outside the image; 0, 0, 0 without a label."""
    xy = target["points"][0].as_subclass(Tensor).numpy().astype(float) - EDGE_FROM_CENTRE_PX
    seen = target["visibility"][0].numpy().astype(float)
    keypoints = np.column_stack([xy, seen])
    keypoints[(seen == 0) | ~np.isfinite(xy).all(axis=1)] = 0
    return keypoints

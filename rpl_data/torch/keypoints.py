"""Dataset of one object's crops with keypoint heatmaps, which the paper's hourglass is trained on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict

import cv2
import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor
from torch.utils.data import Dataset, get_worker_info

from rpl_data.formats.datasets.coco import CocoObject, objects_from_coco, read_coco
from rpl_data.torch.heatmaps import draw_heatmaps
from rpl_data.torch.image_files import read_image, to_unit_range
from rpl_data.torch.pixel_cache import PixelCache, Rectangle, rectangle_around
from rpl_data.torch.splits import split_file
from rpl_data.torch.symmetric import canonical_label
from rpl_data.torch.transforms import (
    Affine,
    Augmentation,
    Image,
    chained,
    crop_from_square,
    heatmap_from_crop,
    jittered,
    moved,
    random_crop_from_square,
    reach,
    warped,
)
from rpl_data.types import DataError, Intrinsics
from rpl_data.wording import counted

DISTORTION_LENGTH = 14
"""Length of OpenCV's longest list of distortion coefficients; shorter lists are padded with zeros."""


class KeypointSample(TypedDict):
    """One instance: `KeypointDataset` says what each key holds.

    A default-collated batch has the same keys with a leading batch axis.
    """

    image: Tensor
    heatmaps: Tensor
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


@dataclass(frozen=True)
class _Instances:
    """The annotations of one object as arrays, one row per instance.

    Arrays, not dictionaries: worker processes share their memory, while a list of dictionaries would be
    copied as soon as reference counts change.
    """

    files: np.ndarray
    image_ids: Int64[np.ndarray, " n"]
    annotation_ids: Int64[np.ndarray, " n"]
    sizes: Int64[np.ndarray, "n 2"]
    camera_matrices: Float64[np.ndarray, "n 3 3"]
    distortions: Float64[np.ndarray, "n c"]
    camera_from_object: Float64[np.ndarray, "n 4 4"]
    keypoints: Float64[np.ndarray, "n k 3"]
    square_boxes: Float64[np.ndarray, "n 3"]


class NoInstance(DataError):
    """A split has no instance of the object."""


class KeypointDataset(Dataset[KeypointSample]):
    """Square crops of one object of an exported dataset, one item per instance.

    ::

        dataset = KeypointDataset("my-workspace/export/coco", split="train", object="cube")
        sample = dataset[0]      # a dictionary, ready for torch's DataLoader

    Its keys are the following, for k keypoints; pixels count from the centre of the top-left pixel:

    ====================  =======  ======================  ==================================================
    key                   dtype    shape                   what it is
    ====================  =======  ======================  ==================================================
    image                 float32  3, input, input         crop, RGB, 0 to 1
    heatmaps              float32  k, heatmap, heatmap     Gaussian of height 1 at each keypoint
    weights               float32  k                       1 where labelled and inside the crop, else 0
    keypoints_px          float64  k, 2                    (u, v), px of the full image; NaN = not labelled
    visibility            int64    k                       0 never clicked, 1 hidden, 2 seen
    crop_from_image       float64  2, 3                    px of the full image -> px of the crop
    camera_matrix         float64  3, 3                    K of the full image, px
    distortion            float64  14                      OpenCV's lens coefficients
    camera_from_object    float64  4, 4                    pose, metres; camera: x right, y down, z forward
    points_object         float64  k, 3                    sparse model, metres; NaN = never clicked
    square_box            float64  3                       cx, cy, side, px of the full image
    image_id              int                              of the COCO file
    annotation_id         int                              of the COCO file
    ====================  =======  ======================  ==================================================

    Attributes:
        model: the keypoint model of the object.
        input_px, heatmap_px: side of the crops and of the heatmaps.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str | None = None,
        object: str | None = None,  # noqa: A002 (the recipe's and the CLI's word for it)
        input_px: int = 256,
        heatmap_px: int = 64,
        sigma_px: float = 1.0,
        augment: Augmentation | None = None,
        cache: bool | Path = False,
        canonical: bool = False,
    ) -> None:
        """Read the annotations; images stay on disk unless cached.

        Args:
            path: the folder of an export (my-workspace/export/coco), or one of its JSON files.
            split: train, val or test, when `path` is a folder.
            object: its name; may be left out when there is one object.
            input_px: side of the crop.
            heatmap_px: side of the heatmaps.
            sigma_px: sigma of the Gaussians, in heatmap pixels.
            augment: random shifts, scales, rotations and colours; None for evaluation. Draws from torch's
                random state, so `torch.manual_seed` and DataLoader workers behave as usual.
            cache: keep the decoded pixels around each box: True for memory; a folder shares them between
                processes and runs. Samples stay the same up to rounding to a grey level.
            canonical: of the poses that look the same, by the object's symmetries in the export, label every
                instance with the one whose axes are nearest to the camera's, and move keypoints and square
                box with it; without symmetries nothing changes.

        Raises:
            DataError: there is no such split (the message says why), the file is not an export of rpl-data,
                it has no such object or no instance of it, or a size is not above 0.
        """
        if min(input_px, heatmap_px) < 1 or sigma_px <= 0:
            raise DataError(
                f"input_px is {input_px}, heatmap_px {heatmap_px}, sigma_px {sigma_px}; all must be above 0"
            )
        coco_json = split_file(path, split)
        data = read_coco(coco_json)
        self._coco_json = coco_json
        chosen, category_id = _choose(data, object, coco_json)
        self.model = chosen.model
        self.input_px, self.heatmap_px = input_px, heatmap_px
        self._sigma_px, self._augment = sigma_px, augment
        self._heatmap_from_crop = heatmap_from_crop(input_px=input_px, heatmap_px=heatmap_px)
        self._rows = _instances(data, category_id, coco_json.parent)
        if len(self._rows.files) == 0:
            raise NoInstance(f"{coco_json} has no instance of {self.model.name}; train on another split")
        if canonical:
            self._rows = _canonical(self._rows, chosen)
        self._points_object = torch.from_numpy(self.model.points_object.copy())
        self._cache = PixelCache(self._rows.files.tolist(), self._rectangles(), cache) if cache else None

    def __repr__(self) -> str:
        return (
            f"KeypointDataset({str(self._coco_json)!r}): {counted(len(self), 'instance')} of "
            f"{self.model.name}, {counted(len(self.model.keypoints), 'keypoint')}, "
            f"crops of {self.input_px} px, heatmaps of {self.heatmap_px} px"
        )

    def __len__(self) -> int:
        """Number of instances."""
        return len(self._rows.files)

    def __getitem__(self, row: int) -> KeypointSample:
        """Return the sample of an instance; IndexError past the last."""
        if not -len(self) <= row < len(self):
            raise IndexError(f"instance {row} of {len(self)}")
        if get_worker_info() is not None:
            # OpenCV's threads do not survive the fork of a DataLoader worker, and each worker needs one core.
            cv2.setNumThreads(0)
        rng = None
        if self._augment is not None:
            rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
        crop_from_image = self._crop_from_image(row, rng)
        crop = self._crop(row, crop_from_image)
        if self._augment is not None and rng is not None:
            crop = jittered(crop, self._augment, rng)
        return self._sample(row, crop, crop_from_image)

    def _crop_from_image(self, row: int, rng: np.random.Generator | None) -> Affine:
        *centre, side = self._rows.square_boxes[row]
        if self._augment is None or rng is None:
            return crop_from_square(np.array(centre), side, input_px=self.input_px)
        return random_crop_from_square(np.array(centre), side, self._augment, rng, input_px=self.input_px)

    def _crop(self, row: int, crop_from_image: Affine) -> Image:
        if self._cache is None:
            return warped(
                read_image(self._rows.files[row]), crop_from_image, size=(self.input_px, self.input_px)
            )
        pixels, rectangle = self._cache[row]
        image_from_cached = np.array([[1.0, 0, rectangle.left], [0, 1, rectangle.top]])
        return warped(
            pixels, chained(crop_from_image, image_from_cached), size=(self.input_px, self.input_px)
        )

    def _sample(self, row: int, crop: Image, crop_from_image: Affine) -> KeypointSample:
        rows = self._rows
        visibility = rows.keypoints[row, :, 2]
        keypoints_px = np.where(visibility[:, None] > 0, rows.keypoints[row, :, :2], np.nan)
        on_crop = moved(crop_from_image, keypoints_px)
        # Within the edges of the crop; False for NaN.
        inside = np.all((on_crop >= -0.5) & (on_crop < self.input_px - 0.5), axis=1)
        on_heatmap = np.where(inside[:, None], moved(self._heatmap_from_crop, on_crop), np.nan)
        return {
            "image": to_unit_range(crop),
            "heatmaps": draw_heatmaps(
                torch.from_numpy(on_heatmap), size_px=self.heatmap_px, sigma_px=self._sigma_px
            ),
            "weights": torch.from_numpy(inside.astype(np.float32)),
            "keypoints_px": torch.from_numpy(keypoints_px),
            "visibility": torch.from_numpy(visibility.astype(np.int64)),
            "crop_from_image": torch.from_numpy(crop_from_image),
            "camera_matrix": torch.from_numpy(rows.camera_matrices[row].copy()),
            "distortion": torch.from_numpy(rows.distortions[row].copy()),
            "camera_from_object": torch.from_numpy(rows.camera_from_object[row].copy()),
            "points_object": self._points_object,
            "square_box": torch.from_numpy(rows.square_boxes[row].copy()),
            "image_id": int(rows.image_ids[row]),
            "annotation_id": int(rows.annotation_ids[row]),
        }

    def _rectangles(self) -> list[Rectangle]:
        """The rectangle of pixels that the crops of each instance may need."""
        half = reach(self._augment)
        return [
            rectangle_around(box, half=half, width=int(width), height=int(height))
            for box, (width, height) in zip(self._rows.square_boxes, self._rows.sizes, strict=True)
        ]


def _choose(data: dict[str, Any], name: str | None, source: Path) -> tuple[CocoObject, int]:
    """Return the object asked for and its category id."""
    objects = objects_from_coco(data)
    names = [item.model.name for item in objects]
    if name is None and len(objects) == 1:
        return objects[0], 1
    if name not in names:
        asked = "no object was named" if name is None else f"there is no object {name!r}"
        raise DataError(f"{source}: {asked}; choose one of {', '.join(names)}")
    return objects[names.index(name)], names.index(name) + 1


def _canonical(rows: _Instances, item: CocoObject) -> _Instances:
    """Label every instance with the canonical one of the poses that look the same."""
    points, found = item.model.points_object, []
    for row, label in enumerate(zip(rows.camera_from_object, rows.keypoints, rows.square_boxes, strict=True)):
        matrix, (width, height) = rows.camera_matrices[row], rows.sizes[row].tolist()
        focal_and_centre = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        camera = Intrinsics(*focal_and_centre, width, height, tuple(rows.distortions[row].tolist()))
        found.append(canonical_label(*label, item.symmetries, points, camera))
    poses, keypoints, boxes = (np.array(values) for values in zip(*found, strict=True))
    return replace(rows, camera_from_object=poses, keypoints=keypoints, square_boxes=boxes)


def _instances(data: dict[str, Any], category_id: int, folder: Path) -> _Instances:
    chosen = [a for a in data["annotations"] if a["category_id"] == category_id]
    by_id = {image["id"]: image for image in data["images"]}
    images = [by_id[annotation["image_id"]] for annotation in chosen]
    distortions = np.zeros((len(chosen), DISTORTION_LENGTH))
    for row, image in enumerate(images):
        distortions[row, : len(image["distortion"])] = image["distortion"]
    return _Instances(
        files=np.array([str(folder / image["file_name"]) for image in images]),
        image_ids=np.array([image["id"] for image in images], dtype=np.int64),
        annotation_ids=np.array([a["id"] for a in chosen], dtype=np.int64),
        sizes=np.array([[image["width"], image["height"]] for image in images], dtype=np.int64).reshape(
            -1, 2
        ),
        camera_matrices=np.array([image["cam_K"] for image in images], dtype=float).reshape(-1, 3, 3),
        distortions=distortions,
        camera_from_object=np.array([a["camera_from_object"] for a in chosen], dtype=float).reshape(-1, 4, 4),
        keypoints=np.array([a["keypoints"] for a in chosen], dtype=float).reshape(len(chosen), -1, 3)
        if chosen
        else np.zeros((0, 0, 3)),
        square_boxes=np.array([a["square_box"] for a in chosen], dtype=float).reshape(-1, 3),
    )

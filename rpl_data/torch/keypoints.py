"""Dataset of one object's crops with keypoint heatmaps, which the paper's hourglass is trained on."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch.utils.data import Dataset, get_worker_info

from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.torch.colours import jittered
from rpl_data.torch.image_files import read_image
from rpl_data.torch.keypoint_rows import (
    ANNOTATION_KEYS,
    IMAGE_KEYS,
    canonical_rows,
    choose_object,
    keypoint_rows,
)
from rpl_data.torch.keypoint_sample import KeypointSample as KeypointSample
from rpl_data.torch.keypoint_sample import keypoint_sample
from rpl_data.torch.on_device import batch_on_device
from rpl_data.torch.pasting import hide, pasted, pasting_of
from rpl_data.torch.pixel_cache import PixelCache, Rectangle, rectangle_around
from rpl_data.torch.scenes import only_scenes
from rpl_data.torch.splits import split_file
from rpl_data.torch.transforms import (
    Affine,
    Augmentation,
    Image,
    chained,
    crop_from_square,
    moved,
    random_crop_from_square,
    reach,
    warped,
)
from rpl_data.torch.turns import turn_by_places
from rpl_data.torch.views import WHOLE, Transforms, View, transformed
from rpl_data.types import DataError
from rpl_data.wording import counted


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
    visibility            int64    k                       0 not labelled, 1 hidden, 2 seen
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
        sigma_px: sigma of the Gaussians, in heatmap pixels.
        augment: the augmentation, with `auto` decided; None without one.
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
        cache: bool | str | Path = False,
        cache_limit_mb: float | None = None,
        canonical: bool = False,
        transforms: Transforms | None = None,
        heatmaps: bool = True,
        scenes: Collection[str] | None = None,
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
            cache_limit_mb: keep no more than this; the other images are decoded anew for every sample.
            canonical: of the poses that look the same, by the object's symmetries in the export, label every
                instance with the one whose axes are nearest to the camera's, and move keypoints and square
                box with it; without symmetries nothing changes.
            transforms: change the whole image before the crop is cut, as in `InstanceDataset`: called with
                the image and its target of one instance; torchvision.transforms.v2 works as it is,
                albumentations by `from_albumentations`, kornia by `from_kornia`. Keypoints and square box
                are then those of the changed image; where it was moved, no camera is known: `camera_matrix`,
                `distortion` and `camera_from_object` are NaN.
            heatmaps: False leaves them out, for `to_device` to draw.
            scenes: only the images of these; None for all.

        Raises:
            DataError: there is no such split (the message says why), the file is not an export of rpl-data,
                it has no such object or no instance of it, or a size is not above 0.
        """
        if min(input_px, heatmap_px) < 1 or sigma_px <= 0:
            raise DataError(
                f"input_px is {input_px}, heatmap_px {heatmap_px}, sigma_px {sigma_px}; all must be above 0"
            )
        coco_json = split_file(path, split)
        data = only_scenes(
            read_packed(coco_json, {"images": IMAGE_KEYS, "annotations": ANNOTATION_KEYS}), scenes
        )
        self._coco_json = coco_json
        chosen, category_id = choose_object(data, object, coco_json)
        self.model = chosen.model
        self.input_px, self.heatmap_px = input_px, heatmap_px
        self.sigma_px = sigma_px
        self._transforms, self._draws_heatmaps = transforms, heatmaps
        self._rows = keypoint_rows(data, category_id, coco_json.parent)
        if len(self._rows.files) == 0:
            raise NoInstance(f"{coco_json} has no instance of {self.model.name}; train on another split")
        if canonical:
            self._rows = canonical_rows(self._rows, chosen)
        if augment is not None and augment.rotation_deg == "auto":
            turn = turn_by_places(self._rows.places, self._rows.camera_from_object)
            augment = replace(augment, rotation_deg=turn)
        self.augment = augment
        self._pasting = pasting_of(
            augment, data, category_id, self._rows, folder=coco_json.parent, piece_px=input_px
        )
        self._points_object = torch.from_numpy(self.model.points_object.copy())
        self._cache = None
        if cache:
            storage = True if cache is True else Path(cache).expanduser()
            files = self._rows.files.tolist()
            sizes = self._rows.sizes.tolist()
            self._cache = PixelCache(files, self._rectangles(), storage, sizes=sizes, limit_mb=cache_limit_mb)

    @property
    def folder(self) -> Path:
        """The folder of the export."""
        return self._coco_json.parent

    def __repr__(self) -> str:
        return (
            f"KeypointDataset({str(self._coco_json)!r}): {counted(len(self), 'instance')} of "
            f"{self.model.name}, {counted(len(self.model.keypoints), 'keypoint')}, "
            f"crops of {self.input_px} px, heatmaps of {self.heatmap_px} px"
        )

    def __len__(self) -> int:
        """Number of instances."""
        return len(self._rows.files)

    def labelled(self) -> int:
        """How many instances have a labelled keypoint."""
        return int((self._rows.keypoints[..., 2] > 0).any(axis=1).sum())

    def __getitem__(self, row: int) -> KeypointSample:
        """Return the sample of an instance; IndexError past the last."""
        if not -len(self) <= row < len(self):
            raise IndexError(f"instance {row} of {len(self)}")
        row %= len(self)
        if get_worker_info() is not None:
            # OpenCV's threads do not survive the fork of a DataLoader worker, and each worker needs one core.
            cv2.setNumThreads(0)
        rng = None
        if self.augment is not None:
            rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
        view = self._view(row)
        crop_from_image = self._crop_from_image(view, rng)
        size = (self.input_px, self.input_px)
        crop = warped(view.pixels, chained(crop_from_image, view.image_from_pixels), size=size)
        if self.augment is not None and rng is not None:
            crop, view = self._pasted(crop, view, crop_from_image, rng)
            crop = jittered(crop, self.augment, rng)
        return self._sample(row, view, crop, crop_from_image)

    def _pasted(
        self, crop: Image, view: View, crop_from_image: Affine, rng: np.random.Generator
    ) -> tuple[Image, View]:
        """The crop with another background and an occluder, which may hide keypoints of the view."""
        if self._pasting is None or self.augment is None:
            return crop, view
        mask = warped(view.mask() * np.uint8(255), crop_from_image, size=(self.input_px, self.input_px))
        crop, covered = pasted(crop, mask, self._pasting, self.augment, rng)
        if covered is None:
            return crop, view
        on_crop = moved(crop_from_image, view.keypoints[:, :2])
        return crop, replace(view, keypoints=hide(view.keypoints, on_crop, covered))

    def to_device(self, batch: Mapping[str, Any], device: str | torch.device) -> dict[str, Any]:
        """Move a collated batch to a device, and draw its heatmaps there when `heatmaps=False` left them out.

        float64 becomes float32 where the device has no float64 (Apple's MPS).
        """
        sizes = {"input_px": self.input_px, "heatmap_px": self.heatmap_px}
        return batch_on_device(batch, device, sigma_px=self.sigma_px, **sizes)

    def _view(self, row: int) -> View:
        """The image of a row, as far as its crops need it, after the transforms."""
        rows, (pixels, image_from_pixels) = self._rows, self._pixels(row)
        if self._transforms is not None:
            return transformed(pixels, rows, row, self._transforms)
        label = rows.keypoints[row], rows.square_boxes[row]
        return View(pixels, image_from_pixels, *label, lambda: rows.mask(row))

    def _pixels(self, row: int) -> tuple[Image, Affine]:
        """The pixels that the crops of a row may need, and where they lie in the image."""
        if self._cache is None or row not in self._cache:
            return read_image(self._rows.files[row], size=self._rows.sizes[row].tolist()), WHOLE
        pixels, rectangle = self._cache[row]
        return pixels, np.array([[1.0, 0, rectangle.left], [0, 1, rectangle.top]])

    def _crop_from_image(self, view: View, rng: np.random.Generator | None) -> Affine:
        *centre, side = view.square_box
        if self.augment is None or rng is None:
            return crop_from_square(np.array(centre), side, input_px=self.input_px)
        return random_crop_from_square(np.array(centre), side, self.augment, rng, input_px=self.input_px)

    def _sample(self, row: int, view: View, crop: Image, crop_from_image: Affine) -> KeypointSample:
        rows = self._rows
        camera = (rows.camera_matrices[row], rows.distortions[row], rows.camera_from_object[row])
        if view.moved:
            camera = tuple(np.full_like(values, np.nan) for values in camera)
        return keypoint_sample(
            crop,
            crop_from_image,
            view.keypoints,
            view.square_box,
            camera=camera,
            points_object=self._points_object,
            ids=(int(rows.image_ids[row]), int(rows.annotation_ids[row])),
            heatmaps=(self.heatmap_px, self.sigma_px) if self._draws_heatmaps else None,
        )

    def _rectangles(self) -> list[Rectangle]:
        """The rectangle of pixels that the crops of each instance may need; transforms need all of them."""
        if self._transforms is not None:
            return [Rectangle(0, 0, int(width), int(height)) for width, height in self._rows.sizes]
        half = reach(self.augment)
        return [
            rectangle_around(box, half=half, width=int(width), height=int(height))
            for box, (width, height) in zip(self._rows.square_boxes, self._rows.sizes, strict=True)
        ]

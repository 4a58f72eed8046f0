"""Crops of an object that are rendered while a network trains, with the samples of `KeypointDataset`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float64
from torch.utils.data import Dataset, get_worker_info

from rpl_data.geometry import Pixels, Transform, inside_image, project, rays, square_box, transform
from rpl_data.json_arrays import asdict_values
from rpl_data.synthesize.arrange import draw_pose
from rpl_data.synthesize.compose import laid_over, shadowed
from rpl_data.synthesize.light import draw_lights
from rpl_data.synthesize.render import Placed, draw, table_of
from rpl_data.synthesize.storage import load_studio
from rpl_data.synthesize.studio import Plate
from rpl_data.torch.augmentation import Augmentation
from rpl_data.torch.colours import jittered
from rpl_data.torch.cutouts import Piece, Pieces
from rpl_data.torch.image_files import read_image
from rpl_data.torch.keypoint_rows import DISTORTION_LENGTH
from rpl_data.torch.keypoint_sample import KeypointSample, keypoint_sample
from rpl_data.torch.on_device import batch_on_device
from rpl_data.torch.pasting import background
from rpl_data.torch.symmetric import canonical_label
from rpl_data.torch.transforms import (
    Affine,
    Image,
    crop_from_square,
    inverted,
    moved,
    random_crop_from_square,
    warped,
)
from rpl_data.types import DataError, Intrinsics, KeypointModel
from rpl_data.wording import counted

TRIES = 100
"""Draws of a pose; where a table lies unluckily, many would put the object beyond recorded distances."""
SOFT_PX = 0.7
"""Softness of the crop: it is drawn with one ray per pixel, four times as fast as `rpl synthesize` draws."""
LEAST_INSIDE = 0.5
"""Share of the keypoints that lie in the image before it is cropped."""


class SyntheticKeypoints(Dataset[KeypointSample]):
    """New views of one object, rendered when they are asked for; every epoch has others.

    ::

        dataset = SyntheticKeypoints("my-workspace/export/synthetic", object="cup", length=1000)
        both = torch.utils.data.ConcatDataset([KeypointDataset("my-workspace/export/coco", ...), dataset])

    The samples are those of `KeypointDataset`; `image_id` and `annotation_id` are the row, of no file. Poses,
    light and backgrounds are drawn as by `rpl synthesize`, from torch's random state: `torch.manual_seed` and
    DataLoader workers behave as usual. The object is alone in its crop.

    Attributes:
        model: the keypoint model of the object.
        scenes: the recordings that everything is made of.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        object: str,  # noqa: A002 (the recipe's and the CLI's word for it)
        length: int = 1000,
        input_px: int = 256,
        heatmap_px: int = 64,
        sigma_px: float = 1.0,
        augment: Augmentation | None = None,
        canonical: bool = False,
        heatmaps: bool = True,
    ) -> None:
        """Read meshes, colours and lights; pictures are decoded when they are first drawn.

        Args:
            path: the folder that `rpl synthesize` wrote.
            object: its name.
            length: samples per epoch.
            input_px, heatmap_px, sigma_px, canonical, heatmaps: as for `KeypointDataset`.
            augment: shifts, scales, turns and colours, as for `KeypointDataset`; `background` is the share of
                crops with any piece of a background behind the object, in any turn, in place of the table
                that it stands on.

        Raises:
            DataError: the folder holds nothing to render from, or no such object, or `augment` asks for
                occluders, which are cut out of recorded images.
        """
        if augment is not None and (augment.occluders or augment.backgrounds is not None):
            raise DataError(
                "augment.occluders and augment.backgrounds are for recorded crops; leave them out here"
            )
        studio = load_studio(Path(path) / "studio")
        if object not in studio.subjects:
            known = ", ".join(studio.subjects)
            raise DataError(f"{path}: there is no object {object!r} to render; there are {known}")
        self._subject = studio.subjects[object]
        self._studio = replace(studio, subjects={object: self._subject})
        if not self._subject.shown.any():
            raise DataError(
                f"{path}: from no direction the training scenes saw the surface of {object} wholly, so no "
                "view of it would be true; film it from more sides"
            )
        self._length = length
        self.scenes = self._studio.scenes
        self.input_px, self.heatmap_px = input_px, heatmap_px
        self._sigma_px, self._draws_heatmaps, self._canonical = sigma_px, heatmaps, canonical
        if augment is not None and augment.rotation_deg == "auto":
            augment = replace(augment, rotation_deg=self._subject.turn_deg)
        self.augment = augment
        points = self._subject.body.points_object
        self.model = KeypointModel(object, self._subject.keypoints, points)
        self._points_object = torch.from_numpy(points.copy())
        pieces = [Piece(str(plate.color)) for plate in self._studio.plates]
        self._pieces = Pieces(pieces, 2 * input_px)

    def __repr__(self) -> str:
        return (
            f"SyntheticKeypoints: {counted(len(self), 'new view')} of {self.model.name} per epoch, made of "
            f"scenes {', '.join(self.scenes)}"
        )

    def __len__(self) -> int:
        """Samples per epoch."""
        return self._length

    def __getitem__(self, row: int) -> KeypointSample:
        """Render a sample; IndexError past the last."""
        if not -len(self) <= row < len(self):
            raise IndexError(f"view {row} of {len(self)}")
        if get_worker_info() is not None:
            cv2.setNumThreads(0)  # see `KeypointDataset`
        rng = np.random.default_rng(int(torch.randint(2**62, ()).item()))
        plate, pose = self._posed(rng)
        keypoints = self._keypoints(plate.camera, pose)
        square = self._square(keypoints[:, :2], plate.camera, pose)
        shown = pose
        if self._canonical:
            label = (pose, keypoints, square)
            pose, keypoints, square = canonical_label(
                *label, self._subject.symmetries, self._subject.body.points_object, plate.camera
            )
        crop_from_image = self._crop_from_image(square, rng)
        crop = self._rendered(plate, shown, crop_from_image, rng)
        if self.augment is not None:
            crop = jittered(crop, self.augment, rng)
        distortion = np.zeros(DISTORTION_LENGTH)
        distortion[: len(plate.camera.distortion)] = plate.camera.distortion
        return keypoint_sample(
            crop,
            crop_from_image,
            keypoints,
            square,
            camera=(plate.camera.matrix, distortion, pose),
            points_object=self._points_object,
            ids=(row % len(self),) * 2,
            heatmaps=(self.heatmap_px, self._sigma_px) if self._draws_heatmaps else None,
        )

    def to_device(self, batch: Mapping[str, Any], device: str | torch.device) -> dict[str, Any]:
        """Move a collated batch to a device, as `KeypointDataset.to_device` does."""
        sizes = {"input_px": self.input_px, "heatmap_px": self.heatmap_px}
        return batch_on_device(batch, device, sigma_px=self._sigma_px, **sizes)

    def _posed(self, rng: np.random.Generator) -> tuple[Plate, Transform]:
        """Draw a plate and the object's pose before it."""
        for _ in range(TRIES):
            plate = self._studio.plates[int(rng.integers(len(self._studio.plates)))]
            pose = draw_pose(self._studio, self._subject, plate, rng)
            if pose is None:
                continue
            inside = inside_image(plate.camera, project(plate.camera, self._known(pose)))
            if inside.mean() >= LEAST_INSIDE:
                return plate, pose
        raise DataError(
            f"{self.model.name} finds no place on the recorded tables at recorded distances; make the views "
            "with `rpl synthesize --backgrounds`"
        )

    def _known(self, pose: Transform) -> Float64[np.ndarray, "n 3"]:
        points = transform(pose, self._subject.body.points_object)
        known: Float64[np.ndarray, "n 3"] = points[np.isfinite(points).all(axis=1)]
        return known

    def _keypoints(self, camera: Intrinsics, pose: Transform) -> Float64[np.ndarray, "k 3"]:
        """u, v and COCO's visibility."""
        body = self._subject.body
        uv = project(camera, transform(pose, body.points_object))
        inside = inside_image(camera, uv)
        seen = body.around.faces(body.rays, pose)
        return np.column_stack([uv, np.where(inside, np.where(seen, 2, 1), 0)])

    def _square(self, keypoints_px: Pixels, camera: Intrinsics, pose: Transform) -> Float64[np.ndarray, "3"]:
        """The paper's square box; around the whole object where fewer than two keypoints project."""
        around = keypoints_px[np.isfinite(keypoints_px).all(axis=1)]
        if len(around) < 2:
            around = project(camera, transform(pose, self._subject.body.hull))
            around = around[np.isfinite(around).all(axis=1)]
        return np.array(asdict_values(square_box(around)))

    def _crop_from_image(self, square: Float64[np.ndarray, "3"], rng: np.random.Generator) -> Affine:
        if self.augment is None:
            return crop_from_square(square[:2], square[2], input_px=self.input_px)
        return random_crop_from_square(square[:2], square[2], self.augment, rng, input_px=self.input_px)

    def _rendered(
        self, plate: Plate, pose: Transform, crop_from_image: Affine, rng: np.random.Generator
    ) -> Image:
        """Draw the crop."""
        placed = [Placed(self._subject.body, pose)]
        lights = draw_lights({self.model.name: self._subject.lights}, plate.up, rng)
        table = table_of(self._directions(plate.camera, crop_from_image), plate.camera)
        if self.augment is not None and rng.uniform() < self.augment.background:
            behind = background(self._pieces, self.input_px, rng)
        else:
            size = (self.input_px, self.input_px)
            behind = warped(self._picture(plate), crop_from_image, size=size)
            behind = shadowed(behind, table, placed, plate.table, lights[self.model.name])
        drawing = draw(table, placed, lights, finer=1)
        return laid_over(behind, drawing, self._studio.noise, rng, soft_px=SOFT_PX)

    def _directions(self, camera: Intrinsics, crop_from_image: Affine) -> Float64[np.ndarray, "h w 3"]:
        """Rays through the pixels of the crop."""
        directions = rays(camera, moved(inverted(crop_from_image), self._grid))
        return directions.reshape(self.input_px, self.input_px, 3)

    @cached_property
    def _grid(self) -> Float64[np.ndarray, "n 2"]:
        """The pixels of a crop."""
        side = np.arange(self.input_px, dtype=float)
        return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)

    @cached_property
    def _pictures(self) -> dict[Path, Image]:
        """The plates that were decoded in this process."""
        return {}

    def _picture(self, plate: Plate) -> Image:
        if plate.color not in self._pictures:
            self._pictures[plate.color] = read_image(str(plate.color))
        return self._pictures[plate.color]

    def __getstate__(self) -> dict[str, Any]:
        """Without what each worker makes for itself: the decoded plates above all."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_pictures", "_grid")}

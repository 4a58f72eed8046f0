"""One object's views of an exported COCO folder: colour as PNG, depth in millimetres, mask and pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8, UInt16

from rpl_data.export.color_images import write_color
from rpl_data.export.dialect import Split
from rpl_data.export.folder import link
from rpl_data.files import write_bytes
from rpl_data.formats.datasets.coco import intrinsics_from_coco
from rpl_data.formats.recordings.plausibility import SATURATED
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.geometry import Transform, invert
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.types import DataError, Intrinsics

MILLIMETRE = 0.001
MOST_UNITS = np.iinfo(np.uint16).max
MOST_NUMBERS = np.iinfo(np.uint8).max


@dataclass(frozen=True)
class View:
    """An object in an image.

    Attributes:
        image, annotation: their entries in the COCO file.
        object_from_camera: the camera's pose in the object frame, OpenCV axes, metres.
    """

    image: Json
    annotation: Json
    object_from_camera: Transform

    @property
    def direction(self) -> Float64[np.ndarray, "3"]:
        """Unit vector from the object's origin to the camera, object frame."""
        towards = self.object_from_camera[:3, 3]
        return np.asarray(towards / np.linalg.norm(towards))

    @property
    def camera(self) -> Intrinsics:
        """The camera that took the image."""
        return intrinsics_from_coco(self.image)


def views_of(split: Split, category: int) -> list[View]:
    """The images of a split that show an object and have a depth image, in their order."""
    found = []
    for image in split.images:
        for annotation in split.annotations.get(image["id"], []):
            if annotation["category_id"] == category and image["depth_file_name"] is not None:
                pose = invert(matrix_from_json(annotation["camera_from_object"]))
                found.append(View(image, annotation, pose))
    return found


def refuse_distortion(views: Sequence[View], layout: str) -> None:
    """Raise a DataError where a lens bends lines, which a layout with a 3 x 3 matrix alone cannot say."""
    for view in views:
        refuse_lens(view.image, layout)


def refuse_lens(image: Json, layout: str) -> None:
    """Raise a DataError where the lens of an image bends lines."""
    if any(image["distortion"]):
        raise DataError(
            f"scene {image['scene']} was taken by a lens with distortion, and {layout} holds a "
            "3 x 3 matrix only; undistort the recording first, or leave this format out of `export`"
        )


def refuse_rgb_in(folder: Path) -> None:
    """Raise a DataError where readers would be led astray that replace `rgb` anywhere in a path."""
    if "rgb" in str(folder.resolve()):
        raise DataError(
            f"{folder}: readers of this layout replace `rgb` anywhere in the path of an image, and so would "
            "find no depth here; build in a workspace whose path does not contain `rgb`"
        )


def rows_of(matrix: Float64[np.ndarray, "rows columns"]) -> str:
    """A matrix as text, one row per line."""
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in matrix)


def write_view(
    view: View, coco: Path, *, color: Path, depth: Path, mask: Path, metres_per_unit: Mapping[str, float]
) -> None:
    """Write the images of a view; what is stored already as it is wanted is linked.

    Args:
        view: the view.
        coco: the exported COCO folder.
        color, depth, mask: the PNG files to write: 8 bit; 16 bit in mm; 0 and 255.
        metres_per_unit: of the depth images in the COCO folder, by scene name.
    """
    from pycocotools import mask as masks

    write_color(coco / view.image["file_name"], color.with_suffix(""), "png")
    write_depth(coco / view.image["depth_file_name"], depth, metres_per_unit[view.image["scene"]], MILLIMETRE)
    seen = masks.decode(view.annotation["segmentation"])
    write_bytes(mask, encoded(255 * seen, "png"))


def write_depth(source: Path, target: Path, stored_m: float, wanted_m: float) -> None:
    """Write a depth image as PNG in another unit; what is stored already as it is wanted is linked.

    Args:
        source, target: the image of the COCO folder, and the file to write.
        stored_m, wanted_m: metres per unit of both.
    """
    if np.isclose(stored_m, wanted_m) and source.suffix == ".png":
        link(source, target)
    else:
        write_bytes(target, encoded(_in_units(_read(source), stored_m / wanted_m), "png"))


def _in_units(raw: UInt16[np.ndarray, "h w"], factor: float) -> UInt16[np.ndarray, "h w"]:
    """Depth in whole units; none where it is farther than 16 bits hold, or saturated."""
    units = np.rint(raw * factor)
    return np.where((units > MOST_UNITS) | (raw == SATURATED), 0, units).astype(np.uint16)


def numbered(image: Json, annotations: Sequence[Json], numbers: Sequence[int]) -> UInt8[np.ndarray, "h w"]:
    """The number of the annotation that is seen in each pixel, 0 = none.

    Args:
        image, annotations: entries of the COCO file.
        numbers: one per annotation, from 1.

    Raises:
        DataError: a number is larger than 8 bits hold.
    """
    from pycocotools import mask as masks

    if max(numbers, default=0) > MOST_NUMBERS:
        raise DataError(f"{image['file_name']}: a mask of 8 bits numbers {MOST_NUMBERS}, not {max(numbers)}")
    result = np.zeros((image["height"], image["width"]), np.uint8)
    for number, annotation in zip(numbers, annotations, strict=True):
        result[masks.decode(annotation["segmentation"]) > 0] = number
    return result


def _read(path: Path) -> UInt16[np.ndarray, "h w"]:
    """A depth image as it is stored."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DataError(f"{path} cannot be read; export `coco` again")
    return image

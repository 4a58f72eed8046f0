"""Plates: images of the training scenes without their objects, whose places other images of the scene fill.

Where an object stood, the camera saw the table from elsewhere. The plane of the table takes pixels of such
images there; what no image shows, below the object, is filled from its border.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.files import write_bytes
from rpl_data.formats.datasets.coco import depth_unit_m, intrinsics_from_coco, visible_mask
from rpl_data.formats.datasets.coco_parts import ByImage
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.geometry import Transform, invert
from rpl_data.images import read_pixels
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.pipeline.synthesis.training import Training
from rpl_data.raycast import pixel_rays
from rpl_data.synthesize.studio import Plane, Plate
from rpl_data.types import ColorImage, DataError, DepthUnits, Intrinsics, spread_evenly

MOST_PLATES = 60
BEYOND_PX = 9
"""Pixels around an object's mask that are replaced with it: its rim and the darkest of its shadow."""
OTHERS = 5
"""Images of the same scene that fill one plate."""
FILLED_PX = 5
"""Radius from which the last holes are filled."""

Table = tuple[Float64[np.ndarray, "3"], float]
"""Normal and offset of a plane, scene frame."""


@dataclass(frozen=True)
class _Image:
    entry: Json
    camera: Intrinsics
    scene_from_camera: Transform
    objects: Bool[np.ndarray, "height width"]

    @staticmethod
    def of(entry: Json, annotations: Sequence[Json]) -> _Image:
        """An image and where its objects are, with a border."""
        camera = intrinsics_from_coco(entry)
        union = np.zeros((camera.height, camera.width), np.uint8)
        for one in annotations:
            union |= visible_mask(one).view(np.uint8)
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BEYOND_PX + 1,) * 2)
        grown = cv2.dilate(union, kernel) > 0
        return _Image(entry, camera, matrix_from_json(entry["scene_from_camera"]), grown)

    def color(self, folder: Path) -> ColorImage:
        """Its pixels; DataError when they cannot be read."""
        image = read_pixels(folder / self.entry["file_name"])
        if image is None:
            raise DataError(
                f"cannot read {folder / self.entry['file_name']}: it is missing or damaged; export again"
            )
        return image


def make_plates(
    folder: Path,
    training: Training,
    part_of: Callable[[Json], str],
    tables: Mapping[str, Table | None],
    ups: Mapping[str, np.ndarray],
) -> tuple[Plate, ...]:
    """Write plates of images spread over the training scenes.

    Args:
        folder: gets plates/.
        part_of: the part of its recording that an image is in. Poses drift from part to part, and the table
            with them, so images fill only plates of their own part.
        tables: by part.
        ups: upward direction by part, scene frame.
    """
    # Regions that a person marked as ignored may show an object, too, which no label would name.
    by_image = ByImage(training.data["annotations"], training.data.get("crowds", ()))
    by_part: dict[str, list[Json]] = {}
    for image in training.data["images"]:
        by_part.setdefault(part_of(image), []).append(image)
    each = -(-MOST_PLATES // len(by_part))
    plates = []
    for part, entries in sorted(by_part.items()):
        chosen = spread_evenly(entries, each)
        images = [_Image.of(entry, by_image.get(entry["id"], [])) for entry in chosen]
        for image in images:
            others = spread_evenly([other for other in images if other is not image], OTHERS)
            plates.append(_plate(folder, training.folder, image, others, tables[part], ups[part]))
    return tuple(plates)


def _plate(
    folder: Path, export: Path, image: _Image, others: Sequence[_Image], table: Table | None, up: np.ndarray
) -> Plate:
    entry = image.entry
    name = f"plates/{entry['scene']}_{entry['frame']:06d}"
    turn = image.scene_from_camera[:3, :3]
    plane = None if table is None else plane_in_camera(table, image.scene_from_camera)
    color = without_objects(image, others, plane, export)
    write_bytes(folder / f"{name}.jpg", encoded(color[..., ::-1], "jpg"))
    depth = None
    if entry["depth_file_name"] is not None and plane is not None:
        units = _depth_without_objects(image, plane, export)
        depth = folder / f"{name}.png"
        write_bytes(depth, encoded(units, "png"))
    return Plate(
        entry["scene"],
        entry["frame"],
        folder / f"{name}.jpg",
        depth,
        None if depth is None else depth_unit_m(entry),
        image.camera,
        turn.T @ up,
        plane,
    )


def plane_in_camera(table: Table, scene_from_camera: Transform) -> Plane:
    """The plane before a camera."""
    normal, offset_m = table
    return Plane(scene_from_camera[:3, :3].T @ normal, float(offset_m - normal @ scene_from_camera[:3, 3]))


def without_objects(image: _Image, others: Sequence[_Image], plane: Plane | None, export: Path) -> ColorImage:
    """The image with the places of its objects filled from others of its scene."""
    color, hole = image.color(export).copy(), image.objects.copy()
    for other in others if plane is not None else ():
        if not hole.any():
            break
        assert plane is not None
        other_from_image = _homography(image, other, plane)
        size = (image.camera.width, image.camera.height)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        usable = cv2.warpPerspective((~other.objects).astype(np.uint8), other_from_image, size, flags=flags)
        shown = hole & (usable > 0)
        if shown.any():
            color[shown] = cv2.warpPerspective(other.color(export), other_from_image, size, flags=flags)[
                shown
            ]
            hole &= ~shown
    if hole.any():
        color = cv2.inpaint(color, hole.astype(np.uint8), FILLED_PX, cv2.INPAINT_TELEA)
    return color


def _homography(image: _Image, other: _Image, plane: Plane) -> Float64[np.ndarray, "3 3"]:
    """Takes pixels of one image to those of another that show the same point of the plane."""
    other_from_image = invert(other.scene_from_camera) @ image.scene_from_camera
    turn, shift = other_from_image[:3, :3], other_from_image[:3, 3]
    by_plane = turn + np.outer(shift, plane.normal) / plane.offset_m
    found: Float64[np.ndarray, "3 3"] = other.camera.matrix @ by_plane @ np.linalg.inv(image.camera.matrix)
    return found


def _depth_without_objects(image: _Image, plane: Plane, export: Path) -> DepthUnits:
    """Its depth image with that of the table where objects were."""
    file = export / image.entry["depth_file_name"]
    units = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if units is None or units.dtype != np.uint16:
        raise DataError(f"cannot read the depth image {file}: it is missing or damaged; export again")
    directions = pixel_rays(
        image.camera, left_px=0, top_px=0, width=image.camera.width, height=image.camera.height
    )
    along = directions @ plane.normal
    table_m = np.where(along < -1e-3, plane.offset_m / np.minimum(along, -1e-3), 0.0)
    table = (table_m / depth_unit_m(image.entry)).round().clip(0, np.iinfo(np.uint16).max)
    filled: DepthUnits = np.where(image.objects, table, units).astype(np.uint16)
    return filled

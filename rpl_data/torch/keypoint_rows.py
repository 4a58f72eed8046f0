"""The annotations of one object as arrays: what `KeypointDataset` draws its samples from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from rpl_data.formats.datasets.coco import CocoObject, objects_from_coco
from rpl_data.torch.symmetric import canonical_label
from rpl_data.torch.targets import decoded_masks
from rpl_data.types import DataError, Intrinsics

DISTORTION_LENGTH = 14
"""Length of OpenCV's longest list of distortion coefficients; shorter lists are padded with zeros."""


@dataclass(frozen=True)
class KeypointRows:
    """The annotations of one object as arrays, one row per instance.

    Arrays, not dictionaries: worker processes share their memory, while a list of dictionaries would be
    copied as soon as reference counts change. `masks` are packed as COCO packs them.
    """

    files: np.ndarray
    scenes: np.ndarray
    masks: np.ndarray
    image_ids: Int64[np.ndarray, " n"]
    annotation_ids: Int64[np.ndarray, " n"]
    sizes: Int64[np.ndarray, "n 2"]
    camera_matrices: Float64[np.ndarray, "n 3 3"]
    distortions: Float64[np.ndarray, "n c"]
    camera_from_object: Float64[np.ndarray, "n 4 4"]
    keypoints: Float64[np.ndarray, "n k 3"]
    square_boxes: Float64[np.ndarray, "n 3"]

    def mask(self, row: int) -> UInt8[np.ndarray, "height width"]:
        """Decode the visible mask of a row: 1 where the object is seen."""
        width, height = self.sizes[row].tolist()
        packed = {"size": [height, width], "counts": bytes(self.masks[row])}
        decoded: UInt8[np.ndarray, "height width"] = decoded_masks([packed], (height, width))[0].numpy()
        return decoded


def choose_object(data: dict[str, Any], name: str | None, source: Path) -> tuple[CocoObject, int]:
    """Return the object asked for and its category id."""
    objects = objects_from_coco(data)
    names = [item.model.name for item in objects]
    if name is None and len(objects) == 1:
        return objects[0], 1
    if name not in names:
        asked = "no object was named" if name is None else f"there is no object {name!r}"
        raise DataError(f"{source}: {asked}; choose one of {', '.join(names)}")
    return objects[names.index(name)], names.index(name) + 1


def keypoint_rows(data: dict[str, Any], category_id: int, folder: Path) -> KeypointRows:
    """Collect the annotations of an object; the files of `data` are relative to `folder`."""
    chosen = [a for a in data["annotations"] if a["category_id"] == category_id]
    by_id = {image["id"]: image for image in data["images"]}
    images = [by_id[annotation["image_id"]] for annotation in chosen]
    distortions = np.zeros((len(chosen), DISTORTION_LENGTH))
    for row, image in enumerate(images):
        distortions[row, : len(image["distortion"])] = image["distortion"]
    return KeypointRows(
        files=np.array([str(folder / image["file_name"]) for image in images]),
        scenes=np.array([image["scene"] for image in images], dtype=np.str_),
        masks=np.array([a["segmentation"]["counts"].encode() for a in chosen], dtype=np.bytes_),
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


def canonical_rows(rows: KeypointRows, item: CocoObject) -> KeypointRows:
    """Label every instance with the canonical one of the poses that look the same."""
    points, found = item.model.points_object, []
    for row, label in enumerate(zip(rows.camera_from_object, rows.keypoints, rows.square_boxes, strict=True)):
        matrix, (width, height) = rows.camera_matrices[row], rows.sizes[row].tolist()
        focal_and_centre = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        camera = Intrinsics(*focal_and_centre, width, height, tuple(rows.distortions[row].tolist()))
        found.append(canonical_label(*label, item.symmetries, points, camera))
    poses, keypoints, boxes = (np.array(values) for values in zip(*found, strict=True))
    return replace(rows, camera_from_object=poses, keypoints=keypoints, square_boxes=boxes)

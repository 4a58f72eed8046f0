"""The annotations of one object as arrays: what `KeypointDataset` draws its samples from."""

from __future__ import annotations

import os
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from rpl_data.formats.datasets.coco import CocoObject, objects_from_coco
from rpl_data.formats.datasets.coco_parts import collector_waiting
from rpl_data.torch.symmetric import canonical_label
from rpl_data.torch.targets import decoded_masks
from rpl_data.types import DataError, Intrinsics

DISTORTION_LENGTH = 14
"""Length of OpenCV's longest list of distortion coefficients; shorter lists are padded with zeros."""


@dataclass(frozen=True)
class KeypointRows:
    """The annotations of one object as arrays, one row per instance.

    Arrays, not dictionaries: worker processes share their memory, while a list of dictionaries would be
    copied as soon as reference counts change. `masks` are packed as COCO packs them; `places` name the scene
    and, where a scene shows the object several times, the instance.
    """

    files: np.ndarray
    places: np.ndarray
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


IMAGE_KEYS = ("id", "file_name", "scene", "width", "height", "cam_K", "distortion")
ANNOTATION_KEYS = (
    *("id", "image_id", "category_id", "segmentation", "area", "bbox", "keypoints"),
    *("camera_from_object", "visib_fract", "square_box", "instance"),
)
"""What `keypoint_rows` and the cutouts of `pasting_of` need of a COCO file."""


def keypoint_rows(data: Mapping[str, Any], category_id: int, folder: Path) -> KeypointRows:
    """Collect the annotations of an object; the files of `data` are relative to `folder`."""
    with collector_waiting():
        return _keypoint_rows(data, category_id, folder)


def _keypoint_rows(data: Mapping[str, Any], category_id: int, folder: Path) -> KeypointRows:
    images = _ImageColumns.of(data["images"], folder)
    masks: list[bytes] = []
    instances: list[str] = []
    own, poses, keypoints, boxes = array("q"), array("d"), array("d"), array("d")
    for annotation in data["annotations"]:
        if annotation["category_id"] == category_id:
            masks.append(annotation["segmentation"]["counts"].encode())
            instances.append(annotation.get("instance", ""))
            own.extend((annotation["id"], annotation["image_id"]))
            poses.extend(annotation["camera_from_object"])
            keypoints.extend(annotation["keypoints"])
            boxes.extend(annotation["square_box"])
    ids = np.array(own, dtype=np.int64).reshape(-1, 2)
    rows = np.array([images.row_of[number] for number in ids[:, 1].tolist()], dtype=np.int64)
    count = len(rows)
    return KeypointRows(
        files=images.files[rows],
        places=np.array([f"{images.scenes[row]}/{one}" for row, one in zip(rows, instances, strict=True)]),
        masks=np.array(masks, dtype=np.bytes_),
        image_ids=ids[:, 1],
        annotation_ids=ids[:, 0],
        sizes=images.sizes[rows],
        camera_matrices=images.matrices[rows],
        distortions=images.distortions[rows],
        camera_from_object=np.array(poses).reshape(-1, 4, 4),
        keypoints=np.array(keypoints).reshape(count, -1, 3) if count else np.zeros((0, 0, 3)),
        square_boxes=np.array(boxes).reshape(-1, 3),
    )


@dataclass(frozen=True)
class _ImageColumns:
    """The images of a file as arrays, and the row of each by its id."""

    row_of: dict[int, int]
    files: np.ndarray
    scenes: np.ndarray
    sizes: Int64[np.ndarray, "n 2"]
    matrices: Float64[np.ndarray, "n 3 3"]
    distortions: Float64[np.ndarray, "n c"]

    @staticmethod
    def of(images: Sequence[Mapping[str, Any]], folder: Path) -> _ImageColumns:
        """Read them one by one: all of them together may not fit the memory."""
        count = len(images)
        row_of: dict[int, int] = {}
        files, scenes = [], []
        sizes, matrices, distortions = array("q"), array("d"), np.zeros((count, DISTORTION_LENGTH))
        for row, image in enumerate(images):
            row_of[image["id"]] = row
            files.append(os.path.join(folder, image["file_name"]))
            scenes.append(image["scene"])
            sizes.extend((image["width"], image["height"]))
            matrices.extend(image["cam_K"])
            if image["distortion"]:
                distortions[row, : len(image["distortion"])] = image["distortion"]
        return _ImageColumns(
            row_of,
            np.array(files, dtype=np.str_),
            np.array(scenes, dtype=np.str_),
            np.array(sizes, dtype=np.int64).reshape(-1, 2),
            np.array(matrices).reshape(-1, 3, 3),
            distortions,
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

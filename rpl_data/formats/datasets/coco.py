"""COCO instances and keypoints, with extra keys for pose, camera and quality that COCO readers ignore.

There is one file per split. A category is an object, ids from 1; boxes are ``x y width height``; masks are
compressed RLE; keypoints and square boxes use our pixel convention (the centre of the top-left pixel is
(0, 0)). File names are relative to the folder of the JSON file.

The extra keys are listed in `coco_check`; matrices are row-major, `sigma_px` is null where v = 0.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.files import writing
from rpl_data.formats.datasets.coco_check import validate_coco
from rpl_data.formats.datasets.coco_edited import as_exported
from rpl_data.formats.datasets.coco_entries import CocoWriter, writing_entries
from rpl_data.formats.datasets.coco_objects import CocoObject as CocoObject
from rpl_data.formats.datasets.coco_objects import category_to_coco, object_to_coco
from rpl_data.formats.datasets.coco_objects import objects_from_coco as objects_from_coco
from rpl_data.formats.datasets.coco_parts import read_fast
from rpl_data.json_arrays import Json, asdict_values, matrix_from_json, numbers
from rpl_data.types import Box, DataError, Frame, FrameLabel, InstanceLabel, Intrinsics, Rle, SquareBox
from rpl_data.version import installed_version

# To COCO ------------------------------------------------------------------------------------------


def header(objects: Sequence[CocoObject]) -> Json:
    """Make everything but images and annotations; categories are numbered from 1 in the given order."""
    return {
        "info": {"description": "made by rpl-data", "version": "1.0"},
        "licenses": [],
        "categories": [category_to_coco(number, item.model) for number, item in enumerate(objects, start=1)],
        "rpl": {
            "version": installed_version(),
            "objects": [object_to_coco(number, item) for number, item in enumerate(objects, start=1)],
        },
    }


def image_to_coco(
    image_id: int,
    frame: Frame,
    *,
    scene: str,
    intrinsics: Intrinsics,
    scene_from_camera: Float64[np.ndarray, "4 4"],
    file_name: str,
    depth_file_name: str | None,
    metres_per_unit: float | None = None,
) -> Json:
    """Make the entry of an image; `metres_per_unit` is that of its depth image."""
    known = depth_file_name is not None and metres_per_unit is not None
    return {
        "id": image_id,
        "file_name": file_name,
        "width": intrinsics.width,
        "height": intrinsics.height,
        "scene": scene,
        "frame": frame.index,
        "timestamp_s": frame.timestamp_s,
        "cam_K": numbers(intrinsics.matrix),
        "distortion": list(intrinsics.distortion),
        "scene_from_camera": numbers(scene_from_camera),
        "depth_file_name": depth_file_name,
        **({"metres_per_unit": metres_per_unit} if known else {}),
    }


def instance_to_coco(
    annotation_id: int, image_id: int, category_id: int, instance: InstanceLabel
) -> Json | None:
    """Make the entry of an instance; None when no pixel of it is visible, which COCO cannot express."""
    from pycocotools import mask as masks

    area = int(masks.area(instance.mask))
    if area == 0:
        return None
    return {
        "id": annotation_id,
        "image_id": image_id,
        "category_id": category_id,
        "segmentation": dict(instance.mask),
        "area": area,
        "bbox": _box_of(instance.mask),
        "iscrowd": int(instance.crowd),
        "keypoints": _keypoints_to_coco(instance),
        "num_keypoints": int((instance.visibility > 0).sum()),
        "camera_from_object": numbers(instance.camera_from_object),
        "visib_fract": float(instance.visib_fract),
        "truncated": bool(instance.truncated),
        "segmentation_full": dict(instance.mask_full),
        "bbox_full": _box_of(instance.mask_full),
        "square_box": asdict_values(instance.square_box),
        "sigma_px": [
            float(s) if v > 0 and math.isfinite(s) else None
            for s, v in zip(instance.sigma_px, instance.visibility, strict=True)
        ],
        "quality": float(instance.quality),
        **({"corrected": True} if instance.corrected else {}),
        **({"instance": instance.instance} if instance.instance else {}),
    }


def _keypoints_to_coco(instance: InstanceLabel) -> list[float | int]:
    """x, y, v per keypoint; 0, 0, 0 where it is not labelled."""
    flat: list[float | int] = []
    for (u, v), seen in zip(instance.keypoints_px, instance.visibility, strict=True):
        flat += [round(float(u), 4), round(float(v), 4), int(seen)] if seen > 0 else [0.0, 0.0, 0]
    return flat


def _box_of(mask: Rle) -> list[float]:
    """x, y, width, height of a mask, taken from its pixels so that box and mask always agree."""
    from pycocotools import mask as masks

    return [float(side) for side in masks.toBbox(mask)]


# From COCO ----------------------------------------------------------------------------------------


def intrinsics_from_coco(image: Mapping[str, Any]) -> Intrinsics:
    """Read the camera of an image."""
    fx, _, cx, _, fy, cy, *_ = image["cam_K"]
    return Intrinsics(fx, fy, cx, cy, image["width"], image["height"], tuple(image["distortion"]))


def depth_unit_m(image: Mapping[str, Any], told_m: float | None = None) -> float:
    """Metres per unit of an image's depth image, as the file says.

    Args:
        told_m: what somebody says it is, for files of earlier versions, which do not say it.

    Raises:
        DataError: nobody says it, or both do and differ.
    """
    own_m = image.get("metres_per_unit")
    unit_m = told_m if own_m is None else own_m
    if unit_m is None:
        raise DataError(
            f"{image['file_name']}: the file does not say in which unit its depth images are; export the "
            "labels again, or give metres_per_unit (0.001 for millimetres)"
        )
    if own_m is not None and told_m is not None and not math.isclose(own_m, told_m, rel_tol=1e-6):
        raise DataError(
            f"{image['file_name']}: a unit of its depth image is {own_m:g} m, says the file; metres_per_unit "
            f"is {told_m:g}: leave it out"
        )
    return float(unit_m)


def labels_from_coco(data: Mapping[str, Any]) -> list[FrameLabel]:
    """Read the labels of a file, one frame per image, in its order; keypoints with v = 0 become NaN."""
    names = {category["id"]: category["name"] for category in data["categories"]}
    instances: dict[int, list[InstanceLabel]] = {image["id"]: [] for image in data["images"]}
    for annotation in data["annotations"]:
        instances[annotation["image_id"]].append(
            instance_from_coco(annotation, names[annotation["category_id"]])
        )
    return [
        FrameLabel(image["scene"], image["frame"], image["timestamp_s"], tuple(instances[image["id"]]))
        for image in data["images"]
    ]


def instance_from_coco(annotation: Mapping[str, Any], object_name: str) -> InstanceLabel:
    """Convert what `instance_to_coco` returned back to an instance."""
    flat = np.array(annotation["keypoints"], dtype=float).reshape(-1, 3)
    visibility = flat[:, 2].astype(np.int64)
    return InstanceLabel(
        object=object_name,
        camera_from_object=matrix_from_json(annotation["camera_from_object"]),
        keypoints_px=np.where(visibility[:, None] > 0, flat[:, :2], np.nan),
        visibility=visibility,
        sigma_px=np.array([math.nan if s is None else s for s in annotation["sigma_px"]], dtype=float),
        square_box=SquareBox(*annotation["square_box"]),
        box=_xyxy(annotation["bbox"]),
        box_full=_xyxy(annotation["bbox_full"]),
        mask=_rle(annotation["segmentation"]),
        mask_full=_rle(annotation["segmentation_full"]),
        visib_fract=float(annotation["visib_fract"]),
        truncated=annotation["truncated"],
        quality=float(annotation["quality"]),
        corrected=annotation.get("corrected") is True,
        instance=annotation.get("instance", ""),
    )


def visible_mask(annotation: Mapping[str, Any]) -> Bool[np.ndarray, "height width"]:
    """Decode the visible mask of an annotation of ours."""
    from pycocotools import mask as masks

    decoded: Bool[np.ndarray, "height width"] = masks.decode(annotation["segmentation"]).astype(bool)
    return decoded


def _xyxy(xywh: Sequence[float]) -> Box:
    x, y, width, height = xywh
    return float(x), float(y), float(x + width), float(y + height)


def _rle(segmentation: Mapping[str, Any]) -> Rle:
    return {"size": list(segmentation["size"]), "counts": segmentation["counts"]}


# Files --------------------------------------------------------------------------------------------


@contextmanager
def writing_coco(path: Path, objects: Sequence[CocoObject]) -> Iterator[CocoWriter]:
    """Yield a writer whose file appears, complete, when the block ends well; memory stays constant."""
    with writing_entries(path, header(objects)) as writer:
        yield writer


def write_coco(path: Path, data: Json) -> None:
    """Write a file from its parts in memory; `data` is what `read_coco` returns.

    Crowds go back among the annotations, where COCO has them.
    """
    validate_coco(data, source=str(path))
    whole = {key: value for key, value in data.items() if key != "crowds"}
    whole["annotations"] = [*data["annotations"], *data.get("crowds", ())]
    with writing(path) as file:
        json.dump(whole, file, allow_nan=False)


def read_coco(path: Path) -> Json:
    """Read and validate a file, which may be edited elsewhere; DataError when it is damaged or foreign.

    100,000 annotations take 600 MB as dictionaries, which may be changed. What only reads them uses
    `coco_parts.read_packed`.
    """
    data = as_exported(read_fast(path), source=str(path))
    validate_coco(data, source=str(path))
    return data

"""An image folder with metadata, as `load_dataset("imagefolder", data_dir=...)` of Hugging Face reads it.

::

    <folder>/{train,validation,test}/metadata.jsonl    one line per image
                                     <scene>_<frame>.jpg

`objects` of a line has the same columns for each instance: id, category (index into `categories`), bbox
(x, y, width, height, pixels), area, keypoints (x, y, v), camera_from_object (16 numbers, metres), quality,
instance (a name where a scene shows several of an object).
Layout: https://huggingface.co/docs/datasets/image_dataset (object detection).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.files import write_json, write_text
from rpl_data.json_arrays import Json

CALLED = {"train": "train", "val": "validation", "test": "test"}


def export_huggingface(folder: Path, coco: Path) -> DialectSummary:
    """Write `folder` from an exported COCO folder; images are linked.

    Raises:
        DataError: the COCO folder is missing or broken, or the folder cannot be written.
    """
    images: dict[str, int] = {}
    instances = 0
    with replacing(folder) as building:
        for split in splits_of(coco):
            lines = []
            place = building / CALLED[split.name]
            for image in split.images:
                source = coco / image["file_name"]
                name = f"{image['scene']}_{image['frame']:06d}{source.suffix}"
                link(source, place / name)
                annotations = split.annotations.get(image["id"], [])
                lines.append(json.dumps(_line(name, image, annotations), allow_nan=False))
                instances += len(annotations)
            write_text(place / "metadata.jsonl", "".join(f"{line}\n" for line in lines))
            write_json(
                building / "categories.json",
                _categories(split.data["categories"]),
            )
            images[split.name] = len(split.images)
    return DialectSummary(images, instances)


COLUMNS = ("id", "bbox", "area", "keypoints", "camera_from_object", "visib_fract", "quality")


def _line(name: str, image: Json, annotations: Sequence[Json]) -> Json:
    objects = {column: [one[column] for one in annotations] for column in COLUMNS}
    objects["instance"] = [one.get("instance", "") for one in annotations]
    objects["category"] = [one["category_id"] - 1 for one in annotations]
    kept = {key: image[key] for key in ("width", "height", "scene", "frame", "timestamp_s", "cam_K")}
    return {"file_name": name, "image_id": image["id"], **kept, "objects": objects}


def _categories(categories: Sequence[Json]) -> Json:
    """Names by index, and each object's keypoints."""
    ordered = sorted(categories, key=lambda item: int(item["id"]))
    return {
        "categories": [item["name"] for item in ordered],
        "keypoints": {item["name"]: item["keypoints"] for item in ordered},
    }

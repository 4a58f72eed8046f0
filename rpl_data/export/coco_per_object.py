"""COCO with one folder per object, for readers that know one category and one skeleton.

::

    <folder>/<object>/{train,val,test}.json    as in `coco`, its one category numbered 1
                      images/ depth/ meshes/

An object's folder holds the scenes that show it in that split, with their empty images.
"""

from __future__ import annotations

from pathlib import Path

from rpl_data.export.dialect import DialectSummary, Split, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.formats.datasets.coco import write_coco
from rpl_data.json_arrays import Json


def export_coco_per_object(folder: Path, coco: Path) -> DialectSummary:
    """Write `folder` from an exported COCO folder; images are linked.

    Raises:
        DataError: the COCO folder is missing or broken, or the folder cannot be written.
    """
    images: dict[str, int] = {}
    instances = 0
    with replacing(folder) as building:
        for split in splits_of(coco):
            images[split.name] = 0
            for category in split.data["categories"]:
                data = only(split, category["id"])
                if data["images"]:
                    _write_object(building / category["name"], coco, split.name, data)
                images[split.name] += len(data["images"])
                instances += len(data["annotations"])
    return DialectSummary(images, instances)


def only(split: Split, category: int) -> Json:
    """The content of a split's file that is about one object, which becomes category 1."""
    mine = [one for one in split.data["annotations"] if one["category_id"] == category]
    shown = {one["image_id"] for one in mine}
    scenes = {image["scene"] for image in split.images if image["id"] in shown}
    objects = [item for item in split.data["rpl"]["objects"] if item["category_id"] == category]
    images = [image for image in split.images if image["scene"] in scenes]
    kept = {image["id"] for image in images}
    ignored = [one for one in split.data.get("crowds", ()) if one.get("category_id") == category]
    return {
        **split.data,
        "categories": [c | {"id": 1} for c in split.data["categories"] if c["id"] == category],
        "rpl": split.data["rpl"] | {"objects": [item | {"category_id": 1} for item in objects]},
        "images": images,
        "annotations": [one | {"category_id": 1} for one in mine],
        "crowds": [one | {"category_id": 1} for one in ignored if one["image_id"] in kept],
    }


def _write_object(folder: Path, coco: Path, split: str, data: Json) -> None:
    """Write one file, and link what it names."""
    files = [image[key] for image in data["images"] for key in ("file_name", "depth_file_name")]
    files += [item["mesh"] for item in data["rpl"]["objects"] if not (folder / str(item["mesh"])).exists()]
    for name in filter(None, files):
        link(coco / name, folder / name)
    write_coco(folder / f"{split}.json", data)

"""Ultralytics' YOLO datasets, for detection, segmentation and keypoints.

::

    <folder>/{detect,segment,pose}/data.yaml
                                   images/{train,val,test}/<scene>_<frame>.jpg
                                   labels/{train,val,test}/<scene>_<frame>.txt     one line per instance

The trainer finds the labels by the name of the images' folder, so each task has a folder of its own. The
lines are described in `formats.datasets.yolo`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.files import write_text
from rpl_data.formats.datasets.yolo import LINES, data_yaml
from rpl_data.json_arrays import Json


def export_yolo(folder: Path, coco: Path) -> DialectSummary:
    """Write `folder` from an exported COCO folder; images are linked.

    Raises:
        DataError: the COCO folder is missing or broken, or the folder cannot be written.
    """
    images: Counter[str] = Counter()
    instances = 0
    categories: Sequence[Json] = ()
    with replacing(folder) as building:
        for split in splits_of(coco):
            categories = split.data["categories"]
            for image in split.images:
                annotations = split.annotations.get(image["id"], [])
                _write_image(building, coco, split.name, image, annotations, categories)
                images[split.name] += 1
                instances += len(annotations)
        for task in LINES:
            write_text(building / task / "data.yaml", data_yaml(task, categories, list(images)))
    return DialectSummary(dict(images), instances)


def _write_image(
    building: Path,
    coco: Path,
    split: str,
    image: Json,
    annotations: Sequence[Json],
    categories: Sequence[Mapping[str, object]],
) -> None:
    source = coco / image["file_name"]
    name = f"{image['scene']}_{image['frame']:06d}"
    for task, line in LINES.items():
        link(source, building / task / "images" / split / f"{name}{source.suffix}")
        lines = [line(image, annotation, categories) for annotation in annotations]
        write_text(
            building / task / "labels" / split / f"{name}.txt", "".join(f"{text}\n" for text in lines if text)
        )

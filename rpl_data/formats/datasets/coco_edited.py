"""An export that was edited elsewhere, brought back to our dialect of COCO.

Annotation programs write ids as text, masks as polygons or as plain run lengths, and mark regions that hold
more objects than they care to separate (`iscrowd`). Nothing else that they change is guessed at.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np

from rpl_data.files import decoding
from rpl_data.json_arrays import Json, number, whole
from rpl_data.types import DataError
from rpl_data.untrusted.rle import pixels_of_rle

REMEDY = "undo what another program changed, or export the dataset again with `rpl export`"
LARGEST_SIDE_PX = 2**16
"""Of an image: a mask of one is unpacked to so many bytes."""
MASKS = (("segmentation", "bbox"), ("segmentation_full", "bbox_full"))


def as_exported(data: Any, *, source: str) -> Json:
    """Bring ids, masks and crowds of a file into the form that `rpl export` gives them.

    Crowds leave `annotations` for a list of their own, `crowds`, since they are no instances: they have
    neither pose nor keypoints. Where a mask was drawn anew, its area, boxes and visible share follow from it.

    Raises:
        DataError: a mask or an id is damaged. Everything else is left to `coco_check.validate_coco`.
    """
    if not isinstance(data, dict):
        raise DataError(f"{source}: expected a JSON object, found {type(data).__name__}; {REMEDY}")
    with decoding(source, REMEDY):
        if not all(isinstance(data.get(key), list) for key in ("images", "annotations", "categories")):
            return data
        number_ids(data["categories"], data.get("rpl", {}).get("objects", []), data["images"])
        sizes = {image["id"]: (_side(image["height"]), _side(image["width"])) for image in data["images"]}
        data["annotations"], crowds = annotations_as_exported(data["annotations"], sizes, source=source)
        if crowds:
            data["crowds"] = crowds
    return data


def annotations_as_exported(
    annotations: list[Json], sizes: Mapping[int, tuple[int, int]], *, source: str
) -> tuple[list[Json], list[Json]]:
    """Bring some annotations into the form that `rpl export` gives them, and take crowds out.

    Args:
        sizes: height and width of the images, by id.

    Returns:
        The annotations, and those that are crowds.
    """
    number_ids(annotations)
    for annotation in annotations:
        if "iscrowd" in annotation:
            annotation["iscrowd"] = _crowd(annotation["iscrowd"])
    for annotation in annotations:
        if _is_exported(annotation):
            continue
        with decoding(f"{source}: annotation {annotation['id']!r:.40}", REMEDY):
            _redraw(annotation, sizes.get(annotation["image_id"]), crowd=bool(annotation.get("iscrowd")))
    crowds = [each for each in annotations if each.get("iscrowd")]
    if crowds:
        annotations = [each for each in annotations if not each.get("iscrowd")]
    return annotations, crowds


def _is_exported(annotation: Json) -> bool:
    """Whether an annotation has packed masks and is no crowd, as nearly all are."""
    seen, full = annotation.get("segmentation"), annotation.get("segmentation_full")
    if not isinstance(seen, dict) or not isinstance(full, dict) or annotation.get("iscrowd"):
        return False
    return isinstance(seen.get("counts"), str) and isinstance(full.get("counts"), str)


def number_ids(*entries: list[Json]) -> None:
    """Turn ids that are texts or floats into whole numbers."""
    for entry in chain.from_iterable(entries):
        for key in ("id", "image_id", "category_id"):
            if key in entry and type(entry[key]) is not int:
                entry[key] = _whole_id(entry[key])


def _whole_id(value: Any) -> int:
    if isinstance(value, str) and value.isascii() and value.isdecimal() and len(value) < 19:
        return int(value)
    return whole(int(value) if isinstance(value, float) and value.is_integer() else value)


def _crowd(value: Any) -> int:
    """0 or 1 of what programs write for them; ValueError for anything else."""
    if value in (0, 1):  # also False, True, 0.0 and 1.0
        return int(value)
    text = str(value).strip().lower()
    if not isinstance(value, str) or text not in ("0", "1", "false", "true"):
        raise ValueError(f"iscrowd is {value!r:.40}; expected 0 or 1")
    return int(text in ("1", "true"))


def _side(value: Any) -> int:
    if not 1 <= whole(value) <= LARGEST_SIDE_PX:
        raise ValueError(f"an image of {value} px per side; expected 1 to {LARGEST_SIDE_PX}")
    return whole(value)


def _redraw(annotation: Json, size: tuple[int, int] | None, *, crowd: bool) -> None:
    """Pack the masks of an annotation, and make what follows from them agree."""
    if size is None:
        return  # no such image: the check says so
    redrawn = [key for key, _ in MASKS if key in annotation and _pack(annotation, key, size)]
    if redrawn and not crowd and "segmentation_full" in annotation:
        _show_whole(annotation)
    if redrawn or crowd:
        _measure(annotation)


def _pack(annotation: Json, key: str, size: tuple[int, int]) -> bool:
    """Pack a mask in place; whether it was in another form than ours."""
    given = annotation[key]
    if isinstance(given, dict) and not isinstance(given.get("counts"), list):
        return False
    if not isinstance(given, list | dict):
        return False
    annotation[key] = packed_mask(given, size, name=key)
    return True


def packed_mask(given: Any, size: tuple[int, int], *, name: str = "segmentation") -> Json:
    """Pack a mask of any form that COCO has: polygons, plain run lengths, or packed ones.

    Args:
        size: height and width of the image.

    Raises:
        ValueError: it is none of these, or damaged.
    """
    from pycocotools import mask as masks

    height, width = size
    if isinstance(given, list):
        polygons = [_polygon(polygon, height, width) for polygon in given]
        if not polygons:
            raise ValueError(f"{name}: it has no polygon")
        packed = masks.merge(masks.frPyObjects(polygons, height, width))
    elif isinstance(given, dict) and isinstance(given.get("counts"), list):
        runs = [whole(run) for run in given["counts"]]
        if sum(runs) != height * width or min(runs) < 0 or list(given["size"]) != [height, width]:
            raise ValueError(f"{name}: its runs are not those of {width} x {height} pixels")
        packed = masks.frPyObjects({"size": [height, width], "counts": runs}, height, width)
    elif isinstance(given, dict) and list(given["size"]) == [height, width]:
        check_packed(given)
        return {"size": [height, width], "counts": given["counts"]}
    else:
        raise ValueError(f"{name}: neither polygons nor run lengths of {width} x {height} pixels")
    return {"size": [height, width], "counts": packed["counts"].decode("ascii")}


def _polygon(values: Any, height: int, width: int) -> list[float]:
    """Corners of a polygon, x and y in turn, checked before pycocotools walks along its edges."""
    if not isinstance(values, list) or len(values) < 6 or len(values) % 2:
        raise ValueError("a polygon is not a list of at least three corners, x and y in turn")
    corners = np.array([number(value) for value in values])
    if corners.min() < -1 or corners[::2].max() > width + 1 or corners[1::2].max() > height + 1:
        raise ValueError(f"a polygon leaves its image of {width} x {height} px")
    return [float(value) for value in corners]


def _show_whole(annotation: Json) -> None:
    """Make the full mask hold the visible one, which was drawn without it, and count the visible share."""
    from pycocotools import mask as masks

    check_packed(annotation["segmentation"])
    check_packed(annotation["segmentation_full"])
    both = masks.merge([annotation["segmentation"], annotation["segmentation_full"]])
    annotation["segmentation_full"] = {"size": list(both["size"]), "counts": both["counts"].decode("ascii")}
    annotation["visib_fract"] = int(masks.area(annotation["segmentation"])) / max(int(masks.area(both)), 1)


def _measure(annotation: Json) -> None:
    """Boxes and area of the masks that are there."""
    from pycocotools import mask as masks

    for key, box in MASKS:
        if key in annotation:
            check_packed(annotation[key])
            annotation[box] = [float(side) for side in masks.toBbox(annotation[key])]
    annotation["area"] = int(masks.area(annotation["segmentation"]))


def check_packed(mask: Json) -> None:
    """Refuse a packed mask whose runs are not those of an image of its size: pycocotools trusts them.

    Raises:
        ValueError: with what is wrong.
    """
    height, width = (_side(side) for side in mask["size"])
    if not isinstance(mask["counts"], str) or pixels_of_rle(mask["counts"]) != height * width:
        raise ValueError(f"the runs of a mask are not those of {width} x {height} pixels")

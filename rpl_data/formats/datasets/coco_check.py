"""Checks of `coco.read_coco`: what our dialect of COCO guarantees, and the message when a file breaks it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from rpl_data.files import FAULTS, decoding
from rpl_data.formats.datasets.coco_batch import sound_annotations, sound_images
from rpl_data.formats.datasets.coco_edited import REMEDY, check_packed
from rpl_data.json_arrays import Json, each, flag, matrix_from_json, number, optional, positive, text, whole
from rpl_data.symmetries import symmetries_from_json
from rpl_data.types import DataError

TOP_KEYS = ("images", "annotations", "categories", "rpl")
CATEGORY_KEYS = ("id", "name", "supercategory", "keypoints", "skeleton")
OBJECT_KEYS = ("name", "category_id", "points_object", "mesh", "symmetries")
IMAGE_KEYS = (
    *("id", "file_name", "width", "height", "scene", "frame", "timestamp_s"),
    *("cam_K", "distortion", "scene_from_camera", "depth_file_name"),
)
ANNOTATION_KEYS = (
    *("id", "image_id", "category_id", "segmentation", "area", "bbox", "iscrowd", "keypoints"),
    *("num_keypoints", "camera_from_object", "visib_fract", "truncated", "segmentation_full", "bbox_full"),
    *("square_box", "sigma_px", "quality"),
)
Fields = Mapping[str, Callable[[Any], object]]
BOX_PX = 1e-2
"""By how much a box may differ from that of its mask: a rounding."""
SKEW = 2e-5
"""By how much a rotation may fail to be one."""
LONGEST_DISTORTION = 14
"""OpenCV has no more coefficients."""
CATEGORY_FIELDS: Fields = {"name": text, "keypoints": each(text), "skeleton": each(each(whole))}
OBJECT_FIELDS: Fields = {
    "name": text,
    "category_id": whole,
    "points_object": each(optional(each(number))),
    "mesh": optional(text),
    "symmetries": each(each(number)),
}
IMAGE_FIELDS: Fields = {
    "file_name": text,
    "width": whole,
    "height": whole,
    "scene": text,
    "frame": whole,
    "timestamp_s": number,
    "distortion": each(number),
    "depth_file_name": optional(text),
    "metres_per_unit": positive,
}
ANNOTATION_FIELDS: Fields = {
    "area": number,
    "num_keypoints": whole,
    "visib_fract": number,
    "truncated": flag,
    "sigma_px": each(optional(number)),
    "quality": number,
    "instance": text,
}
"""What the fields of an entry are, where no other check says it."""


BATCH = 2_000
FEWEST_IN_BATCH = 300
"""Entries that are first looked at together, which a small file is not worth."""


def validate_coco(data: Any, *, source: str) -> None:
    """Check everything that this module guarantees about a file.

    Raises:
        DataError: the first fault, with the entry's id, what was expected and what was found.
    """
    with decoding(source, REMEDY):
        _check_keys(data, TOP_KEYS, source)
        check = CocoCheck(data, source)
        check.images(data["images"])
        check.annotations(data["annotations"])


class CocoCheck:
    """The check of a file that may be read a part at a time: its head, then images, then annotations."""

    def __init__(self, head: Json, source: str) -> None:
        """Check everything but images and annotations; DataError as `validate_coco`."""
        self._source = source
        _check_keys(head["rpl"], ("version", "objects"), f"{source}: rpl")
        entries = _entries(head["categories"], CATEGORY_KEYS, f"{source}: category", set(), 0)
        self._categories = {c["id"]: c for c in entries}
        self._images: dict[int, Json] = {}
        self._image_ids: set[int] = set()
        self._annotation_ids: set[int] = set()
        _check_categories(self._categories, head["rpl"]["objects"], source)

    def images(self, entries: Any) -> None:
        """Check some images; of each, only the size is kept."""
        what, seen = f"{self._source}: image", self._image_ids
        for image in _entries(entries, IMAGE_KEYS, what, seen, len(seen)):
            self._images[image["id"]] = {"height": image["height"], "width": image["width"]}
        for part in _batches(entries):
            if len(part) >= FEWEST_IN_BATCH and sound_images(
                part, skew=SKEW, longest_distortion=LONGEST_DISTORTION
            ):
                continue
            for image in part:
                _check_image(image, f"{what} {image['id']}")

    def annotations(self, entries: Any) -> None:
        """Check some annotations of images that were checked before."""
        what, seen = f"{self._source}: annotation", self._annotation_ids
        _entries(entries, ANNOTATION_KEYS, what, seen, len(seen))
        images, categories = self._images, self._categories
        for part in _batches(entries):
            if len(part) >= FEWEST_IN_BATCH and sound_annotations(
                part, images, categories, skew=SKEW, box_px=BOX_PX
            ):
                continue
            for annotation in part:
                where = f"{what} {annotation['id']}"
                if annotation["image_id"] not in images or annotation["category_id"] not in categories:
                    raise _wrong(
                        where, "an image_id and category_id that exist in this file", _ids(annotation)
                    )
                of_image, of_category = images[annotation["image_id"]], categories[annotation["category_id"]]
                _check_instance(annotation, of_image, of_category, where)


def _batches(entries: list[Json]) -> Iterator[list[Json]]:
    return (entries[start : start + BATCH] for start in range(0, len(entries), BATCH))


def _check_image(image: Json, where: str) -> None:
    _check_fields({"metres_per_unit": 1.0} | image, IMAGE_FIELDS, where)
    if len(image["distortion"]) > LONGEST_DISTORTION:
        found = len(image["distortion"])
        raise _wrong(f"{where}: distortion", f"at most {LONGEST_DISTORTION} numbers", found)
    _check_numbers(image["cam_K"], 9, f"{where}: cam_K")
    _check_rigid(image["scene_from_camera"], f"{where}: scene_from_camera")


def _ids(annotation: Mapping[str, Any]) -> str:
    """The ids that an annotation refers to, for a message."""
    return f"image {annotation['image_id']}, category {annotation['category_id']}"


def _check_keys(entry: Any, keys: tuple[str, ...], where: str) -> None:
    """DataError unless `entry` is an object with at least these keys."""
    if not isinstance(entry, dict):
        raise _wrong(where, "a JSON object", type(entry).__name__)
    missing = [key for key in keys if key not in entry]
    if missing:
        raise DataError(f"{where}: {', '.join(missing)} missing; {REMEDY}")


def _check_fields(entry: Json, fields: Fields, where: str) -> None:
    """DataError unless each field converts."""
    for name, convert in fields.items():
        try:
            convert(entry[name])
        except FAULTS as error:
            raise DataError(f"{where}: {name}: {error}; {REMEDY}") from error


def _wrong(where: str, expected: str, found: Any) -> DataError:
    return DataError(f"{where}: expected {expected}, found {found!s:.200}; {REMEDY}")


def _entries(entries: Any, keys: tuple[str, ...], what: str, seen: set[int], first: int) -> list[Json]:
    """Check that each entry has its keys and an id of its own, and return them.

    Args:
        seen: ids of the entries before these, to which theirs are added.
        first: number of the first entry.
    """
    if not isinstance(entries, list):
        raise _wrong(what, "a list", type(entries).__name__)
    for row, entry in enumerate(entries, start=first):
        _check_keys(entry, keys, f"{what} number {row}")
        if type(entry["id"]) is not int or entry["id"] in seen:
            raise _wrong(f"{what} number {row}", "a unique whole number as id", entry["id"])
        seen.add(entry["id"])
    return entries


def _check_categories(categories: Mapping[int, Json], objects: Any, source: str) -> None:
    if sorted(categories) != list(range(1, len(categories) + 1)):
        raise _wrong(f"{source}: categories", "ids from 1 without gaps", sorted(categories))
    for category in categories.values():
        _check_fields(category, CATEGORY_FIELDS, f"{source}: category {category['id']}")
    if not isinstance(objects, list):
        raise _wrong(f"{source}: rpl.objects", "a list", type(objects).__name__)
    for item in objects:
        _check_keys(item, OBJECT_KEYS, f"{source}: rpl.objects")
        _check_fields(item, OBJECT_FIELDS, f"{source}: rpl.objects")
    if {o["category_id"]: o["name"] for o in objects} != {n: c["name"] for n, c in categories.items()}:
        raise _wrong(f"{source}: rpl.objects", "one per category", [o["name"] for o in objects])
    for item in objects:
        category = categories[item["category_id"]]
        where, count = f"{source}: object {item['name']}", len(category["keypoints"])
        if len(item["points_object"]) != count:
            raise _wrong(where, f"{count} points_object, one per keypoint", len(item["points_object"]))
        for point in item["points_object"]:
            if point is not None:
                _check_numbers(point, 3, f"{where}: points_object")
        for pair in category["skeleton"]:
            if len(pair) != 2 or not all(1 <= end <= count for end in pair):
                raise _wrong(where, f"skeleton ends from 1 to {count}", category["skeleton"])
        try:
            symmetries_from_json(item)
        except FAULTS as error:
            raise DataError(f"{where}: symmetries_continuous: {error}; {REMEDY}") from error
        others = filter(None, (item.get("object_from_grasp"), item.get("frame_from_object")))
        for transform in (*item["symmetries"], *others):
            _check_rigid(transform, f"{where}: symmetries, object_from_grasp, frame_from_object")


def _check_instance(annotation: Json, image: Json, category: Json, where: str) -> None:
    count = len(category["keypoints"])
    _check_fields({"instance": ""} | annotation, ANNOTATION_FIELDS, where)
    _check_rigid(annotation["camera_from_object"], f"{where}: camera_from_object")
    _check_numbers(annotation["keypoints"], 3 * count, f"{where}: keypoints")
    keypoints = np.array(annotation["keypoints"], dtype=float).reshape(-1, 3)
    seen = keypoints[:, 2]
    if any(v not in (0, 1, 2) for v in seen.tolist()) or keypoints[seen == 0, :2].any():
        raise _wrong(
            where, "keypoints with v of 0, 1 or 2 and x = y = 0 where v = 0", annotation["keypoints"]
        )
    if annotation["num_keypoints"] != (keypoints[:, 2] > 0).sum():
        raise _wrong(f"{where}: num_keypoints", "the count of v > 0", annotation["num_keypoints"])
    if len(annotation["sigma_px"]) != count:
        raise _wrong(f"{where}: sigma_px", f"{count} values", len(annotation["sigma_px"]))
    _check_numbers(annotation["square_box"], 3, f"{where}: square_box")
    if not annotation["square_box"][2] > 0:
        raise _wrong(f"{where}: square_box", "a side above 0", annotation["square_box"])
    for key in ("visib_fract", "quality"):
        if not 0 <= annotation[key] <= 1:
            raise _wrong(f"{where}: {key}", "0 to 1", annotation[key])
    _check_mask(annotation, "segmentation", "bbox", image, where)
    _check_mask(annotation, "segmentation_full", "bbox_full", image, where)


def _check_mask(annotation: Json, mask_key: str, box_key: str, image: Json, where: str) -> None:
    from pycocotools import mask as masks

    mask = annotation[mask_key]
    _check_keys(mask, ("size", "counts"), f"{where}: {mask_key}")
    if list(mask["size"]) != [image["height"], image["width"]]:
        raise _wrong(f"{where}: {mask_key}", f"size [{image['height']}, {image['width']}]", mask["size"])
    with decoding(f"{where}: {mask_key}", REMEDY):
        check_packed(mask)
    _check_numbers(annotation[box_key], 4, f"{where}: {box_key}")
    box = masks.toBbox(mask)
    if np.abs(box - annotation[box_key]).max() > BOX_PX:
        raise _wrong(f"{where}: {box_key}", f"the box of the mask {box}", annotation[box_key])
    if mask_key == "segmentation" and int(masks.area(mask)) != annotation["area"]:
        raise _wrong(f"{where}: area", f"the mask's {int(masks.area(mask))} px", annotation["area"])
    if mask_key == "segmentation" and annotation["area"] == 0:
        raise _wrong(f"{where}: segmentation", "at least one visible pixel", "none")


def _check_numbers(values: Any, count: int, where: str) -> None:
    if not isinstance(values, list) or len(values) != count:
        raise _wrong(where, f"a list of {count} numbers", values)
    try:
        each(number)(values)
    except FAULTS as error:
        raise _wrong(where, "finite numbers", values) from error


def _check_rigid(values: Any, where: str) -> None:
    _check_numbers(values, 16, where)
    matrix = matrix_from_json(values)
    rotation = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers near the largest there are
        skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
    proper = skew <= SKEW and np.linalg.det(rotation) > 0
    if not proper or np.abs(matrix[3] - (0, 0, 0, 1)).max() > SKEW:
        raise _wrong(where, "a rigid transform, row-major", values)

"""Compare an exported COCO file that was edited with another program with the labels it was made from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from rpl_data.export.edited_keypoints import Orders, moved_keypoints
from rpl_data.export.split import FrameKey
from rpl_data.files import decoding
from rpl_data.formats.datasets.coco_edited import as_exported, check_packed
from rpl_data.json_arrays import Json, number
from rpl_data.types import Correction, DataError, Rle

BOX_PX = 1.0
"""By how much a box must leave its mask to be reported as moved: programs round boxes to pixels."""
POSE_TOLERANCE = 1e-4
"""Metres, and entries of a rotation: programs may write fewer digits than we do."""
REMEDY = "edit the present export/coco of this workspace, then import that"


@dataclass(frozen=True)
class OurImage:
    """An exported image with its labels as they are without corrections.

    Attributes:
        size: height and width.
        annotations: entries of the COCO file by object and instance.
    """

    file_name: str
    size: tuple[int, int]
    annotations: Mapping[tuple[str, str], Json]


@dataclass
class Difference:
    """What was changed, and counts of it.

    Attributes:
        corrections: one per changed instance.
        covered: scene, frame, object and instance of all labels that the file speaks about.
        ious: of each changed mask with ours.
        moved_px: how far each keypoint moved that has a position before and after.
        refused: number of new instances, by the reason why they are not taken.
        redrawn: number of masks that differ from ours by at most a pixel along the outline, as when a program
            turns them into polygons; ours are kept.
        boxes: number of boxes that were changed without their mask.
    """

    corrections: list[Correction] = field(default_factory=list)
    covered: set[tuple[str, int, str, str]] = field(default_factory=set)
    ious: list[float] = field(default_factory=list)
    moved_px: list[float] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    redrawn: int = 0
    boxes: int = 0


def compare(
    data: Any, ours: Mapping[FrameKey, OurImage], keypoints: Mapping[str, Sequence[str]], *, source: str
) -> Difference:
    """Find what an edited file changes.

    An object whose category the file lacks is not in it, so nothing is said about its labels.

    Args:
        data: content of the file.
        ours: the exported images.
        keypoints: names of the keypoints of each object.
        source: the file, for messages.

    Raises:
        DataError: the file is damaged, or is not of these images, objects and poses.
    """
    data = as_exported(data, source=source)
    with decoding(source, REMEDY):
        keys = _images(data["images"], ours, source)
        annotations = [*data["annotations"], *data.get("crowds", [])]
        used = {annotation["category_id"] for annotation in annotations}
        names = _categories(data["categories"], used, keypoints, source)
        given: dict[tuple[FrameKey, str], list[Json]] = {}
        for annotation in annotations:
            if annotation["image_id"] not in keys or annotation["category_id"] not in names:
                raise ValueError(f"annotation {annotation['id']!r:.40} names an image or category it lacks")
            key = keys[annotation["image_id"]], names[annotation["category_id"]][0]
            given.setdefault(key, []).append(annotation)
        orders = {name: (order, keypoints[name]) for name, order in names.values()}
        return _differences(given, {key: ours[key] for key in keys.values()}, orders, source)


def _images(images: Sequence[Json], ours: Mapping[FrameKey, OurImage], source: str) -> dict[int, FrameKey]:
    """The frame of each image id, by scene and frame where the file has them, else by file name."""
    names = {image.file_name: key for key, image in ours.items()}
    own = {key: key for key in ours}  # a program may write frame 4 as 4.0
    keys = {image["id"]: _frame(image, own, names) for image in images}
    unknown = [str(image.get("file_name")) for image in images if keys[image["id"]] is None]
    if unknown:
        raise DataError(
            f"{source}: {len(unknown)} of its {len(images)} images are not in export/coco of this workspace "
            f"({', '.join(unknown[:3])}{', ...' if len(unknown) > 3 else ''}); {REMEDY}"
        )
    found = {image_id: key for image_id, key in keys.items() if key is not None}
    if len(set(found.values())) < len(images):
        raise ValueError("it holds an image twice")
    for image in images:
        height, width = ours[found[image["id"]]].size
        if (image["height"], image["width"]) != (height, width):
            raise ValueError(
                f"image {image.get('file_name')} has {image['width']} x {image['height']} pixels; "
                f"ours has {width} x {height}"
            )
    return found


def _frame(image: Json, own: Mapping[FrameKey, FrameKey], names: Mapping[str, FrameKey]) -> FrameKey | None:
    if "scene" in image and "frame" in image:
        return own.get((image["scene"], image["frame"]))
    name = str(image["file_name"]).replace("\\", "/")
    ends = [
        key for full, key in names.items() if f"/{name}".endswith(f"/{full}") or full.endswith(f"/{name}")
    ]
    return ends[0] if len(ends) == 1 else None


def _categories(
    categories: Sequence[Json], used: set[int], keypoints: Mapping[str, Sequence[str]], source: str
) -> dict[int, tuple[str, Sequence[str]]]:
    """Object and keypoint names, in the file's order, by category id; unused others are passed over."""
    found = {}
    for category in categories:
        name = category["name"]
        if name not in keypoints:
            if category["id"] in used:
                raise DataError(
                    f"{source}: category {name!r:.60} is no object of this workspace, which has "
                    f"{', '.join(keypoints)}; {REMEDY}"
                )
            continue
        order = category.get("keypoints") or keypoints[name]
        if sorted(order) != sorted(keypoints[name]):
            raise DataError(f"{source}: the keypoints of {name} are not those of this workspace; {REMEDY}")
        found[category["id"]] = (name, order)
    return found


def _differences(
    given: Mapping[tuple[FrameKey, str], list[Json]],
    ours: Mapping[FrameKey, OurImage],
    orders: Mapping[str, Orders],
    source: str,
) -> Difference:
    found = Difference()
    for key, image in ours.items():
        for name, order in orders.items():
            edited = given.get((key, name), [])
            ours_here = {instance: own for (of, instance), own in image.annotations.items() if of == name}
            found.covered |= {(*key, name, instance) for instance in ours_here or [""]}
            if not ours_here:
                found.refused["the workspace has no label there, so it would have no pose"] += len(edited)
                continue
            with decoding(f"{source}: {name} in {image.file_name}", REMEDY):
                same = _paired(edited, ours_here)
                found.refused["an image has one instance per label of ours"] += len(edited) - len(same)
                for instance, own in ours_here.items():
                    as_ours = Correction(*key, name, instance=instance)
                    change = replace(as_ours, deleted=True)
                    if instance in same:
                        change = _change(as_ours, same[instance], own, order, image.size, found)
                    if change != as_ours:
                        found.corrections.append(change)
    return found


def _paired(edited: Sequence[Json], ours: Mapping[str, Json]) -> dict[str, Json]:
    """Which annotation of a file is which instance of ours; instances that the file lacks are absent.

    Programs may number annotations anew and drop what they do not know. So where an image has one instance,
    its id tells; where it has several, their names do; else the masks that overlap most.
    """
    if len(ours) == 1:
        told = {instance: [e for e in edited if e["id"] == own["id"]] for instance, own in ours.items()}
    else:
        told = {name: [e for e in edited if "instance" in e and e["instance"] == name] for name in ours}
    same = {instance: found[0] for instance, found in told.items() if found}
    left = [each for each in edited if not any(each is one for one in same.values())]
    while left and len(same) < len(ours):
        pairs = [(each, name) for each in left for name in ours.keys() - same.keys()]
        each, name = max(pairs, key=lambda pair: _overlap(pair[0], ours[pair[1]]))
        same[name] = each
        left = [other for other in left if other is not each]
    return same


def _change(
    change: Correction, edited: Json, own: Json, order: Orders, size: tuple[int, int], found: Difference
) -> Correction:
    """What differs between an edited annotation and ours."""
    if _furthest(edited, own, "camera_from_object") > POSE_TOLERANCE:
        raise ValueError("its pose is another than ours: it was exported from other labels")
    return replace(
        change,
        crowd=bool(edited.get("iscrowd")),
        mask=_changed_mask(edited, own, found),
        keypoints=moved_keypoints(edited, own, order, size, found.moved_px),
    )


def _overlap(edited: Json, own: Json) -> float:
    """Intersection over union of two masks; ValueError where the edited one is damaged or empty."""
    from pycocotools import mask as masks

    mask, before = (own | edited)["segmentation"], own["segmentation"]
    if not isinstance(mask, dict):
        raise ValueError("its segmentation is neither polygons nor run lengths")
    check_packed(mask)
    if list(mask["size"]) != list(before["size"]):
        raise ValueError(f"its mask has the size {mask['size']}; expected {before['size']}")
    if not int(masks.area(mask)):
        raise ValueError("its mask has no pixel; delete the instance instead")
    return float(masks.iou([mask], [before], [0])[0, 0])


def _furthest(edited: Json, own: Json, key: str) -> float:
    """By how much the numbers of a field differ at most; 0 where the edited file lacks it."""
    values = np.array([number(value) for value in (own | edited)[key]])
    return float(np.abs(values - own[key]).max())


def _changed_mask(edited: Json, own: Json, found: Difference) -> Rle | None:
    overlap = _overlap(edited, own)
    if overlap == 1:
        found.boxes += _furthest(edited, own, "bbox") > BOX_PX
        return None
    mask = edited["segmentation"]
    if _is_redrawn(mask, own["segmentation"]):
        found.redrawn += 1
        return None
    found.ious.append(overlap)
    return {"size": list(mask["size"]), "counts": mask["counts"]}


def _is_redrawn(mask: Rle, before: Rle) -> bool:
    """Whether a mask leaves only pixels on the edge of ours, and adds only pixels beside it."""
    from pycocotools import mask as masks

    now, ours = masks.decode(mask), masks.decode(before)
    square = np.ones((3, 3), np.uint8)
    inner, outer = cv2.erode(ours, square), cv2.dilate(ours, square)
    return not (inner > now).any() and not (now > outer).any()

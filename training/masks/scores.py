"""How good predicted masks are: COCO's average precision, and the mean IoU per class that the paper plots."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pycocotools import mask as masks

from rpl_data.formats.datasets.coco import read_coco
from rpl_data.json_arrays import Json


@dataclass(frozen=True)
class ClassScore:
    """The scores of one class on one split; None where the truth does not have the class.

    Attributes:
        name: of the class.
        images: how many images show the class.
        mean_iou: mean, over these images, of the IoU of all its predicted with all its true pixels; an image
            where it is missed counts as 0.
        missed: how many of these images have no detection that touches it.
        false_alarms: how many other images have a detection of it.
        box_ap, mask_ap, mask_ap50: COCO's average precision, 0 to 1.
    """

    name: str
    images: int
    mean_iou: float | None
    missed: int
    false_alarms: int
    box_ap: float | None
    mask_ap: float | None
    mask_ap50: float | None


@dataclass(frozen=True)
class SplitScore:
    """The scores of all classes on one split; means are taken over the classes that the truth has."""

    images: int
    mean_iou: float | None
    box_ap: float | None
    box_ap50: float | None
    mask_ap: float | None
    mask_ap50: float | None
    classes: tuple[ClassScore, ...]


def score_split(
    coco_json: Path, results: Sequence[Json], *, threshold: float, left_out: Collection[int] = ()
) -> SplitScore:
    """Score predictions against the labels of a COCO file.

    Args:
        results: COCO results with masks.
        threshold: the least score of what counts for IoU, missed and false alarms; AP uses all of them.
        left_out: ids of images that are not judged.
    """
    truth = _without(read_coco(coco_json), left_out)
    names = {int(category["id"]): str(category["name"]) for category in truth["categories"]}
    boxes, shapes = (average_precision(truth, results, kind) for kind in ("bbox", "segm"))
    overlaps = class_overlaps(truth, [entry for entry in results if entry["score"] >= threshold])
    classes = []
    for number, name in sorted(names.items()):
        ious, alarms = overlaps[number]
        classes.append(
            ClassScore(
                name=name,
                images=len(ious),
                mean_iou=_mean(ious),
                missed=sum(iou == 0 for iou in ious),
                false_alarms=alarms,
                box_ap=boxes.each.get(number),
                mask_ap=shapes.each.get(number),
                mask_ap50=shapes.each50.get(number),
            )
        )
    mean_iou = _mean([c.mean_iou for c in classes if c.mean_iou is not None])
    aps = boxes.all, boxes.all50, shapes.all, shapes.all50
    return SplitScore(len(truth["images"]), mean_iou, *aps, tuple(classes))


def _without(truth: Json, image_ids: Collection[int]) -> Json:
    """A COCO file without some of its images."""
    kept = {"images": [image for image in truth["images"] if image["id"] not in image_ids]}
    for key in ("annotations", "crowds"):
        kept[key] = [each for each in truth.get(key, ()) if each["image_id"] not in image_ids]
    return {**truth, **kept}


def class_overlaps(truth: Json, results: Sequence[Json]) -> dict[int, tuple[list[float], int]]:
    """For each category, the IoU in every image that shows it, and in how many other images it was found.

    All instances of a category in an image count as one set of pixels, as in the paper's figure. What is
    found in a region that is marked as ignored (a crowd) counts neither for nor against.
    """
    true, found = (_united(entries) for entries in (truth["annotations"], results))
    for key, crowd in _united(truth.get("crowds", ())).items():
        if key in found and (left := _without_crowd(found.pop(key), crowd, true.get(key))) is not None:
            found[key] = left
    overlaps: dict[int, tuple[list[float], int]] = {}
    for category in truth["categories"]:
        number = category["id"]
        shown = [key for key in true if key[1] == number]
        ious = [_iou(true[key], found[key]) if key in found else 0.0 for key in shown]
        alarms = sum(key[1] == number and key not in true for key in found)
        overlaps[number] = ious, alarms
    return overlaps


def _united(entries: Sequence[Json]) -> dict[tuple[int, int], Json]:
    """Unite the masks of each image and category."""
    groups: dict[tuple[int, int], list[Json]] = defaultdict(list)
    for entry in entries:
        groups[entry["image_id"], entry["category_id"]].append(entry["segmentation"])
    return {key: masks.merge(group) for key, group in groups.items()}


def _without_crowd(found: Json, crowd: Json, true: Json | None) -> Json | None:
    """The found pixels that no crowd explains; None without any."""
    ignored = masks.decode(crowd) > 0
    if true is not None:
        ignored &= masks.decode(true) == 0
    left = (masks.decode(found) > 0) & ~ignored
    return masks.encode(np.asfortranarray(left.astype(np.uint8))) if left.any() else None


def _iou(one: Json, other: Json) -> float:
    return float(masks.iou([one], [other], [0])[0, 0])


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


@dataclass(frozen=True)
class Precision:
    """Average precision over IoU 0.5 to 0.95 and at IoU 0.5; none for categories that the truth lacks."""

    all: float | None
    all50: float | None
    each: dict[int, float]
    each50: dict[int, float]


def average_precision(truth: Json, results: Sequence[Json], kind: str) -> Precision:
    """COCO's average precision of boxes (`bbox`) or masks (`segm`).

    COCO looks at the best 100 of an image; where the truth has more instances, so many are looked at.
    """
    from faster_coco_eval import COCO, COCOeval_faster

    if not truth["annotations"]:
        return Precision(None, None, {}, {})
    present = {annotation["category_id"] for annotation in truth["annotations"]}
    if not results:
        nothing = dict.fromkeys(present, 0.0)
        return Precision(0.0, 0.0, nothing, nothing)
    most = max(np.unique([a["image_id"] for a in truth["annotations"]], return_counts=True)[1])
    # What is found within a crowd counts neither for nor against.
    judge = COCO({**truth, "annotations": [*truth["annotations"], *truth.get("crowds", ())]})
    # loadRes writes into what it is given.
    evaluation = COCOeval_faster(judge, judge.loadRes([dict(entry) for entry in results]), kind)
    evaluation.params.maxDets = [1, 10, max(100, int(most))]
    evaluation.evaluate()
    evaluation.accumulate()
    precision = evaluation.eval["precision"][:, :, :, 0, -1]  # IoU x recall x category
    ids = [number for number in evaluation.params.catIds if number in present]
    rows = [list(evaluation.params.catIds).index(number) for number in ids]
    each = {number: float(precision[:, :, row].mean()) for number, row in zip(ids, rows, strict=True)}
    each50 = {number: float(precision[0, :, row].mean()) for number, row in zip(ids, rows, strict=True)}
    return Precision(float(np.mean([*each.values()])), float(np.mean([*each50.values()])), each, each50)

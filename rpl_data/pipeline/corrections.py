"""Bring labels that were corrected with another program back into a workspace."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rpl_data.export.dialect import splits_of
from rpl_data.export.edited import POSE_TOLERANCE, Difference, OurImage, compare
from rpl_data.export.split import FrameKey
from rpl_data.files import read_json
from rpl_data.formats.datasets.coco import instance_to_coco
from rpl_data.json_arrays import Json
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.frames import frames_for, moved_label
from rpl_data.types import DataError, FrameLabel
from rpl_data.wording import counted

InstanceKey = tuple[str, str]
"""Name of an object, and of the instance."""


def import_corrections(context: Context, file: Path) -> list[str]:
    """Keep what an edited COCO file changes; corrections of the same labels from earlier files are replaced.

    Returns:
        Lines that say what was changed.

    Raises:
        DataError: the file is damaged or is no edited export of this workspace; nothing is changed then.
    """
    workspace = context.workspace
    data = read_json(file)
    keypoints = {name: workspace.load_placed(name).model.keypoints for name in context.object_names}
    found = compare(data, _our_images(context), keypoints, source=str(file))
    before = workspace.load_corrections()
    kept = [one for one in before if (one.scene, one.frame, one.object, one.instance) not in found.covered]
    workspace.save_corrections([*kept, *found.corrections])
    replaced = len(before) - len(kept)
    return [
        *_described(found),
        *([f"they replace {counted(replaced, 'earlier correction')} of the same labels"] if replaced else []),
    ]


def forget_corrections(context: Context) -> int:
    """Drop all corrections; returns how many there were."""
    count = len(context.workspace.load_corrections())
    context.workspace.save_corrections([])
    return count


def _our_images(context: Context) -> dict[FrameKey, OurImage]:
    """The exported images with their labels as computed, so that earlier corrections count as changes."""
    workspace = context.workspace
    exported = dict(_exported(workspace.export("coco")))
    frames = frames_for(context, workspace)
    labels = {
        (label.scene, label.frame): moved_label(label, frames)
        for scene in dict.fromkeys(scene for scene, _ in exported)
        for label in workspace.load_labels(scene)
    }
    images = {}
    for key, (image, shown) in exported.items():
        own = {} if key not in labels else _entries(labels[key], shown)
        if any(_differ(annotation, own.get(name)) for name, annotation in shown.items()):
            raise DataError(
                f"the labels of {workspace.root} have changed since {workspace.export('coco')} was written; "
                "run `rpl export`, edit that export, and import it"
            )
        images[key] = OurImage(image["file_name"], (image["height"], image["width"]), own)
    return images


def _exported(coco: Path) -> Iterator[tuple[FrameKey, tuple[Json, dict[InstanceKey, Json]]]]:
    """Each exported image with its annotations."""
    for split in splits_of(coco):
        names = {category["id"]: category["name"] for category in split.data["categories"]}
        annotations: dict[int, dict[InstanceKey, Json]] = {image["id"]: {} for image in split.images}
        for annotation in (*split.data["annotations"], *split.data.get("crowds", ())):
            key = names[annotation["category_id"]], annotation.get("instance", "")
            annotations[annotation["image_id"]][key] = annotation
        for image in split.images:
            yield (image["scene"], image["frame"]), (image, annotations[image["id"]])


def _entries(label: FrameLabel, exported: dict[InstanceKey, Json]) -> dict[InstanceKey, Json]:
    """Entries of a frame's labels without corrections, with the ids of the export; 0 for those it lacks."""
    found = {}
    for instance in label.instances:
        key = instance.object, instance.instance
        same = exported.get(key, {"id": 0, "image_id": 0, "category_id": 0})
        entry = instance_to_coco(same["id"], same["image_id"], same["category_id"], instance)
        if entry is not None:
            found[key] = entry
    return found


def _differ(exported: Json, own: Json | None) -> bool:
    """Whether an exported annotation has another pose than the label now has."""
    poses = [] if own is None else [exported["camera_from_object"], own["camera_from_object"]]
    return not poses or bool(np.abs(np.subtract(*poses)).max() > POSE_TOLERANCE)


def _described(found: Difference) -> list[str]:
    """The difference in words and counts."""
    kinds: Counter[str] = Counter()
    for one in found.corrections:
        kinds.update(deleted=int(one.deleted), crowd=int(one.crowd), keypoints=int(bool(one.keypoints)))
    lines = []
    if found.ious:
        iou = f"median {np.median(found.ious):.3f}, lowest {min(found.ious):.3f}"
        lines.append(f"{counted(len(found.ious), 'mask')} changed: IoU with ours {iou}")
    if kinds["keypoints"]:
        total = sum(len(one.keypoints) for one in found.corrections)
        moved = f": moved by {np.median(found.moved_px):.1f} px (median), {max(found.moved_px):.1f} px (most)"
        lines.append(
            f"{counted(total, 'keypoint')} of {counted(kinds['keypoints'], 'instance')} changed"
            + (moved if found.moved_px else ": their visibility")
            + "; the poses stay as they are and may disagree with them"
        )
    if kinds["deleted"]:
        lines.append(f"{counted(kinds['deleted'], 'instance')} deleted")
    if kinds["crowd"]:
        lines.append(f"{counted(kinds['crowd'], 'instance')} marked as ignored (`iscrowd`)")
    if found.redrawn:
        lines.append(
            f"{counted(found.redrawn, 'mask')} kept as ours: the file's differ by at most 1 px along the "
            "outline, as when a program turns masks into polygons"
        )
    if found.boxes:
        lines.append(
            f"boxes of {counted(found.boxes, 'instance')} moved without the mask: not taken, since a box is "
            "that of its mask; change the mask"
        )
    for why, count in found.refused.items():
        if count:
            lines.append(f"{counted(count, 'new instance')} refused: {why}")
    return lines or ["nothing is changed"]

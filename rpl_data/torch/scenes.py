"""Scenes of a training split that are held out of it, so that a network can be chosen by unseen scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.torch.splits import split_file
from rpl_data.types import DataError
from rpl_data.wording import counted

LOOKED_AT = {"images": ("id", "scene", "origin"), "annotations": ("image_id", "category_id"), "crowds": ()}
"""Keys of a COCO file's entries that say which object is seen in which scene."""


class SceneSplit(NamedTuple):
    """The scenes of a training split.

    Attributes:
        trained: those that are trained on; None where that is all.
        unseen: those that are held out, to validate on.
    """

    trained: tuple[str, ...] | None
    unseen: tuple[str, ...]


def hold_out_scenes(
    export: str | Path,
    count: int,
    *,
    object: str | None = None,  # noqa: A002 (the recipe's and the CLI's word for it)
) -> SceneSplit:
    """Choose scenes of the training split to validate on; the last ones by name, the same every time.

    Every object keeps a scene to train on. The test split is not looked at.

    Args:
        export: the folder of an export.
        count: how many scenes.
        object: only scenes that show it count; any object's when left out.

    Raises:
        DataError: there are too few scenes, or images were rendered from all of them.
    """
    if count == 0:
        return SceneSplit(None, ())
    if count < 0:
        raise DataError(f"validate_scenes is {count}; give 0 or more")
    data = read_packed(split_file(export, "train"), LOOKED_AT)
    if any(image.get("origin") == "synthetic" for image in data["images"]):
        raise DataError(
            f"validate_scenes is {count}, but {export} holds images that were rendered from all its scenes, "
            "so none would be unseen; leave validate_scenes out, or train on the recorded images alone"
        )
    shown = _objects_by_scene(data, object)
    left = Counter(name for names in shown.values() for name in names)
    held: list[str] = []
    for scene in sorted(shown, reverse=True):
        if len(held) < count and all(left[name] > 1 for name in shown[scene]):
            left.subtract(shown[scene])
            held.append(scene)
    if len(held) < count:
        raise DataError(
            f"validate_scenes is {count}, and of the {counted(len(shown), 'training scene')} in {export} "
            f"only {len(held)} can be held out: every object needs another one to train on; ask for fewer, "
            "or record more scenes"
        )
    return SceneSplit(tuple(sorted(set(shown) - set(held))), tuple(sorted(held)))


def only_scenes(data: dict[str, Any], scenes: Collection[str] | None) -> dict[str, Any]:
    """A COCO file's content with the images of some scenes alone, and their annotations; None keeps all."""
    if scenes is None:
        return data
    images = [image for image in data["images"] if image["scene"] in scenes]
    ids = {image["id"] for image in images}
    lists: dict[str, list[Any]] = {n: data[n] for n in ("annotations", "crowds") if n in data}
    kept = {name: [each for each in entries if each["image_id"] in ids] for name, entries in lists.items()}
    return {**data, "images": images, **kept}


def _objects_by_scene(data: dict[str, Any], name: str | None) -> dict[str, set[int]]:
    """The categories that each scene shows; only those of an object when it is named."""
    scenes = {image["id"]: image["scene"] for image in data["images"]}
    numbers = {category["id"] for category in data["categories"] if name in (None, category["name"])}
    shown: dict[str, set[int]] = {}
    for annotation in data["annotations"]:
        if annotation["category_id"] in numbers:
            shown.setdefault(scenes[annotation["image_id"]], set()).add(annotation["category_id"])
    return shown

"""What training may know: the images and labels of an export's training split, and their scenes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rpl_data.files import file_hash
from rpl_data.formats.datasets.coco import CocoObject, objects_from_coco
from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.json_arrays import Json
from rpl_data.synthesize.storage import studio_made_of
from rpl_data.torch.splits import scenes_of
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


@dataclass(frozen=True)
class Training:
    """The training split of an export.

    Attributes:
        folder: the export.
        objects: all of the export's, in the order of their categories.
        scenes: the recordings that its images are of.
        data: the file; its annotations are parsed when they are looked at.
        digest: stands for its content.
    """

    folder: Path
    objects: tuple[CocoObject, ...]
    scenes: tuple[str, ...]
    data: Json
    digest: str

    def names(self) -> tuple[str, ...]:
        """Objects that the images show."""
        return tuple(item.model.name for item in self.objects if self.labels(item.model.name))

    def labels(self, name: str) -> list[tuple[Json, Json]]:
        """Image and annotation of every instance of an object."""
        number = [item.model.name for item in self.objects].index(name) + 1
        images = {image["id"]: image for image in self.data["images"]}
        return [
            (images[one["image_id"]], one)
            for one in self.data["annotations"]
            if one["category_id"] == number and not one["iscrowd"]
        ]


def training_split(workspace: Workspace) -> Training:
    """Read the training split of a workspace's export.

    Raises:
        DataError: there is no export, its training split shows no object, or a scene is in its training split
            and in its test split.
    """
    folder = workspace.export("coco")
    file = folder / "train.json"
    if not file.exists():
        raise DataError(
            f"{workspace.root} has no labels to make views of: there is no {file}; run "
            f"`rpl export --workspace {workspace.root}` first"
        )
    data = read_packed(file)
    data["images"] = list(data["images"])  # gone through more than once
    if not data["annotations"]:
        raise DataError(f"{file} has no labels to make views of; label some frames, and export again")
    scenes = {image["scene"] for image in data["images"]}
    shared = scenes & scenes_of(folder, ["test"])
    if shared:
        raise DataError(
            f"scene {', '.join(sorted(shared))} is in train.json and in test.json of {folder}, so nothing "
            "can be made of training scenes alone; split by scenes (`split: {test_scenes: ...}`) and export "
            "again"
        )
    digest = _digest(file)
    return Training(folder, tuple(objects_from_coco(data)), tuple(sorted(scenes)), data, digest)


def outdated_line(workspace: Workspace) -> str | None:
    """A line for the user where `export/synthetic` was rendered from labels other than those of now."""
    file, rendered = workspace.export("coco") / "train.json", workspace.export("synthetic")
    made_of = studio_made_of(rendered / "studio")
    if made_of is None or not file.exists() or made_of.get("labels") == _digest(file):
        return None
    return (
        f"{rendered} was rendered from earlier labels; the same `rpl synthesize` as then makes it anew, or "
        "delete it"
    )


def _digest(file: Path) -> str:
    return file_hash(file)[:16]

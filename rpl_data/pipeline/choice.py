"""Which labels an export writes when it is asked for fewer than the recipe's own exports hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

from rpl_data.export.color_images import ColorFormat
from rpl_data.export.split import FrameKey, SplitName, assigned_splits
from rpl_data.pipeline.recipe import ExportRecipe
from rpl_data.types import DataError, FrameLabel
from rpl_data.workspace.workspace import Workspace

SPLITS: tuple[SplitName, ...] = ("train", "val", "test")


@dataclass(frozen=True)
class ExportChoice:
    """What one export is limited to; None = as in the recipe.

    Attributes:
        object: the only object that is labelled; scenes without it are left out.
        min_quality: least quality of a label, see `ExportRecipe`.
        split: the only split.
        color: format of the colour images, see `ExportRecipe`.
    """

    object: str | None = None
    min_quality: float | None = None
    split: SplitName | None = None
    color: ColorFormat | None = None

    @property
    def folder(self) -> str:
        """Name of the folder that holds such exports; empty for the recipe's own.

        The choice has a folder of its own, so that a build never takes it for the export that the recipe asks
        for.
        """
        said = [
            f"{item.name}-{value}" for item in fields(self) if (value := getattr(self, item.name)) is not None
        ]
        return "_".join(["only", *said]) if said else ""

    def recipe(self, given: ExportRecipe) -> ExportRecipe:
        """The recipe's export with the options of this choice.

        Raises:
            DataError: a least quality outside 0 to 1.
        """
        if self.min_quality is not None and not 0 <= self.min_quality < 1:
            raise DataError(f"the least quality must be in [0, 1), got {self.min_quality:g}")
        quality = given.min_quality if self.min_quality is None else self.min_quality
        return replace(given, min_quality=quality, color=self.color or given.color)

    def objects(self, known: Sequence[str]) -> list[str]:
        """The objects to export.

        Raises:
            DataError: the chosen object is not one of them.
        """
        if self.object is None:
            return list(known)
        if self.object not in known:
            raise DataError(
                f"there is no object {self.object!r} to export; the recipe has {', '.join(known)}"
            )
        return [self.object]

    def chosen(
        self, labels: Iterable[FrameLabel], split_of: Callable[[FrameKey], SplitName]
    ) -> Iterator[FrameLabel]:
        """The frames of the chosen split, with the labels of the chosen object."""
        for label in labels:
            if self.split not in (None, split_of((label.scene, label.frame))):
                continue
            kept = tuple(item for item in label.instances if self.object in (None, item.object))
            yield replace(label, instances=kept)


def splits_like(known: Mapping[FrameKey, SplitName]) -> Callable[[FrameKey], SplitName]:
    """Say the split of any frame so that it agrees with those of an export.

    Frames that the export left out join its test scenes, and train elsewhere: nothing that is kept for val or
    test is ever trained on.
    """
    test = {scene for (scene, _), split in known.items() if split == "test"}

    def split_of(frame: FrameKey) -> SplitName:
        return known.get(frame, "test" if frame[0] in test else "train")

    return split_of


def videos_with(workspace: Workspace, objects: Sequence[str]) -> set[str]:
    """The recordings in which one of the objects has a pose."""
    parts = workspace.parts()
    return {
        parts.video_of(scene) for name in objects for scene in workspace.load_placed(name).scene_from_object
    }


def recipe_splits(workspace: Workspace) -> dict[FrameKey, SplitName]:
    """The split of each frame of the recipe's own export."""
    return {key: split for key, (split, _) in assigned_splits(workspace.export("coco")).items()}

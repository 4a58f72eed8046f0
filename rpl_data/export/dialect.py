"""What all dialects share: they are made from an exported COCO folder, split by split."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rpl_data.formats.datasets.coco_parts import ByImage, read_packed
from rpl_data.json_arrays import Json
from rpl_data.types import DataError

SPLITS = ("train", "val", "test")


@dataclass(frozen=True)
class DialectSummary:
    """Counts and messages about an exported dialect.

    Attributes:
        images: number of images per split.
        instances: number of labels that were written.
        messages: lines for the user.
    """

    images: Mapping[str, int]
    instances: int = 0
    messages: tuple[str, ...] = ()


@dataclass(frozen=True)
class Split:
    """One split: a file of the COCO folder.

    Attributes:
        annotations: annotations by image id; an image without any has no entry. They are parsed when they
            are looked at, so a change to one is lost.
    """

    name: str
    data: Json
    annotations: Mapping[int, list[Json]] = field(default_factory=dict)

    @property
    def images(self) -> list[Json]:
        """The entries of the images."""
        images: list[Json] = self.data["images"]
        return images


def training_split(coco: Path) -> Split:
    """Read the split that trains.

    Raises:
        DataError: there is none.
    """
    split = next(splits_of(coco))
    if split.name != "train":
        raise DataError(
            f"{coco} has no training images, and this format takes no others; give scenes to training "
            "(`split`), or leave out `--split`"
        )
    return split


def splits_of(coco: Path) -> Iterator[Split]:
    """Read the splits of an exported folder in the order train, val, test; one is in memory at a time.

    Raises:
        DataError: there are no splits.
    """
    names = [name for name in SPLITS if (coco / f"{name}.json").exists()]
    if not names:
        raise DataError(f"{coco} holds no exported COCO files; export `coco` first")
    for name in names:
        data = read_packed(coco / f"{name}.json")
        data["images"] = list(data["images"])  # the formats go through them more than once
        yield Split(name, data, ByImage(data["annotations"]))

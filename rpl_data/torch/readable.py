"""Training goes on past images that cannot be read: they are named, left out and counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torch.utils.data import Dataset, default_collate

from rpl_data.types import DataError


@dataclass(frozen=True)
class Unreadable:
    """What stands in a batch for a sample that could not be read."""

    message: str


class Readable(Dataset[Any]):
    """A dataset whose unreadable samples are `Unreadable` instead of an end of the run."""

    def __init__(self, dataset: Any) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        """As many as the dataset has."""
        return len(self.dataset)

    def __getitem__(self, index: Any) -> Any:
        """The sample, or why not."""
        try:
            return self.dataset[index]
        except DataError as error:
            return Unreadable(str(error))


def collate_readable(samples: Sequence[Any]) -> tuple[Any | None, tuple[str, ...]]:
    """The batch of the samples that could be read (None without any), and why the others could not."""
    read, failed = _parted(samples)
    return (default_collate(read) if read else None), failed


def collate_readable_lists(samples: Sequence[Any]) -> tuple[list[Any], list[Any], tuple[str, ...]]:
    """Images and targets as two lists, as torchvision's detectors take them, and why others are missing."""
    read, failed = _parted(samples)
    return [image for image, _ in read], [target for _, target in read], failed


def _parted(samples: Sequence[Any]) -> tuple[list[Any], tuple[str, ...]]:
    """The samples that could be read, and the messages of the others."""
    read = [sample for sample in samples if not isinstance(sample, Unreadable)]
    return read, tuple(sample.message for sample in samples if isinstance(sample, Unreadable))

"""Let training continue when images cannot be read: they are left out of the batch, with a message each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torch.utils.data import Dataset, default_collate

from rpl_data.types import DataError


@dataclass(frozen=True)
class Unreadable:
    """Stands for a sample that could not be read."""

    message: str


class Readable(Dataset[Any]):
    """A dataset that returns `Unreadable` for a sample that cannot be read, instead of raising the error."""

    def __init__(self, dataset: Any) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        """Number of samples of the dataset."""
        return len(self.dataset)

    def __getitem__(self, index: Any) -> Any:
        """Return the sample, or an `Unreadable` that says why there is none."""
        try:
            return self.dataset[index]
        except DataError as error:
            return Unreadable(str(error))


def collate_readable(samples: Sequence[Any]) -> tuple[Any | None, tuple[str, ...]]:
    """Collate the samples that could be read (None without any); return the others' messages as well."""
    read, failed = _separated(samples)
    return (default_collate(read) if read else None), failed


def collate_readable_lists(samples: Sequence[Any]) -> tuple[list[Any], list[Any], tuple[str, ...]]:
    """Collate images and targets to two lists, as torchvision's detectors take them, and the messages."""
    read, failed = _separated(samples)
    return [image for image, _ in read], [target for _, target in read], failed


def _separated(samples: Sequence[Any]) -> tuple[list[Any], tuple[str, ...]]:
    """Separate the samples that could be read from the messages of the others."""
    read = [sample for sample in samples if not isinstance(sample, Unreadable)]
    return read, tuple(sample.message for sample in samples if isinstance(sample, Unreadable))

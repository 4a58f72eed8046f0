"""Images that two datasets share, found without reading most of them."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from pathlib import Path

from rpl_data.export.split import FrameKey
from rpl_data.files import file_hash
from rpl_data.types import DataError


@dataclass
class ImageIndex:
    """Image files by their content: the same file on the disk, or as many bytes and the same bytes.

    Attributes:
        unread: files by size, of which no digest was needed yet; by_digest: the others, by size and digest.
    """

    by_file: dict[Hashable, FrameKey] = field(default_factory=dict)
    unread: dict[int, list[tuple[FrameKey, Path]]] = field(default_factory=dict)
    by_digest: dict[int, dict[str, FrameKey]] = field(default_factory=dict)

    def add(self, key: FrameKey, path: Path) -> None:
        """Remember an image."""
        identity, size = _identity(path)
        self.by_file.setdefault(identity, key)
        self.unread.setdefault(size, []).append((key, path))

    def find(self, path: Path) -> FrameKey | None:
        """The frame that was remembered with the same image; None when there is none.

        A hard link and a symbolic link are the file itself. Only files of the same size are read.
        """
        identity, size = _identity(path)
        if identity in self.by_file:
            return self.by_file[identity]
        for key, other in self.unread.pop(size, ()):
            self.by_digest.setdefault(size, {}).setdefault(file_hash(other), key)
        return self.by_digest[size].get(file_hash(path)) if size in self.by_digest else None


def _identity(path: Path) -> tuple[Hashable, int]:
    """What tells the file on the disk from others, and its size."""
    try:
        found = path.stat()
    except OSError as error:
        raise DataError(f"{path} is missing; put it back or export the dataset again") from error
    return (found.st_dev, found.st_ino), found.st_size

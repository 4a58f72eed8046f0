"""COCO files written entry by entry, complete or not at all, in memory that does not grow."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from rpl_data.files import writing
from rpl_data.json_arrays import Json


@dataclass(frozen=True)
class CocoWriter:
    """Collects the entries of `writing_entries` in two open temporary files."""

    images: IO[str]
    annotations: IO[str]

    def add(self, image: Json | None, annotations: Iterable[Json]) -> None:
        """Add an image and its annotations; None for further ones of an image that was added."""
        if image is not None:
            _append(self.images, image)
        for annotation in annotations:
            _append(self.annotations, annotation)


@contextmanager
def writing_entries(path: Path, top: Json) -> Iterator[CocoWriter]:
    """Yield a writer whose file appears, complete, when the block ends well.

    Args:
        top: everything but images and annotations.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8", dir=path.parent) as images,
        tempfile.TemporaryFile("w+", encoding="utf-8", dir=path.parent) as annotations,
    ):
        yield CocoWriter(images, annotations)
        with writing(path) as file:
            file.write(json.dumps(top, allow_nan=False)[:-1])
            for key, part in (("images", images), ("annotations", annotations)):
                file.write(f',\n"{key}": [\n')
                part.seek(0)
                shutil.copyfileobj(part, file)
                file.write("]")
            file.write("}\n")


def _append(file: IO[str], entry: Json) -> None:
    """Append an element of a JSON array, one per line."""
    file.write((",\n" if file.tell() else "") + json.dumps(entry, allow_nan=False))

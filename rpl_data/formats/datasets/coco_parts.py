"""A COCO file read a part at a time, so that a large one needs little memory.

`CocoWriter` writes the head of a file on a line, and every image and annotation on a line of its own. A file
that another program wrote has other lines, and is parsed as a whole.
"""

from __future__ import annotations

import gc
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate, chain
from pathlib import Path
from typing import IO, Any, overload

import orjson

from rpl_data.files import decoding, opened, read_bytes, read_json
from rpl_data.formats.datasets.coco_check import BATCH, CocoCheck, validate_coco
from rpl_data.formats.datasets.coco_edited import REMEDY, annotations_as_exported, as_exported, number_ids
from rpl_data.json_arrays import Json

LISTS = ("images", "annotations")
LONGEST_HEAD = 2**24
"""Bytes of the first line; a longer one is that of a file without lines."""


class Packed(Sequence[Json]):
    """Entries kept as JSON text, which takes a fraction of the memory, and parsed when they are looked at.

    A change to an entry is therefore lost.
    """

    def __init__(self) -> None:
        self._blocks: list[bytes] = []
        self._first_rows: list[int] = []
        self._ends = array("L")  # where each entry ends in its block

    def add(self, entries: Sequence[Json], keys: Sequence[str] | None) -> None:
        """Append entries, with some of their keys or with all."""
        if not entries:
            return
        kept = entries if keys is None else [{k: e[k] for k in keys if k in e} for e in entries]
        texts = list(map(orjson.dumps, kept))
        self._first_rows.append(len(self._ends))
        self._ends.extend(accumulate(len(text) + 1 for text in texts))  # each with a comma behind it
        self._blocks.append(b",".join(texts))

    def __len__(self) -> int:
        """Number of entries."""
        return len(self._ends)

    @overload
    def __getitem__(self, row: int) -> Json: ...

    @overload
    def __getitem__(self, row: slice) -> list[Json]: ...

    def __getitem__(self, row: int | slice) -> Json | list[Json]:
        """Parse an entry, or several."""
        if isinstance(row, slice):
            return [self[number] for number in range(*row.indices(len(self)))]
        row = range(len(self))[row]  # IndexError past the last
        block = bisect_right(self._first_rows, row) - 1
        start = 0 if row == self._first_rows[block] else self._ends[row - 1]
        entry: Json = orjson.loads(memoryview(self._blocks[block])[start : self._ends[row] - 1])
        return entry

    def __iter__(self) -> Iterator[Json]:
        """Parse the entries, a block at a time."""
        return chain.from_iterable(orjson.loads(b"[" + block + b"]") for block in self._blocks)


class ByImage(Mapping[int, list[Json]]):
    """Annotations by the id of their image, parsed when they are looked at; images without any are left out.

    A change to an annotation is therefore lost.
    """

    def __init__(self, *lists: Sequence[Json]) -> None:
        """Sort the annotations of all lists; those of an image keep their order."""
        self._lists = lists
        self._rows: dict[int, list[tuple[int, int]]] = {}
        for number, entries in enumerate(lists):
            for row, entry in enumerate(entries):
                self._rows.setdefault(entry["image_id"], []).append((number, row))

    def __getitem__(self, image_id: int) -> list[Json]:
        """Parse the annotations of an image."""
        return [self._lists[number][row] for number, row in self._rows[image_id]]

    def __iter__(self) -> Iterator[int]:
        """Ids of the images that have annotations."""
        return iter(self._rows)

    def __len__(self) -> int:
        """How many images have annotations."""
        return len(self._rows)


def read_packed(path: Path, keys: Mapping[str, Sequence[str]] | None = None) -> Json:
    """Read and check a file as `coco.read_coco` does; its images and annotations are `Packed`.

    For everything that only reads: the same content in half the memory.

    Args:
        keys: for "images", "annotations" and "crowds", the keys that are wanted; all where it says nothing.

    Raises:
        DataError: the file is damaged or foreign.
    """
    source, keys = str(path), keys or {}
    with collector_waiting():
        try:
            return _packed(path, source, keys)
        except _OtherLinesError:
            data = as_exported(read_fast(path), source=source)
        validate_coco(data, source=source)
    with decoding(source, REMEDY):  # half of a surrogate pair, "\ud800", is JSON but no text
        for name in (*LISTS, "crowds"):
            if name in data:
                entries, data[name] = data[name], Packed()
                data[name].add(entries, keys.get(name))
    return data


def read_fast(path: Path) -> Any:
    """Read a JSON file, unchecked; DataError when it is missing or broken."""
    with collector_waiting():
        try:
            return _whole(path)
        except _OtherLinesError:
            content = read_bytes(path)
        try:
            return orjson.loads(content)
        except orjson.JSONDecodeError:  # or what only the slow reader takes: odd numbers, encodings, nesting
            return read_json(path)


def _whole(path: Path) -> Json:
    """Read a file line by line: then its text is not in memory beside what was parsed of it."""
    with opened(path) as file:
        data = _head(file)
        for name in LISTS:
            data[name] = [entry for part in _parts(file, name) for entry in part]
        if file.readline():
            raise _OtherLinesError
    return data


def _head(file: IO[bytes]) -> Json:
    """Read everything but images and annotations."""
    data = _parsed(file.readline(LONGEST_HEAD).rstrip(b",\n") + b"}")
    if not isinstance(data, dict) or not data.keys() >= {"categories", "rpl"}:
        raise _OtherLinesError
    return data


@contextmanager
def collector_waiting() -> Iterator[None]:
    """Let the collector of cycles wait: it would look at each of a million new lists in vain."""
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


class _OtherLinesError(Exception):
    """The file has other lines than those that `CocoWriter` writes."""


def _packed(path: Path, source: str, keys: Mapping[str, Sequence[str]]) -> Json:
    """Read a file line by line; `_OtherLinesError` where its lines are others."""
    sizes: dict[int, tuple[int, int]] = {}
    with opened(path) as file, decoding(source, REMEDY):
        data = _head(file)
        number_ids(data["categories"], data["rpl"].get("objects", []))
        check = CocoCheck(data, source)
        data |= {name: Packed() for name in (*LISTS, "crowds")}
        for images in _parts(file, "images"):
            number_ids(images)
            check.images(images)
            sizes |= {image["id"]: (image["height"], image["width"]) for image in images}
            data["images"].add(images, keys.get("images"))
        for entries in _parts(file, "annotations"):
            annotations, crowds = annotations_as_exported(entries, sizes, source=source)
            check.annotations(annotations)
            data["annotations"].add(annotations, keys.get("annotations"))
            data["crowds"].add(crowds, keys.get("crowds"))
        if file.readline():
            raise _OtherLinesError
    if not data["crowds"]:
        del data["crowds"]
    return data


def _parts(file: IO[bytes], name: str) -> Iterator[list[Json]]:
    """Parse a list of entries, a line each, some at a time."""
    if file.readline() != f'"{name}": [\n'.encode():
        raise _OtherLinesError
    lines: list[bytes] = []
    for line in file:
        lines.append(line)
        ended = line.endswith((b"],\n", b"]}\n"))
        if ended or len(lines) == BATCH:
            text = b"".join(lines).rstrip()
            entries = _parsed(b"[" + (text[:-1] if ended else text.removesuffix(b",") + b"]"))
            if not isinstance(entries, list):
                raise _OtherLinesError
            yield entries
            lines = []
        if ended:
            return
    raise _OtherLinesError


def _parsed(text: bytes) -> Any:
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise _OtherLinesError from error

"""Read PLY files, checking every size and index before it is used.

Open3D's reader ends the process on many damaged files (one byte too long is enough), so this reader is
used instead. It reads ASCII and binary files of either byte order, any scalar properties and any lists; the
format is that of Greg Turk's "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from rpl_data.files import read_bytes
from rpl_data.types import DataError
from rpl_data.untrusted.ply_header import Columns, Element, ListOf, read_header
from rpl_data.untrusted.ply_text import TextBody

MOST_MIXED = 1_000_000
"""Largest number of faces when these differ in size, since a binary file's are then read one by one."""
FACES = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class Ply:
    """The content of a PLY file.

    Attributes:
        vertices: scalar properties of the vertices, by name.
        triangles: corners as rows of `vertices`; larger polygons are split into fans. Empty without faces.
    """

    vertices: Columns
    triangles: Int64[np.ndarray, "m 3"]


def read_ply(path: Path) -> Ply:
    """Read the vertices and triangles of a file.

    Raises:
        DataError: the file is missing, is not a PLY file, is shorter or longer than its header says, or a
            face refers to a vertex that does not exist.
    """
    content = read_bytes(path)
    try:
        return _ply(content)
    except (ValueError, OverflowError) as error:
        raise DataError(f"{path} is a damaged PLY file: {error}; save it again") from error


def _ply(content: bytes) -> Ply:
    order, elements, start = read_header(content)
    body = TextBody(content, start) if order == "=" else _Binary(content, start, order)
    vertices: Columns = {}
    triangles = np.empty((0, 3), np.int64)
    for element in elements:
        if element.name == "face" and (corners := next((n for n in FACES if n in element.properties), None)):
            triangles = _triangles(*body.lists(element, corners))
        elif element.name == "vertex":
            if any(isinstance(kind, ListOf) for kind in element.properties.values()):
                raise ValueError("a vertex has a list property, which is not known here")
            vertices = body.table(element)
        else:
            body.skip(element)
    body.refuse_rest()
    count = len(next(iter(vertices.values()), ()))
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < count):
        raise ValueError(f"a face has the corner {triangles.max()}, but there are {count} vertices")
    return Ply(vertices, triangles)


def _triangles(lengths: np.ndarray, corners: np.ndarray) -> Int64[np.ndarray, "m 3"]:
    """Split polygons into fans of triangles, given their lengths and all corners in sequence."""
    if len(lengths) and (lengths == 3).all():
        return corners.astype(np.int64).reshape(-1, 3)
    starts = np.cumsum(lengths) - lengths
    fans = np.maximum(lengths - 2, 0)
    first = np.repeat(starts, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    rows = np.column_stack([first, first + step + 1, first + step + 2])
    return np.asarray(corners[rows], dtype=np.int64)


class _Binary:
    """The body of a binary file, read in sequence."""

    def __init__(self, content: bytes, at: int, order: str) -> None:
        self.content, self.at, self.order = content, at, order

    def table(self, element: Element) -> Columns:
        """The scalar properties of an element without lists."""
        kinds = [(name, self.order + str(kind)) for name, kind in element.properties.items()]
        row = np.dtype(kinds)
        rows = self._take(element, row, element.count)
        return {name: rows[name] for name, _ in kinds}

    def lists(self, element: Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        """Read the lengths and items of one list property; fast when all lists are as long as the first."""
        if element.count == 0:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        kinds = element.properties.values()
        least = sum(np.dtype(kind.length if isinstance(kind, ListOf) else kind).itemsize for kind in kinds)
        if element.count * least > len(self.content) - self.at:
            raise ValueError(f"it ends before the last of {element.count} {element.name} items")
        before = self.at
        first = {name: len(values) for name, values in self._item(element) if isinstance(values, np.ndarray)}
        self.at = before
        row = self._row(element, first)
        if element.count * row.itemsize <= len(self.content) - self.at:
            rows = np.frombuffer(self.content, row, element.count, self.at)
            if all((rows[f"{name} length"] == length).all() for name, length in first.items()):
                self.at += element.count * row.itemsize
                return np.full(element.count, first[wanted]), rows[wanted].ravel()
        return self._mixed(element, wanted)

    def _row(self, element: Element, lengths: Mapping[str, int]) -> np.dtype[np.void]:
        fields: list[tuple[str, str] | tuple[str, str, tuple[int, ...]]] = []
        for name, kind in element.properties.items():
            if isinstance(kind, ListOf):
                fields.append((f"{name} length", self.order + kind.length))
                fields.append((name, self.order + kind.item, (lengths[name],)))
            else:
                fields.append((name, self.order + kind))
        return np.dtype(fields)

    def _mixed(self, element: Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        if element.count > MOST_MIXED:
            raise ValueError(f"more than {MOST_MIXED} faces have different numbers of corners")
        found = [dict(self._item(element))[wanted] for _ in range(element.count)]
        return np.array([len(values) for values in found]), np.concatenate(found)

    def _item(self, element: Element) -> Iterator[tuple[str, np.ndarray]]:
        """The list properties of the next item."""
        for name, kind in element.properties.items():
            if isinstance(kind, ListOf):
                length = int(self._take(element, np.dtype(self.order + kind.length), 1)[0])
                yield name, self._take(element, np.dtype(self.order + kind.item), length)
            else:
                self._take(element, np.dtype(self.order + kind), 1)

    def skip(self, element: Element) -> None:
        """Skip an element."""
        if not any(isinstance(kind, ListOf) for kind in element.properties.values()):
            self.table(element)
        elif element.count:
            name = next(name for name, kind in element.properties.items() if isinstance(kind, ListOf))
            self.lists(element, name)

    def _take(self, element: Element, kind: np.dtype, count: int) -> np.ndarray:
        size = count * kind.itemsize
        if count < 0 or size > len(self.content) - self.at:
            raise ValueError(f"it ends before the last of {element.count} {element.name} items")
        if kind.itemsize == 0:
            return np.empty(0, kind)
        found = np.frombuffer(self.content, kind, count, self.at)
        self.at += size
        return found

    def refuse_rest(self) -> None:
        """Raise a ValueError when bytes follow the elements that the header declares."""
        rest = len(self.content) - self.at
        if rest:
            raise ValueError(f"{rest} bytes follow what its header names")

"""Read PLY files, checking every size and index before it is used.

Open3D's reader ends the process on many damaged files (one byte too long is enough), so this reader is
used instead. It reads ASCII and binary files of either byte order, any scalar properties and any lists; the
format is that of Greg Turk's "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from rpl_data.files import read_bytes
from rpl_data.types import DataError

Columns = Mapping[str, np.ndarray]
"""Values of one element by the name of the property, one row per item."""

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 64 * 2**10
MOST_MIXED = 1_000_000
"""Largest number of faces when these differ in size, since a binary file's are then read one by one."""
WORDS_AT_ONCE = 2**20
"""Words of a text file that are split and converted at a time, to limit memory."""
END = b"end_header"
FACES = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class _List:
    """A list property: the type of its length and that of its items."""

    length: str
    item: str


@dataclass
class _Element:
    """An element of the header: how many items, and the type of each property in order."""

    name: str
    count: int
    properties: dict[str, str | _List] = field(default_factory=dict)


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
    order, elements, start = _header(content)
    body = _Text(content, start) if order == "=" else _Binary(content, start, order)
    vertices: Columns = {}
    triangles = np.empty((0, 3), np.int64)
    for element in elements:
        if element.name == "face" and (corners := next((n for n in FACES if n in element.properties), None)):
            triangles = _triangles(*body.lists(element, corners))
        elif element.name == "vertex":
            if any(isinstance(kind, _List) for kind in element.properties.values()):
                raise ValueError("a vertex has a list property, which is not known here")
            vertices = body.table(element)
        else:
            body.skip(element)
    body.refuse_rest()
    count = len(next(iter(vertices.values()), ()))
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < count):
        raise ValueError(f"a face has the corner {triangles.max()}, but there are {count} vertices")
    return Ply(vertices, triangles)


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """The byte order ("=" for text), the elements, and where the body starts."""
    end = content.find(END, 0, LONGEST_HEADER)
    newline = content.find(b"\n", end)
    if not content.startswith(b"ply") or end < 0 or newline < 0:
        raise ValueError("it does not begin with a PLY header")
    order, elements = "", list[_Element]()
    for line in content[:end].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", kind, "1.0"] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, item, name] if elements and {length, item} <= TYPES.keys():
                if TYPES[length][0] == "f":
                    raise ValueError(f"the length of the list {name} is not a whole number")
                elements[-1].properties[name] = _List(TYPES[length], TYPES[item])
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties[name] = TYPES[kind]
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {line[:60]!r}")
    if not order:
        raise ValueError("its header names no format")
    return order, elements, newline + 1


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

    def table(self, element: _Element) -> Columns:
        """The scalar properties of an element without lists."""
        kinds = [(name, self.order + str(kind)) for name, kind in element.properties.items()]
        row = np.dtype(kinds)
        rows = self._take(element, row, element.count)
        return {name: rows[name] for name, _ in kinds}

    def lists(self, element: _Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        """Read the lengths and items of one list property; fast when all lists are as long as the first."""
        if element.count == 0:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        kinds = element.properties.values()
        least = sum(np.dtype(kind.length if isinstance(kind, _List) else kind).itemsize for kind in kinds)
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

    def _row(self, element: _Element, lengths: Mapping[str, int]) -> np.dtype[np.void]:
        fields: list[tuple[str, str] | tuple[str, str, tuple[int, ...]]] = []
        for name, kind in element.properties.items():
            if isinstance(kind, _List):
                fields.append((f"{name} length", self.order + kind.length))
                fields.append((name, self.order + kind.item, (lengths[name],)))
            else:
                fields.append((name, self.order + kind))
        return np.dtype(fields)

    def _mixed(self, element: _Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        if element.count > MOST_MIXED:
            raise ValueError(f"more than {MOST_MIXED} faces have different numbers of corners")
        found = [dict(self._item(element))[wanted] for _ in range(element.count)]
        return np.array([len(values) for values in found]), np.concatenate(found)

    def _item(self, element: _Element) -> Iterator[tuple[str, np.ndarray]]:
        """The list properties of the next item."""
        for name, kind in element.properties.items():
            if isinstance(kind, _List):
                length = int(self._take(element, np.dtype(self.order + kind.length), 1)[0])
                yield name, self._take(element, np.dtype(self.order + kind.item), length)
            else:
                self._take(element, np.dtype(self.order + kind), 1)

    def skip(self, element: _Element) -> None:
        """Skip an element."""
        if not any(isinstance(kind, _List) for kind in element.properties.values()):
            self.table(element)
        elif element.count:
            name = next(name for name, kind in element.properties.items() if isinstance(kind, _List))
            self.lists(element, name)

    def _take(self, element: _Element, kind: np.dtype, count: int) -> np.ndarray:
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


class _Text:
    """The body of a text file, numbers separated by white space, read in sequence."""

    def __init__(self, content: bytes, at: int) -> None:
        chunks, rest = [np.empty(0)], [content[at:]]
        while rest:
            words = rest[0].split(None, WORDS_AT_ONCE)
            words, rest = words[:WORDS_AT_ONCE], words[WORDS_AT_ONCE:]
            chunks.append(np.array(words, dtype=np.float64))
        self.numbers, self.at = np.concatenate(chunks), 0

    def table(self, element: _Element) -> Columns:
        """The scalar properties of an element without lists."""
        width = len(element.properties)
        if width == 0:
            return {}
        rows = self._take(element, element.count * width).reshape(-1, width)
        kinds = element.properties.items()
        return {name: _as_whole(rows[:, i], str(kind)) for i, (name, kind) in enumerate(kinds)}

    def lists(self, element: _Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and items of one list property."""
        lengths, items = [], [np.empty(0, np.int64)]
        for _ in range(element.count):
            for name, kind in element.properties.items():
                count = int(self._take(element, 1)[0]) if isinstance(kind, _List) else 1
                values = self._take(element, count)
                if name == wanted and isinstance(kind, _List):
                    lengths.append(count)
                    items.append(_as_whole(values, kind.item))
        return np.array(lengths, np.int64), np.concatenate(items)

    def skip(self, element: _Element) -> None:
        """Skip an element."""
        if element.properties:
            self.lists(element, "")

    def _take(self, element: _Element, count: int) -> np.ndarray:
        if not 0 <= count <= len(self.numbers) - self.at:
            raise ValueError(f"it ends before the last of {element.count} {element.name} items")
        found = self.numbers[self.at : self.at + count]
        self.at += count
        return found

    def refuse_rest(self) -> None:
        """Raise a ValueError when numbers follow the elements that the header declares."""
        rest = len(self.numbers) - self.at
        if rest:
            raise ValueError(f"{rest} numbers follow what its header names")


def _as_whole(values: np.ndarray, kind: str) -> np.ndarray:
    """Convert the numbers of a text to the type of their property; ValueError where they do not fit it."""
    if kind[0] == "f":
        return values
    limits = np.iinfo(kind)
    if not ((values == np.round(values)) & (values >= limits.min) & (values <= limits.max)).all():
        raise ValueError("a whole number is expected where another one is")
    return values.astype(kind)

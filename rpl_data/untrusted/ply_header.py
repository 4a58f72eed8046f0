"""The header of a PLY file: its elements, and the types of their properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

Columns = Mapping[str, np.ndarray]
"""Values of one element by the name of the property, one row per item."""

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 64 * 2**10
END = b"end_header"


@dataclass(frozen=True)
class ListOf:
    """A list property: the type of its length and that of its items."""

    length: str
    item: str


@dataclass
class Element:
    """An element of the header: how many items, and the type of each property in order."""

    name: str
    count: int
    properties: dict[str, str | ListOf] = field(default_factory=dict)


def read_header(content: bytes) -> tuple[str, list[Element], int]:
    """Read the byte order ("=" for text), the elements, and where the body starts.

    Raises:
        ValueError: the content does not begin with a header, or the header has a line that is not known.
    """
    end = content.find(END, 0, LONGEST_HEADER)
    newline = content.find(b"\n", end)
    if not content.startswith(b"ply") or end < 0 or newline < 0:
        raise ValueError("it does not begin with a PLY header")
    order, elements = "", list[Element]()
    for line in content[:end].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", kind, "1.0"] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(Element(name, int(count)))
            case ["property", "list", length, item, name] if elements and {length, item} <= TYPES.keys():
                if TYPES[length][0] == "f":
                    raise ValueError(f"the length of the list {name} is not a whole number")
                elements[-1].properties[name] = ListOf(TYPES[length], TYPES[item])
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties[name] = TYPES[kind]
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {line[:60]!r}")
    if not order:
        raise ValueError("its header names no format")
    return order, elements, newline + 1

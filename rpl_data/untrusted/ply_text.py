"""The body of a PLY file in ASCII: numbers separated by white space, read many at a time."""

from __future__ import annotations

import warnings
from contextlib import suppress

import numpy as np

from rpl_data.untrusted.ply_header import Columns, Element, ListOf

BYTES_AT_ONCE = 2**19
"""Bytes of a text file that are converted at a time, to limit memory."""
SPACES = bytes.maketrans(b" \t\n\r\v\f", b",,,,,,")
EXACT = 2**53
"""Whole numbers below it are exact as floats."""


class TextBody:
    """The body of a text file, numbers separated by white space, read in sequence."""

    def __init__(self, content: bytes, at: int) -> None:
        chunks = [np.empty(0)]
        while at < len(content):
            end = content.find(b"\n", at + BYTES_AT_ONCE)
            end = len(content) if end < 0 else end
            chunks.append(_numbers(content[at:end]))
            at = end
        self.numbers, self.at = np.concatenate(chunks), 0

    def table(self, element: Element) -> Columns:
        """The scalar properties of an element without lists."""
        width = len(element.properties)
        if width == 0:
            return {}
        rows = self._take(element, element.count * width).reshape(-1, width)
        kinds = element.properties.items()
        return {name: _as_whole(rows[:, i], str(kind)) for i, (name, kind) in enumerate(kinds)}

    def lists(self, element: Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        """Read the lengths and items of one list property; fast when all lists are as long as the first."""
        before, lengths = self.at, []
        for kind in element.properties.values() if element.count else ():
            lengths.append(self._length(element) if isinstance(kind, ListOf) else 0)
            self.at += lengths[-1] if isinstance(kind, ListOf) else 1
        width, self.at = self.at - before, before
        if element.count * width <= len(self.numbers) - before:
            rows = self.numbers[before : before + element.count * width].reshape(element.count, width)
            at, found, alike = 0, rows[:, :0], True
            for (name, kind), length in zip(element.properties.items(), lengths, strict=False):
                if isinstance(kind, ListOf):
                    alike = alike and bool((rows[:, at] == length).all())
                    found = rows[:, at + 1 : at + 1 + length] if name == wanted else found
                at += 1 + length
            if alike:
                self.at += rows.size
                return self._typed(element, wanted, np.full(len(rows), found.shape[1]), found.ravel())
        return self._mixed(element, wanted)

    def _mixed(self, element: Element, wanted: str) -> tuple[np.ndarray, np.ndarray]:
        """Go through lists of different lengths one by one."""
        starts, lengths, at, size = [], [], self.at, len(self.numbers)
        for _ in range(element.count):
            for name, kind in element.properties.items():
                length = self.numbers.item(at) if isinstance(kind, ListOf) and at < size else 0
                at += 1
                if not 0 <= length <= size - at or length % 1:
                    raise ValueError(f"it ends before the last of {element.count} {element.name} items")
                if name == wanted:
                    starts.append(at)
                    lengths.append(int(length))
                at += int(length)
        self.at = at
        counts = np.array(lengths, np.int64)
        steps = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        rows = np.repeat(np.array(starts, np.int64), counts) + steps
        return self._typed(element, wanted, counts, self.numbers[rows])

    def _typed(
        self, element: Element, wanted: str, lengths: np.ndarray, items: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and items of a list property, the items in their type."""
        kind = element.properties.get(wanted)
        return lengths, _as_whole(items, kind.item) if isinstance(kind, ListOf) else items

    def _length(self, element: Element) -> int:
        """Take the length of a list."""
        return int(_as_whole(self._take(element, 1), "u4")[0])

    def skip(self, element: Element) -> None:
        """Skip an element."""
        if element.properties:
            self.lists(element, "")

    def _take(self, element: Element, count: int) -> np.ndarray:
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


def _numbers(text: bytes) -> np.ndarray:
    """Convert the words of a text to numbers, whole ones ten times as fast; ValueError when one is none."""
    words = text.translate(SPACES).strip(b",")
    if b"," in text or b"\0" in text:
        raise ValueError("its numbers are separated by commas or zero bytes, not by white space")
    if b",," in words:
        words = b",".join(text.split())
    if not words:
        return np.empty(0)
    whole = not words.translate(None, b"0123456789-,")
    numbers = _from_text(words, np.int64 if whole else np.float64)
    if whole and not -EXACT < numbers.min() <= numbers.max() < EXACT:
        numbers = _from_text(words, np.float64)
    return numbers.astype(np.float64)


def _from_text(words: bytes, kind: type[np.int64 | np.float64]) -> np.ndarray:
    """Convert words between commas; NumPy before 2.4 warns and stops at the first that is no number."""
    with warnings.catch_warnings(), suppress(ValueError):
        warnings.simplefilter("ignore", DeprecationWarning)
        numbers = np.fromstring(words, kind, sep=",")
        if len(numbers) == words.count(b",") + 1:
            return numbers
    for word in words.split(b","):
        float(word)  # raises a ValueError that names the word
    raise ValueError("a word among its numbers is none")


def _as_whole(values: np.ndarray, kind: str) -> np.ndarray:
    """Convert the numbers of a text to the type of their property; ValueError where they do not fit it."""
    if kind[0] == "f":
        return values
    limits = np.iinfo(kind)
    if not ((values == np.round(values)) & (values >= limits.min) & (values <= limits.max)).all():
        raise ValueError("a whole number is expected where another one is")
    return values.astype(kind)

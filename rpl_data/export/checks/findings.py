"""What the checks of all dialects share: the faults that were found, and the readers that find them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.export.checks.rules import Rule, Rules, rigid
from rpl_data.files import FAULTS, read_json, read_text
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.json_arrays import Json, number
from rpl_data.types import DataError
from rpl_data.untrusted.yaml_text import read_yaml


@dataclass(frozen=True)
class Fault:
    """What is wrong with a field of an export.

    Attributes:
        file: path relative to the export.
        record: which line or entry of the file; empty for the file as a whole.
        field: its name; empty where the whole record is meant.
        problem: what was expected, and what was found.
    """

    file: str
    record: str
    field: str
    problem: str

    def __str__(self) -> str:
        """Return the fault in one line."""
        return ": ".join(part for part in (self.file, self.record, self.field, self.problem) if part)


class Findings:
    """The faults found in an export so far, and the readers that add to them.

    Attributes:
        folder: the export.
        faults: what was found.
    """

    def __init__(self, folder: Path) -> None:
        """Start without faults."""
        self.folder = folder
        self.faults: list[Fault] = []

    def add(self, file: str, record: str, field: str, problem: str) -> None:
        """Note a fault."""
        self.faults.append(Fault(file, record, field, problem))

    def json(self, file: str) -> Any:
        """Read a JSON file; None, with a fault noted, where that is not possible."""
        return self._read(file, read_json)

    def json_objects(self, file: str) -> Json:
        """Read a JSON file that holds an object; empty, with a fault noted, where it does not."""
        found = self.json(file)
        if isinstance(found, dict):
            return found
        if found is not None:
            self.add(file, "", "", f"expected a JSON object, found {type(found).__name__}")
        return {}

    def lines(self, file: str) -> list[str]:
        """Read the lines of a text file; none, with a fault noted, where that is not possible."""
        text = self._read(file, read_text)
        return text.splitlines() if isinstance(text, str) else []

    def json_lines(self, file: str) -> list[tuple[str, Json]]:
        """Read a file with one JSON object per line, as ("line 1", object)."""
        found = []
        for row, line in enumerate(self.lines(file), start=1):
            try:
                value = json.loads(line)
            except ValueError as error:
                value = str(error)
            if isinstance(value, dict):
                found.append((f"line {row}", value))
            else:
                self.add(file, f"line {row}", "", f"expected a JSON object: {value!r:.80}")
        return found

    def yaml_objects(self, file: str) -> dict[Any, Any] | None:
        """Read a YAML file of keys with values; None, with a fault noted, where it is none."""
        lines = self.lines(file)
        if not lines:
            if (self.folder / file).is_file():
                self.add(file, "", "", "empty")
            return None
        try:
            data = read_yaml("\n".join(lines), source=file)
        except DataError as error:
            self.add(file, "", "", str(error)[:200])
            return None
        if isinstance(data, dict):
            return data
        self.add(file, "", "", f"expected keys with values, found {type(data).__name__}")
        return None

    def numbers(self, file: str, rows: int | None, columns: int) -> Float64[np.ndarray, "_ _"] | None:
        """Read a table of numbers, one row per line; None, with a fault noted, where it is none."""
        lines = self.lines(file)
        try:
            table = np.array([[number(float(word)) for word in line.split()] for line in lines])
            if table.shape != (len(lines) if rows is None else rows, columns) or not len(table):
                wanted = columns if rows is None else f"{rows} x {columns}"
                raise ValueError(f"{len(lines)} lines with other than {wanted} numbers")
        except ValueError as error:
            if (self.folder / file).is_file():
                self.add(file, "", "numbers", str(error))
            return None
        return np.asarray(table)

    def pose(self, file: str) -> None:
        """Check a file with a 4 x 4 rigid transform."""
        table = self.numbers(file, 4, 4)
        if table is not None:
            self.rule(file, "", "numbers", rigid, table.ravel().tolist())

    def fields(self, entry: Any, rules: Rules, file: str, record: str) -> bool:
        """Check that an entry is an object whose fields keep their rules; whether it is."""
        if not isinstance(entry, dict):
            self.add(file, record, "", f"expected a JSON object, found {type(entry).__name__}")
            return False
        sound = True
        for field, rule in rules.items():
            if field not in entry:
                self.add(file, record, field, "missing")
                sound = False
            else:
                sound &= self.rule(file, record, field, rule, entry[field])
        return sound

    def rule(self, file: str, record: str, field: str, rule: Rule, value: Any) -> bool:
        """Check one value; whether it keeps the rule."""
        try:
            rule(value)
        except FAULTS as error:
            self.add(file, record, field, str(error)[:200])
            return False
        return True

    def equal(self, file: str, record: str, field: str, found: Any, expected: Any, what: str) -> None:
        """Check that a value is what follows from another."""
        if found != expected:
            self.add(file, record, field, f"expected {expected}, {what}; found {found!s:.80}")

    def named(self, name: Any, file: str, record: str, field: str) -> Path | None:
        """The file that a field names, relative to the export; None, with a fault noted, where none is."""
        path = self.folder / str(name)
        if path.is_file():
            return path
        self.add(file, record, field, f"there is no file {name}")
        return None

    def image(
        self, file: str, *, size: Sequence[int] | None = None, like: str = "", kind: str = "color"
    ) -> np.ndarray | None:
        """Decode an image and check its kind and size; None, with a fault noted, where it is not sound.

        Args:
            file: path relative to the export.
            size: width and height that it must have.
            like: file or entry that has this size, for the message.
            kind: `color` (8 bit), `depth` (16 bit, one channel) or `mask` (8 bit, one channel).
        """
        path = self.folder / file
        whole_file = path.is_file() and probe(path) is not None
        image = (
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
            if whole_file
            else None
        )
        if image is None:
            self.add(file, "", "", "missing, cut off or no image" if path.exists() else "missing")
            return None
        depth = np.uint16 if kind == "depth" else np.uint8
        if image.dtype != depth or (kind != "color" and image.ndim != 2):
            self.add(file, "", "", f"expected {KINDS[kind]}, found {image.dtype} of shape {image.shape}")
            return None
        found = [image.shape[1], image.shape[0]]
        if size is not None and found != list(size):
            wanted = f"expected {size[0]} x {size[1]} px{like and f', as {like} has'}"
            self.add(file, "", "size", f"{wanted}, found {found[0]} x {found[1]}")
            return None
        return np.asarray(image)

    def _read(self, file: str, read: Callable[[Path], Any]) -> Any:
        try:
            return read(self.folder / file)
        except DataError as error:
            self.add(file, "", "", str(error).replace(f"{self.folder}/", ""))
            return None


KINDS = {
    "color": "8 bits per channel",
    "depth": "16 bits and one channel",
    "mask": "8 bits and one channel",
}
"""What an image of each kind must be."""


def box_of(mask: np.ndarray) -> list[int]:
    """x, y, width, height of a mask, to the far edge of its last pixel; zeros for an empty one."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return [0, 0, 0, 0]
    x, y = int(columns.min()), int(rows.min())
    return [x, y, int(columns.max()) - x + 1, int(rows.max()) - y + 1]


def stems(folder: Path, suffixes: Iterable[str] | None = None) -> dict[str, str]:
    """Names of the files of a folder, sorted, by what they are called without their suffix."""
    wanted = None if suffixes is None else set(suffixes)
    paths = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path.stem: path.name for path in paths if wanted is None or path.suffix.lower() in wanted}

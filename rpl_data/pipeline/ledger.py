"""Steps of a build, and the ledger (`stages.json`) that knows which of them are up to date.

A step is a stage applied to one scene or object. Its key is made of everything it depends on: its
version, its options, sizes and times of its sources, and the keys of the steps before it. Recordings
are never hashed.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rpl_data.files import read_json, write_json
from rpl_data.json_arrays import Json

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}


@dataclass(frozen=True)
class Outcome:
    """Result of a step besides its files.

    Attributes:
        frames: number of frames it processed; 0 for work that is not per frame.
        messages: lines for the user.
        details: JSON-ready figures for the report and later steps.
    """

    frames: int = 0
    messages: tuple[str, ...] = ()
    details: Json = field(default_factory=dict)


Advance = Callable[[int, int], None]
"""``advance(done, total)``: a step reports how many of its frames are done."""


@dataclass(frozen=True)
class Step:
    """One stage, on one scene or object.

    Attributes:
        stage: name of the stage.
        item: scene or object; empty when the stage works on all at once.
        version: increased when the code of the stage changes what it writes.
        options: the part of the recipe that it depends on, JSON-ready.
        sources: sizes and times of the external files that it depends on, from `stamps`.
        after: names of the steps whose results it reads.
        outputs: files that must exist for the step to be up to date.
        run: does the work.
    """

    stage: str
    item: str
    version: int
    options: Json
    sources: Json
    after: tuple[str, ...]
    outputs: tuple[Path, ...]
    run: Callable[[Advance], Outcome]

    @property
    def name(self) -> str:
        """`stage` or `stage/item`."""
        return f"{self.stage}/{self.item}" if self.item else self.stage


@dataclass(frozen=True)
class Entry:
    """What the ledger records about a step that ran to its end."""

    key: str
    version: int
    options: Json
    sources: Json
    after: dict[str, str]
    seconds: float
    outcome: Outcome


class Ledger:
    """The content of `stages.json`; written after every step, so a build can be interrupted anywhere."""

    def __init__(self, path: Path) -> None:
        self.path = path
        stored = read_json(path) if path.exists() else {}
        self.entries: dict[str, Entry] = {name: _entry(data) for name, data in stored.items()}

    def key(self, step: Step) -> str:
        """The key of the step at this moment."""
        content = [step.version, step.options, step.sources, self._before(step)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def holds(self, step: Step) -> bool:
        """Whether the step is up to date: it ran with the same input as now, and its files exist."""
        entry = self.entries.get(step.name)
        return (
            entry is not None and entry.key == self.key(step) and all(path.exists() for path in step.outputs)
        )

    def run(self, step: Step, advance: Advance) -> Entry:
        """Run the step and record it; when it fails or is interrupted, nothing is recorded."""
        if self.entries.pop(step.name, None) is not None:
            self._save()  # its files are about to change
        started = time.perf_counter()
        outcome = step.run(advance)
        seconds = time.perf_counter() - started
        entry = Entry(
            self.key(step), step.version, step.options, step.sources, self._before(step), seconds, outcome
        )
        self.entries[step.name] = entry
        self._save()
        return entry

    def keep_only(self, stage: str, items: Iterable[str]) -> None:
        """Remove the steps of a stage whose scene or object no longer exists."""
        kept = {f"{stage}/{item}" if item else stage for item in items}
        gone = [name for name in self.entries if name.split("/")[0] == stage and name not in kept]
        for name in gone:
            del self.entries[name]
        if gone:
            self._save()

    def of_stage(self, stage: str) -> dict[str, Entry]:
        """The entries of a stage, by item."""
        pairs = ((name.partition("/"), entry) for name, entry in self.entries.items())
        return {item: entry for (found, _, item), entry in pairs if found == stage}

    def _before(self, step: Step) -> dict[str, str]:
        return {name: self.entries[name].key for name in step.after if name in self.entries}

    def _save(self) -> None:
        write_json(self.path, {name: asdict(entry) for name, entry in self.entries.items()})


def _entry(data: Mapping[str, Any]) -> Entry:
    outcome = data["outcome"]
    messages = tuple(outcome["messages"])
    return Entry(**{**data, "outcome": Outcome(outcome["frames"], messages, outcome["details"])})


MANY = 64
"""Largest number of files of one kind in a folder that are listed singly; more are summed up."""


def stamps(*paths: Path, but_not: Path | None = None, names: Sequence[str] | None = None) -> Json:
    """Size and time of files, by path. For a folder, of the files in it; its images are only counted.

    More than `MANY` files of one kind in a folder, such as one per frame, are summed up: their number, their
    size, and the time of the newest.

    Args:
        but_not: a folder to skip (a workspace inside the recording).
        names: if there are folders with these names, only they are searched.
    """
    found: Json = {}
    for path in paths:
        if path.is_dir():
            found |= _folder_stamps(path, but_not, frozenset(names or ()))
        elif path.exists():
            found[str(path)] = _stamp(path)
    return found


def _folder_stamps(folder: Path, but_not: Path | None, names: frozenset[str]) -> Json:
    found: Json = {}
    for parent, folders, files in os.walk(folder):
        named = [name for name in folders if name in names]
        folders[:] = [name for name in named or folders if Path(parent, name) != but_not]
        kinds: dict[str, list[Path]] = {}
        for name in files:
            kinds.setdefault(Path(name).suffix.lower(), []).append(Path(parent, name))
        images = sum(len(kinds.pop(suffix, ())) for suffix in IMAGE_SUFFIXES)
        if images:
            found[parent] = images
        for suffix, paths in kinds.items():
            each = {str(path): _stamp(path) for path in paths}
            if len(each) > MANY:
                sizes, times = zip(*each.values(), strict=True)
                each = {str(Path(parent, f"*{suffix}")): [len(each), sum(sizes), max(times)]}
            found |= each
    return found


def _stamp(path: Path) -> list[int]:
    status = path.stat()
    return [status.st_size, status.st_mtime_ns]

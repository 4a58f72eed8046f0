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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from rpl_data.files import decoding, read_json, write_text
from rpl_data.json_arrays import Json, mapping, number, taken, text, whole
from rpl_data.json_arrays import each as list_of

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
    """What the ledger knows about a step that ran to its end.

    Attributes:
        key: stands for everything the step depended on, in the entries of the steps after it.
        folders: what was in each folder of its outputs; see `contents`. Absent in ledgers of older versions.
    """

    key: str
    version: int
    options: Json
    sources: Json
    after: dict[str, str]
    seconds: float
    outcome: Outcome
    folders: Json = field(default_factory=dict)

    @cached_property
    def text(self) -> str:
        """The entry as `stages.json` has it, made once: that file is written at every step."""
        return json.dumps(asdict(self), allow_nan=False)


class Ledger:
    """The content of `stages.json`; written after every step, so a build can be interrupted anywhere."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.entries: dict[str, Entry] = {}
        if path.exists():
            with decoding(path, "delete it, and the next build makes everything again"):
                self.entries = {name: _entry(data) for name, data in mapping(read_json(path)).items()}

    def key(self, step: Step) -> str:
        """The key of the step at this moment."""
        content = [step.version, step.options, step.sources, self._before(step)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def holds(self, step: Step) -> bool:
        """Whether the step is up to date: it ran with the same input as now, and its files exist."""
        entry = self.entries.get(step.name)
        if entry is None or entry.version != step.version or entry.after != self._before(step):
            return False
        stored = _absolute(entry.sources)
        sources = _as_counted(_absolute(step.sources), stored)
        if not (_same(_absolute(entry.options), _absolute(step.options)) and _same(stored, sources)):
            return False
        return all(_is_there(path, entry.folders.get(str(path))) for path in step.outputs)

    def renew(self, step: Step) -> None:
        """Note the images of a step that holds by their number alone, as older versions noted them."""
        entry = self.entries[step.name]
        if not _same(entry.sources, step.sources):
            self.entries[step.name] = replace(entry, sources=step.sources)
            self._save()

    def run(self, step: Step, advance: Advance) -> Entry:
        """Run the step and record it; when it fails or is interrupted, nothing is recorded."""
        self.begin(step)
        started = time.perf_counter()
        outcome = step.run(advance)
        return self.record(step, outcome, time.perf_counter() - started)

    def begin(self, step: Step) -> None:
        """Forget what is known of a step whose files are about to change."""
        if self.entries.pop(step.name, None) is not None:
            self._save()

    def record(self, step: Step, outcome: Outcome, seconds: float) -> Entry:
        """Note that a step has run to its end."""
        before, folders = self._before(step), {str(p): contents(p) for p in step.outputs if p.is_dir()}
        entry = Entry(
            self.key(step), step.version, step.options, step.sources, before, seconds, outcome, folders
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
        lines = [f"{json.dumps(name)}: {entry.text}" for name, entry in self.entries.items()]
        write_text(self.path, "{\n" + ",\n".join(lines) + "\n}\n")


def _entry(data: Any) -> Entry:
    """An entry as it was written; any fault of it is `decoding`'s to name."""
    said = taken(mapping(data), "outcome", mapping)
    messages = taken(said, "messages", list_of(text))
    outcome = Outcome(taken(said, "frames", whole), messages, taken(said, "details", mapping))
    kinds: dict[str, Callable[[Any], Any]] = {"key": text, "version": whole, "seconds": number}
    kinds |= dict.fromkeys(("options", "sources", "after"), mapping)
    fields = {name: taken(data, name, kind) for name, kind in kinds.items()}
    folders = {path: mapping(made) for path, made in mapping(data.get("folders", {})).items()}
    entry = Entry(**data | fields | {"outcome": outcome, "folders": folders})
    json.dumps(data, allow_nan=False)  # which reading allows: it could not be written again
    return entry


def _same(one: Json, other: Json) -> bool:
    """Whether two records are the same once they are written."""
    return json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)


def _absolute(record: Json) -> Json:
    """A record with absolute paths: older versions noted those of a twin as the workspace was named."""

    def of(key: str, value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [of(key, each) for each in value]
        if isinstance(value, dict):
            return _absolute(value)
        return str(Path(value).absolute()) if key == "path" else value

    return {str(Path(key).absolute()) if "/" in key else key: of(key, value) for key, value in record.items()}


def _as_counted(sources: Json, stored: Json) -> Json:
    """The sources with images only counted where an older version counted them, so that its builds hold."""
    counted = {name for name, value in stored.items() if isinstance(value, int)}
    return {name: value[0] if name in counted else value for name, value in sources.items()}


def contents(folder: Path) -> Json:
    """The files in a folder with their sizes, and number and size of all files in the folders inside it."""
    own = {path.name: path.stat().st_size for path in folder.iterdir() if path.is_file()}
    inner = [
        Path(parent, name) for parent, _, names in os.walk(folder) for name in names if parent != str(folder)
    ]
    return {"files": own, "count": len(inner), "bytes": sum(path.stat().st_size for path in inner)}


def _is_there(path: Path, made: Json | None) -> bool:
    """A file that is not empty, or a folder with at least what was made in it; others may add to it."""
    if not path.is_dir():
        empty_is_broken = path.suffix != ".jsonl"  # labels of no frame are an empty file
        return path.is_file() and (path.stat().st_size > 0 or not empty_is_broken)
    if made is None:
        return True
    now = contents(path)
    fewer = now["count"] < made["count"] or now["bytes"] < made["bytes"]
    return not fewer and all(now["files"].get(name) == size for name, size in made["files"].items())


MANY = 64
"""Largest number of files of one kind in a folder that are listed singly; more are summed up."""


def stamps(*paths: Path, but_not: Path | None = None, names: Sequence[str] | None = None) -> Json:
    """Size and time of files by absolute path; of a folder, those of its files.

    The images of a folder are summed up: their number, and a digest of their names, sizes and times. More
    than `MANY` files of another kind in a folder, such as one per frame, are summed up too: their number,
    their size, and the time of the newest.

    Args:
        but_not: a folder to skip (a workspace inside the recording).
        names: if there are folders with these names, only they are searched.
    """
    found: Json = {}
    elsewhere = None if but_not is None else but_not.absolute()
    for path in (each.absolute() for each in paths):
        if path.is_dir():
            found |= _folder_stamps(path, elsewhere, frozenset(names or ()))
        elif stamp := _stamp(path):
            found[str(path)] = stamp
    return found


def _folder_stamps(folder: Path, but_not: Path | None, names: frozenset[str]) -> Json:
    found: Json = {}
    for parent, folders, files in os.walk(folder):
        named = [name for name in folders if name in names]
        folders[:] = [name for name in named or folders if Path(parent, name) != but_not]
        kinds: dict[str, list[Path]] = {}
        for name in files:
            kinds.setdefault(Path(name).suffix.lower(), []).append(Path(parent, name))
        images = [path for suffix in IMAGE_SUFFIXES for path in kinds.pop(suffix, ())]
        if images:
            found[parent] = [len(images), _digest(images)]
        for suffix, paths in kinds.items():
            each = {str(path): stamp for path in paths if (stamp := _stamp(path))}
            if len(each) > MANY:
                sizes, times = zip(*each.values(), strict=True)
                each = {str(Path(parent, f"*{suffix}")): [len(each), sum(sizes), max(times)]}
            found |= each
    return found


def _stamp(path: Path) -> list[int]:
    """Size and time; nothing of a file that is not there, such as a link that leads nowhere."""
    try:
        status = path.stat()
    except OSError:
        return []
    return [status.st_size, status.st_mtime_ns]


def _digest(paths: Sequence[Path]) -> str:
    """Changes when one of the files is replaced, renamed or written."""
    lines = sorted(f"{path.name} {_stamp(path)}" for path in paths)
    return hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest()[:16]

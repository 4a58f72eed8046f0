"""Folders in object stores, by fsspec: recordings are copied here, exports are copied there.

A copy goes file by file and may be cut off anywhere: what a log beside it does not name is copied again, and
what has not changed is left alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from rpl_data.files import remove
from rpl_data.pipeline.ledger import Advance
from rpl_data.types import DataError

BATCH = 64
"""Files that are copied at once; after a kill, so many are copied again at most."""
MANIFEST = "rpl-manifest.json"
"""The list of an upload's files, their sizes and SHA-256; it is there when all of them are."""
MARKS = ("ETag", "etag", "md5Hash", "generation", "mtime", "LastModified", "created")
"""What stores call that which changes with a file's content, the surest first."""


def url_of(path: Path | str) -> str | None:
    """The address that a path of a recipe is; None where it is a path of this machine.

    A `Path` has lost one of the slashes.
    """
    found = re.fullmatch(r"([a-z][a-z0-9+.-]+):/+(.*)", str(path))
    if found is None:
        return None
    return f"{found[1]}://{'/' if found[1] in ('file', 'local') else ''}{found[2]}"


def without_secrets(text: str) -> str:
    """A text as it may be printed: addresses in it without keys, passwords and signatures."""
    text = re.sub(r"(://)[^/@\s]*@", r"\1...@", text)
    return re.sub(r"(://[^?\s]*)\?\S*", r"\1?...", text)


def check_address(url: str) -> None:
    """Refuse what is no address of a store that can be reached from here; nothing is asked of the store.

    Raises:
        DataError: it is a path of this machine, or the package for such stores is not installed.
    """
    import fsspec

    if url_of(url) is None:
        raise DataError(f"{url!r} is no address of an object store; expected one such as s3://bucket/cups")
    with _reaching(url):
        fsspec.get_filesystem_class(url.partition(":")[0])


def copy_name(url: str) -> Path:
    """Where a copy lies in the folder of copies: one folder per address, and in it the name at its end."""
    name = PurePosixPath(url).name
    return Path(hashlib.sha256(url.encode()).hexdigest()[:12]) / name


@contextmanager
def _reaching(url: str) -> Iterator[None]:
    """Turn whatever goes wrong with a store into a DataError: each has exceptions of its own."""
    try:
        yield
    except DataError:
        raise
    except ImportError as error:
        raise DataError(
            f"{without_secrets(url)} cannot be reached: {error}; S3 needs pip install 'rpl-data[s3]', Google "
            "Storage 'rpl-data[gs]'"
        ) from error
    except Exception as error:
        why = without_secrets(" ".join(str(error).split()))[:300] or type(error).__name__
        raise DataError(
            f"{without_secrets(url)} cannot be reached: {why}; check the address and your credentials"
        ) from error


def _opened(url: str) -> tuple[Any, str]:
    """The file system of an address, and its path there."""
    import fsspec

    options = {"auto_mkdir": True} if url.startswith(("file:", "local:")) else {}
    system, path = fsspec.core.url_to_fs(url, **options)
    system.invalidate_cache()
    return system, str(path).rstrip("/")


def _listed(system: Any, root: str) -> dict[str, tuple[int, str]]:
    """Size and mark of each file below a root by its name there; of a single file, by an empty name."""
    found = {}
    for path, info in system.find(root, detail=True).items():
        name = path[len(root) :].lstrip("/")
        if any(part in ("", ".", "..") for part in name.split("/")) and name:
            raise DataError(f"{root} has a file called {name!r}, which leads out of a folder; rename it")
        mark = next((str(info[key]) for key in MARKS if info.get(key) is not None), "")
        found[name] = int(info["size"]), mark
    return found


class _Log:
    """What was copied, one line per file; a last line that was cut off counts for nothing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.known: dict[str, Any] = {}
        for line in path.read_text().splitlines() if path.exists() else ():
            try:
                name, mark = json.loads(line)
            except ValueError:
                continue
            self.known[name] = mark

    def add(self, marks: Mapping[str, Any]) -> None:
        """Note files, now that they are whole."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as file:
            file.write("".join("\n" + json.dumps([name, mark]) for name, mark in marks.items()))
        self.known.update(marks)


def _batches(names: list[str]) -> Iterator[tuple[int, list[str]]]:
    for start in range(0, len(names), BATCH):
        yield start, names[start : start + BATCH]


def fetch(url: str, to: Path, advance: Advance) -> int:
    """Make a file or folder the copy of one in a store; how many files were copied.

    Files that are there and have not changed in the store are not copied again; those that are gone from it
    are removed.

    Raises:
        DataError: the store cannot be reached, or there is nothing at the address.
    """
    with _reaching(url):
        system, root = _opened(url)
        found = _listed(system, root)
        if not found:
            raise DataError(f"there is nothing at {without_secrets(url)}; check the address")
        log, partial = _Log(to.parent / "copied.jsonl"), to.parent / ".partial"
        marks = {name: [size, mark] for name, (size, mark) in found.items()}
        for name in log.known.keys() - marks.keys():
            remove(to / name)
        wanted = [
            name
            for name in marks
            if log.known.get(name) != marks[name] or not _is_whole(to / name, found[name][0])
        ]
        for start, batch in _batches(wanted):
            advance(start, len(wanted))
            remove(partial)
            partial.mkdir(parents=True)
            parts = [partial / str(number) for number in range(len(batch))]
            system.get([f"{root}/{name}".rstrip("/") for name in batch], list(map(str, parts)))
            for name, part in zip(batch, parts, strict=True):
                if part.stat().st_size != found[name][0]:
                    raise DataError(
                        f"{without_secrets(url)}/{name} changed while it was read; run the command again"
                    )
                (to / name).parent.mkdir(parents=True, exist_ok=True)
                if (to / name).is_dir():  # what is a file in the store now was a folder
                    remove(to / name)
                os.replace(part, to / name)
            log.add({name: marks[name] for name in batch})
        remove(partial)
    return len(wanted)


def _is_whole(path: Path, size: int) -> bool:
    return path.is_file() and path.stat().st_size == size


def upload(folder: Path, url: str, record: Path, advance: Advance) -> int:
    """Make a folder in a store the copy of one here; how many files were copied.

    Only what has changed is copied. The list of all files is removed first and written last.

    Args:
        folder: here.
        url: there.
        record: log of an upload at work; it is gone when all is there.
        advance: called with the number of files copied and of all to copy.

    Raises:
        DataError: the store cannot be reached or written.
    """
    own = {
        path.relative_to(folder).as_posix(): _digest(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    with _reaching(url):
        system, root = _opened(url)
        log, manifest = _Log(record), f"{root}/{MANIFEST}"
        if system.exists(manifest):
            log.add(_manifest(system.cat_file(manifest)))
        there = (
            {name: size for name, (size, _) in _listed(system, root).items()} if system.exists(root) else {}
        )
        wanted = [name for name in own if log.known.get(name) != own[name] or there.get(name) != own[name][0]]
        gone = [name for name in log.known if name not in own and name in there]
        if not wanted and not gone and MANIFEST in there:
            remove(record)
            return 0
        if MANIFEST in there:
            system.rm_file(manifest)
        for start, batch in _batches(wanted):
            advance(start, len(wanted))
            system.put([str(folder / name) for name in batch], [f"{root}/{name}" for name in batch])
            log.add({name: own[name] for name in batch})
        for name in gone:
            system.rm_file(f"{root}/{name}")
        system.pipe_file(manifest, json.dumps(own, indent=1).encode())
    remove(record)
    return len(wanted)


def _manifest(content: bytes) -> dict[str, Any]:
    """The files that a manifest lists; none where its own writing was cut off, so that all are copied."""
    try:
        found = json.loads(content)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _digest(path: Path) -> list[Any]:
    """Size and SHA-256 of a file."""
    with path.open("rb") as file:
        return [path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()]

"""Checksums of an export: a file `SHA256SUMS` in it tells later whether a file is still the one exported.

Its lines are those of `sha256sum`, so `sha256sum --check SHA256SUMS` reads it too. Files that others add
later, such as caches of a trainer, are not in it, and nothing is said about them.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from rpl_data.files import file_hash, read_text, remove, write_text
from rpl_data.types import DataError
from rpl_data.wording import counted

NAME = "SHA256SUMS"
EDITED = "_edited"
"""What follows the name of an export in that of the folder with files that were edited in it."""
NAMED = 3
"""Edited files named in a message."""

Inode = tuple[int, int]
"""Device and inode: the same for all hard links to a file."""


def write_checksums(folder: Path, *, beside: Path) -> None:
    """Write the checksums of all files in an export that is complete.

    Args:
        beside: an export that may share files with this one, by hard links. They are not read again where its
            checksums are known and they were not written to since.
    """
    known = _by_inode(beside)
    lines = []
    for file in _files(folder):
        status = (folder / file).stat()
        digest = known.get((status.st_dev, status.st_ino)) or file_hash(folder / file)
        lines.append(f"{digest}  {file}\n")
    write_text(folder / NAME, "".join(lines))


def read_checksums(folder: Path) -> dict[str, str]:
    """Read the checksums by file, relative to the export; none where an older version made it.

    Raises:
        DataError: a line is damaged; its number is said. Or there is none at all.
    """
    if not (folder / NAME).is_file():
        return {}
    found = {}
    for row, line in enumerate(read_text(folder / NAME).splitlines(), start=1):
        match = re.fullmatch(r"([0-9a-f]{64}) [ *](.+)", line)
        if match is None:
            raise DataError(f"{NAME} is damaged in line {row}; put it back, or export again")
        found[match[2]] = match[1]
    if not found:
        raise DataError(f"{NAME} is empty; put it back, or export again")
    return found


def edited_files(folder: Path) -> list[str]:
    """Files of an export that somebody wrote to, or added, since it was made; none without checksums.

    Only files with a newer time are read. Caches (`*.cache`), which trainers make anew, are left out.
    """
    sums = read_checksums(folder)
    if not sums:
        return []
    made_ns = (folder / NAME).stat().st_mtime_ns
    return [
        file
        for file in _files(folder)
        if not file.endswith(".cache")
        and (file not in sums or _is_newer(folder / file, made_ns) and file_hash(folder / file) != sums[file])
    ]


@contextmanager
def keeping_edited(folder: Path) -> Iterator[tuple[str, ...]]:
    """Keep what somebody edited in an export while the block makes it anew; yields lines for the user.

    Copies of those files, or links to them, go to `<folder>_edited`, or `_edited2` and so on. Where the block
    fails, the export is as it was, and so they are not needed.

    Raises:
        DataError: they cannot be copied.
    """
    what = "had been edited or added since it was exported"
    try:
        edited = edited_files(folder)
    except DataError:  # nobody can tell what was edited: all is kept
        edited, what = _files(folder), f"may have been edited, as {NAME} is damaged"
    if not edited:
        yield ()
        return
    numbers = ("" if number == 1 else str(number) for number in count(1))
    names = (folder.with_name(f"{folder.name}{EDITED}{number}") for number in numbers)
    kept = next(path for path in names if not path.exists())
    try:
        for file in edited:
            _link_or_copy(folder / file, kept / file)
        named = ", ".join(edited[:NAMED]) + (", ..." if len(edited) > NAMED else "")
        yield (
            f"{counted(len(edited), 'file')} of {folder} {what} ({named}); they are kept in {kept}. "
            "`rpl labels import` takes corrections from edited COCO files",
        )
    except BaseException:
        remove(kept)
        raise


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        os.link(source, target)
    except OSError:  # perhaps a file system without hard links
        try:
            shutil.copyfile(source, target)
        except OSError as error:
            raise DataError(
                f"cannot keep the edited {source} as {target}: {error.strerror or error}; nothing was "
                "changed. Free some space, or move the edited export elsewhere"
            ) from error


def _files(folder: Path) -> list[str]:
    """All files in a folder but the checksums, sorted."""
    found = (Path(parent, name) for parent, _, names in os.walk(folder) for name in names)
    return sorted(path.relative_to(folder).as_posix() for path in found if path != folder / NAME)


def _by_inode(folder: Path) -> Mapping[Inode, str]:
    """Checksums of the files that were not written to since; none where they cannot be read."""
    try:
        sums = read_checksums(folder)
    except DataError:
        return {}
    if not sums:
        return {}
    made_ns, known = (folder / NAME).stat().st_mtime_ns, {}
    for file, digest in sums.items():
        if (folder / file).is_file() and not _is_newer(folder / file, made_ns):
            status = (folder / file).stat()
            known[status.st_dev, status.st_ino] = digest
    return known


def _is_newer(path: Path, made_ns: int) -> bool:
    """Whether a file may have changed since: by its own time or, where it was put there, its inode's.

    A new hard link changes the inode's time as well, so that counts only where there is one link.
    """
    status = path.stat()
    return status.st_mtime_ns > made_ns or (status.st_nlink == 1 and status.st_ctime_ns > made_ns)

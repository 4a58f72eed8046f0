"""Folders of an export: built under a temporary name, and filled with copies or links."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from rpl_data.export.checksums import write_checksums
from rpl_data.files import write_bytes
from rpl_data.types import DataError
from rpl_data.wording import counted

Images = Literal["copy", "link"]
"""`copy`: no write into an export can change a recording. `link`: no space is needed, but it can."""

FICLONE = 0x40049409
"""Linux's request to let a file share the blocks of another one until either is written to."""


class Filling:
    """Puts the files of a recording into an export.

    A copy is a clone where the file system has them (Btrfs, XFS): it needs no space, and what is written into
    it later stays in it. Elsewhere it is a true copy, made once: the dialects link to the copy in `coco`.

    Attributes:
        images: how files are put there.
        counts: number of files per way: clone, copy, hard link, symlink.
        copied_bytes: space that true copies took.
    """

    def __init__(self, images: Images = "copy") -> None:
        """Start with nothing in it."""
        self.images = images
        self.counts: Counter[str] = Counter()
        self.copied_bytes = 0

    def put(self, source: Path, target: Path) -> None:
        """Give `target` the bytes of `source`, a file of a recording or of the workspace."""
        if self.images == "link":
            self.share(source, target)
            return
        how = "clone" if _clone(_found(source, target), target) else "copy"
        if how == "copy":
            shutil.copyfile(source, target)
            self.copied_bytes += target.stat().st_size
        self.counts[how] += 1

    def share(self, source: Path, target: Path) -> None:
        """Link `target` to a file that may be changed with it: one of another export."""
        self.counts[link(source, target)] += 1

    def write(self, target: Path, content: bytes) -> None:
        """Write a file whose bytes differ from those of the recording."""
        write_bytes(target, content)
        self.counts["copy"] += 1
        self.copied_bytes += len(content)

    def messages(self) -> tuple[str, ...]:
        """What the files are, where that costs space or care."""
        linked = self.counts["hard link"] + self.counts["symlink"]
        if self.images == "link" and linked:
            return (
                f"{counted(linked, 'file')} of the export are links to the recording: a program that writes "
                "into one changes the recording; `export: {images: copy}` prevents that",
            )
        if self.copied_bytes < WORTH_SAYING_BYTES:
            return ()
        return (
            f"{counted(self.counts['copy'], 'file')} were copied ({self.copied_bytes / 1e9:.1f} GB), so that "
            "no program that writes into the export changes the recording; `export: {images: link}` takes "
            "no space",
        )


WORTH_SAYING_BYTES = 10**8
"""True copies that take less are not mentioned."""


def link(source: Path, target: Path) -> str:
    """Make `target` have the same bytes as `source`, by a clone or a link where the file system allows it."""
    source = _found(source, target)
    if _clone(source, target):
        return "clone"
    for how, make in (("hard link", os.link), ("symlink", os.symlink)):
        try:
            make(source, target)
            return how
        except OSError:  # another file system, or one without such links
            continue
    shutil.copyfile(source, target)
    return "copy"


def _found(source: Path, target: Path) -> Path:
    """The file itself behind links, once the folder for `target` is there and nothing else is."""
    if not source.is_file():
        raise DataError(f"{source} is missing; put it back or read the recording again")
    target.parent.mkdir(parents=True, exist_ok=True)
    if os.path.lexists(target):  # it may be a link: writing into it would change what it links to
        raise FileExistsError(errno.EEXIST, "two images would get the name", str(target))
    return source.resolve()


def _clone(source: Path, target: Path) -> bool:
    """Make `target` a clone of `source`; whether the file system could, and if not, nothing is left."""
    import fcntl

    try:
        with source.open("rb") as given, target.open("wb") as made:
            fcntl.ioctl(made.fileno(), FICLONE, given.fileno())
        return True
    except OSError:
        target.unlink(missing_ok=True)
        return False


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces `folder`, with checksums, when the block ends well."""
    building: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        building = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.partial-"))
        building.chmod(0o755)
        yield building
        write_checksums(building, beside=folder.with_name("coco"))
        old = building.with_name(building.name + "-old")
        if folder.exists():
            folder.rename(old)
        try:
            building.rename(folder)
        except OSError:
            if old.exists():
                old.rename(folder)
            raise
        building = None
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise DataError(
            f"cannot write {folder}: {error.strerror or error}; nothing was changed. "
            "Free some space or choose another folder"
        ) from error
    finally:
        if building is not None:
            shutil.rmtree(building, ignore_errors=True)

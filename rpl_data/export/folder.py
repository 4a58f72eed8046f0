"""Folders of an export: built under a temporary name, and filled with links."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rpl_data.types import DataError


def link(source: Path, target: Path) -> str:
    """Make `target` have the same bytes as `source`, by a link where the file system allows it."""
    if not source.is_file():
        raise DataError(f"{source} is missing; put it back or read the recording again")
    source = source.resolve()
    target.parent.mkdir(parents=True, exist_ok=True)
    for how, make in (("hard link", os.link), ("symlink", os.symlink)):
        try:
            make(source, target)
            return how
        except OSError:  # another file system, or one without such links
            continue
    shutil.copyfile(source, target)
    return "copy"


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces `folder` when the block ends well."""
    building: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        building = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.partial-"))
        building.chmod(0o755)
        yield building
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

"""Write files completely or not at all, and read them with errors that name them."""

from __future__ import annotations

import codecs
import hashlib
import json
import os
import re
import shutil
import stat
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, BinaryIO, Literal

from rpl_data.types import DataError


@contextmanager
def writing(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Yield a temporary file that is renamed to `path` when the block ends well; folders are made as needed.

    Raises:
        DataError: the disk is full, or the folder cannot be written; nothing is left behind.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        encoding = None if "b" in mode else "utf-8"
        with os.fdopen(handle, mode, encoding=encoding) as file:
            yield file
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise DataError(
            f"cannot write {path}: {error.strerror or error}; nothing was changed. "
            "Free some space or choose another folder"
        ) from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


@contextmanager
def locked(path: Path, refusal: str) -> Iterator[None]:
    """Hold a lock file; the operating system releases it when the process ends, however it ends.

    Raises:
        DataError: with the text `refusal`, when another process already holds it.
    """
    import fcntl

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; choose another folder") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DataError(refusal) from error
        yield


def write_text(path: Path, text: str) -> None:
    """Write a text file completely or not at all."""
    with writing(path) as file:
        file.write(text)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a binary file completely or not at all."""
    with writing(path, "wb") as file:
        file.write(content)


def write_json(path: Path, content: Any, *, indent: int | None = 1) -> None:
    """Write a JSON file completely or not at all; NaN is refused, since JSON has none."""
    write_text(path, json.dumps(content, indent=indent, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file; DataError when it is missing or broken."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError) as error:  # also numbers of 5,000 digits and lists 5,000 deep
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path} is not valid JSON: {error}; restore it or delete it") from error


SERVED_S = 3600.0
FAULTS = (
    ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, RecursionError, TypeError, ValueError
)  # fmt: skip
"""Exceptions that Python raises where the content of a file is not what its reader expects."""


@contextmanager
def decoding(source: Path | str, remedy: str) -> Iterator[None]:
    """Turn any fault in decoding the content of a file into a DataError that names the file and the fault.

    Args:
        source: the file, with the line or record where that is known.
        remedy: what to do, as an imperative.
    """
    try:
        yield
    except DataError:
        raise
    except KeyError as error:
        raise DataError(f"{source} lacks {error.args[0]!r:.80}; {remedy}") from error
    except (*FAULTS, struct.error, zlib.error) as error:
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(f"{source} is damaged or of another version: {why}; {remedy}") from error


def refuse_special(path: Path) -> None:
    """Raise a DataError when a path is a pipe, a device or a socket, since reading it might never end.

    A folder or a missing file passes: opening it gives the error.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise DataError(f"{path} is a pipe, a device or a socket, not a file; give the file itself")


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file to read bytes from it; DataError when it is missing or cannot be read."""
    refuse_special(path)
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist") from error
    except OSError as error:
        raise _unreadable(path, error) from error


def read_bytes(path: Path) -> bytes:
    """Read a file as bytes; DataError when it is missing or cannot be read."""
    refuse_special(path)
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist") from error
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def file_hash(path: Path) -> str:
    """SHA-256 of a file, in memory that does not grow; DataError when it cannot be read."""
    digest = hashlib.sha256()
    with opened(path) as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()


MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}
"""Bytes at the start of a text that say how it is encoded; without any it is UTF-8."""


def read_text(path: Path, *, errors: Literal["strict", "replace"] = "strict") -> str:
    """Read a text file: UTF-8, or what its mark says; DataError when it is missing or not text.

    Bytes that are not text may be replaced instead, if the caller checks every line.
    """
    content = read_bytes(path)
    try:
        return text_of(content, errors=errors)
    except ValueError as error:
        raise _unreadable(path, error) from error


def text_of(content: bytes, *, errors: Literal["strict", "replace"] = "strict") -> str:
    """Decode text by its mark, and end its lines with a newline; UnicodeError where it is not text."""
    mark = next((mark for mark in MARKS if content.startswith(mark)), b"")
    text = content[len(mark) :].decode(MARKS.get(mark, "utf-8"), errors)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _unreadable(path: Path, error: OSError | ValueError) -> DataError:
    if isinstance(error, IsADirectoryError):
        return DataError(f"{path} is a folder; give a file")
    return DataError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}")


def append_bytes(path: Path, content: bytes) -> None:
    """Append complete lines to a log; they are on the disk on return, and after an error it is unchanged."""
    with path.open("ab", buffering=0) as file:  # a buffer would be written after the truncation
        end = path.read_bytes().rfind(b"\n") + 1  # anything after it is half a line, left by a crash
        file.truncate(end)
        try:
            while content:
                content = content[file.write(content) :]
            os.fsync(file.fileno())  # a confirmed click survives a power cut
        except OSError:
            file.truncate(end)
            raise


def sweep(root: Path) -> None:
    """Remove what killed builds left half-written in a workspace: files and folders with a name of `writing`.

    Call it only while nobody else builds there. What the annotation server may be writing at this moment is
    left alone until it is an hour old.
    """
    levels = ("*", "scenes/*/*", "scenes/*/cache/*/*", "objects/*/*", "labels/*", "export/*", "report/*")
    for path in (found for level in levels for found in root.glob(level) if found.name.startswith(".")):
        half_written = re.fullmatch(r"\..+\.(partial-)?[a-z0-9_]{8}(-old)?", path.name)
        served = path.parent.parent.name == "objects" or path.parent == root or ".left_out." in path.name
        with suppress(OSError):
            if half_written and not (served and time.time() - path.stat().st_mtime < SERVED_S):
                remove(path)


def remove(path: Path) -> None:
    """Delete a file or folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)

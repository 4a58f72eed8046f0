"""What is said about a fault of the program itself: one line, and the rest in a file to send along."""

from __future__ import annotations

import errno
import platform
import tempfile
import traceback
from collections.abc import Sequence
from importlib.metadata import version


def reported(error: Exception, arguments: Sequence[str]) -> str:
    """Write all about a fault to a file; the line for the person, which names it.

    Args:
        error: with the step at work as its note, where the build was at one.
        arguments: of the command.
    """
    where = next(iter(getattr(error, "__notes__", ())), arguments[0] if arguments else "rpl")
    if isinstance(error, OSError) and error.filename is not None:  # the machine's fault, not ours
        return f"cannot use {error.filename}: {error.strerror or error}; mend that and run the command again"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return f"the disk is full at {where}; free some space and run the command again"
    if isinstance(error, MemoryError):
        return f"the memory is full at {where}; close other programs, or use fewer --workers"
    about = f"rpl-data {version('rpl-data')}, Python {platform.python_version()}, {platform.platform()}"
    text = "".join(traceback.format_exception(error))
    with tempfile.NamedTemporaryFile("w", prefix="rpl-fault-", suffix=".txt", delete=False) as file:
        file.write(f"{about}\nrpl {' '.join(arguments)}\n\n{text}")
    return f"unexpected fault in {where}; please report: {file.name}"

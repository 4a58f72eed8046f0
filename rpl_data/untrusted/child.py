"""Run a function in a child process, for libraries that may crash on a damaged file.

Open3D and librealsense are written in C++ and do not check what they read: a wrong number in a file can end
the process with a signal, or exhaust the memory. In a child process, they end only that one.
"""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rpl_data.types import DataError

Result = TypeVar("Result")
MEMORY_BYTES = 16 * 2**30
"""Largest address space of a child; libraries map a few gigabytes of it that they never use."""


def in_child(
    work: Callable[..., Result],
    *arguments: Any,
    file: Path,
    limit_s: int | None = None,
    memory_bytes: int = MEMORY_BYTES,
) -> Result:
    """Run `work(*arguments)` in a child process and return its result.

    Args:
        work: a function at the top level of a module; it, its arguments and its result must be picklable.
        arguments: the arguments of `work`.
        file: the file that it reads, for the error message.
        limit_s: largest CPU time of the child, in seconds; None = no limit.
        memory_bytes: largest address space of the child.

    Raises:
        DataError: `work` raised it, or the child ended by a signal, a limit or an exception.
    """
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer"
        task = pickle.dumps((work, arguments, str(answer), limit_s, memory_bytes))
        paths = os.pathsep.join(path for path in sys.path if path)
        done = subprocess.run(
            [sys.executable, "-c", "from rpl_data.untrusted.child import _work; _work()"],
            input=task,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": paths},
        )
        if done.returncode == 0 and answer.exists():
            result, error = pickle.loads(answer.read_bytes())
            if error is not None:
                raise DataError(error)
            return result  # type: ignore[no-any-return]
    raise DataError(f"{file} is damaged: {_end(done.returncode, done.stderr)}; save or record it again")


def _end(code: int, said: bytes) -> str:
    """Describe how a child process ended."""
    if code < 0:
        return f"reading it was ended by signal {signal.Signals(-code).name}"
    lines = said.decode("utf-8", "replace").strip().splitlines()
    return f"reading it failed: {lines[-1][:200] if lines else f'status {code}'}"


def _work() -> None:
    """Run in the child: read the task from standard input, and write the answer to its file."""
    work, arguments, answer, limit_s, memory_bytes = pickle.loads(
        sys.stdin.buffer.read()
    )  # written by our own parent
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _limit(resource.RLIMIT_AS, memory_bytes, memory_bytes)
    if limit_s is not None:
        _limit(resource.RLIMIT_CPU, limit_s, limit_s + 5)
    content: tuple[Any, str | None]
    try:
        content = work(*arguments), None
    except DataError as error:
        content = None, str(error)
    Path(answer).write_bytes(pickle.dumps(content))
    os._exit(0)  # skips the destructors of libraries, which could crash after the answer is written


def _limit(kind: int, soft: int, hard: int) -> None:
    """Set a limit of this process, or keep that of its user (`ulimit`) where that is lower."""
    allowed = resource.getrlimit(kind)[1]
    if allowed != resource.RLIM_INFINITY:
        soft, hard = min(soft, allowed), min(hard, allowed)
    resource.setrlimit(kind, (soft, hard))

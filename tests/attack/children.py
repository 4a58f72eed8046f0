"""Children: what a case does happens in a process of its own, with limits, and its end is judged."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MEMORY_BYTES = 8 * 2**30
LIMIT_S = 60


@dataclass(frozen=True)
class End:
    """How a child ended.

    Attributes:
        kind: same, said, difference, traceback, signal, hang.
        text: what it printed.
    """

    kind: str
    text: str


def ended(work: Callable[[], str], *, limit_s: int = LIMIT_S) -> End:
    """Run `work` in a fork of this process; it returns the kind of its end itself.

    A signal, a fault that nobody caught, and a child that takes too long are kinds too.
    """
    with tempfile.TemporaryFile() as printed:
        child = os.fork()
        if child == 0:
            _child(work, printed.fileno(), limit_s)
        _, status = os.waitpid(child, 0)
        printed.seek(0)
        text = printed.read().decode("utf-8", "replace")
    if os.WIFSIGNALED(status):
        kind = "hang" if os.WTERMSIG(status) in (signal.SIGALRM, signal.SIGXCPU) else "signal"
        return End(kind, f"{signal.Signals(os.WTERMSIG(status)).name} {text[-500:]}")
    kind, _, rest = text.rpartition("\nEND ")
    return End(rest.strip() if os.WEXITSTATUS(status) == 0 and rest else "traceback", kind or text)


def _child(work: Callable[[], str], output: int, limit_s: int) -> None:
    faulthandler.disable()
    os.setpgid(0, 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdout = sys.stderr = os.fdopen(os.dup(output), "w", errors="replace", buffering=1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 5))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(3 * limit_s)
    code = 1
    try:
        kind = work()
        print(f"\nEND {kind}")
        code = 0
    except BaseException:  # the end is judged by the parent
        traceback.print_exc()
    with contextlib.suppress(Exception):
        sys.stdout.flush()
    os._exit(code)


def command(*arguments: str) -> int:
    """The exit status of `rpl` with these arguments, in this process."""
    from rpl_data.cli.main import main

    try:
        return main(list(arguments))
    except SystemExit as end:
        assert end.code != 2, f"no such command line: {arguments}"
        return end.code if isinstance(end.code, int) else 1


def files_in(folder: Path) -> list[Path]:
    """All files in a folder, sorted."""
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())

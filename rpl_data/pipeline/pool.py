"""Spread work over processes; results come in order, in constant memory."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from types import TracebackType
from typing import Any, TypeVar

from rpl_data.types import DataError

Result = TypeVar("Result")
RANGE = 100
"""Largest number of items per task: a finished task keeps them in memory until its turn."""
WORTH_A_POOL = 300
"""Fewer items than this are done before other processes have finished their imports."""


class Pool:
    """Worker processes, started once there is enough work for them; one worker = this process.

    Args:
        workers: number of processes; None for the number of cores.
        executor: an existing executor, such as Dask's `client.get_executor()`; it is not shut down.
    """

    def __init__(self, workers: int | None = None, executor: Executor | None = None) -> None:
        if workers is not None and workers < 1:
            raise DataError(f"workers is {workers}; give 1 or more, or leave it out for one per core")
        self.workers = workers or os.cpu_count() or 1
        self._given = executor
        self._own: ProcessPoolExecutor | None = None

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._own is not None:
            self._own.shutdown(wait=True, cancel_futures=True)

    def ranges(self, count: int) -> list[tuple[int, int]]:
        """Pairs (start, stop) that divide `count` items into tasks; a single task runs in this process."""
        if self._given is None and (self.workers == 1 or count < WORTH_A_POOL):
            return [(0, count)]
        size = min(RANGE, -(-count // self.workers))
        return [(start, min(start + size, count)) for start in range(0, count, size)]

    def stream(
        self, work: Callable[..., Iterator[Result]], tasks: Sequence[tuple[Any, ...]]
    ) -> Iterator[Result]:
        """Yield the results of all tasks in order; a single task runs here, one result at a time."""
        if len(tasks) <= 1:
            for task in tasks:
                yield from work(*task)
            return
        waiting: deque[Future[list[Result]]] = deque()
        executor = self._executor()
        try:
            for task in tasks:
                waiting.append(executor.submit(collect, work, task))
                if len(waiting) > 2 * self.workers:
                    yield from waiting.popleft().result()
            while waiting:
                yield from waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()

    def _executor(self) -> Executor:
        if self._given is not None:
            return self._given
        if self._own is None:
            # Not forked: Open3D's threads do not survive a fork.
            context = multiprocessing.get_context("spawn")
            self._own = ProcessPoolExecutor(self.workers, mp_context=context, initializer=ignore_interrupts)
        return self._own


def collect(work: Callable[..., Iterator[Result]], task: tuple[Any, ...]) -> list[Result]:
    """Collect what a task yields in a list that can be sent to another process."""
    return list(work(*task))


def ignore_interrupts() -> None:
    """Ignore Ctrl-C, which is for the process that started the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

"""Work spread over processes, its results in order and in constant memory."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from types import TracebackType
from typing import Any, TypeVar

Result = TypeVar("Result")
RANGE = 100
"""Most items a task: what a finished task keeps in memory until its turn."""
WORTH_A_POOL = 300
"""Fewer items than this are done before other processes have imported what they need."""


class Pool:
    """Processes that start when there is first enough for them to do; one worker = this process.

    Args:
        workers: how many; the number of cores when None.
        executor: one that is there already (Dask's `client.get_executor()`, say); not shut down.
    """

    def __init__(self, workers: int | None = None, executor: Executor | None = None) -> None:
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
        """Pairs (start, stop) that cut `count` items into tasks; a single one in this process."""
        if self._given is None and (self.workers == 1 or count < WORTH_A_POOL):
            return [(0, count)]
        size = min(RANGE, -(-count // self.workers))
        return [(start, min(start + size, count)) for start in range(0, count, size)]

    def stream(
        self, work: Callable[..., Iterator[Result]], tasks: Sequence[tuple[Any, ...]]
    ) -> Iterator[Result]:
        """The results of all tasks in order; a single task runs here, one result at a time."""
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
            # Not forked: Open3D's threads do not survive it.
            context = multiprocessing.get_context("spawn")
            self._own = ProcessPoolExecutor(self.workers, mp_context=context, initializer=ignore_interrupts)
        return self._own


def collect(work: Callable[..., Iterator[Result]], task: tuple[Any, ...]) -> list[Result]:
    """What a task yields, as a list that can be sent."""
    return list(work(*task))


def ignore_interrupts() -> None:
    """Ctrl-C is for the process that started the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

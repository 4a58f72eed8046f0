"""Spread work over processes; results come in order, in constant memory."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from types import TracebackType
from typing import Any, Protocol, TypeVar, runtime_checkable

from rpl_data.pipeline.ledger import Step
from rpl_data.pipeline.worker import Done, Report
from rpl_data.types import DataError

Result = TypeVar("Result")
RANGE = 100
"""Largest number of items per task: a finished task keeps them in memory until its turn."""
WORTH_A_POOL = 300
"""Fewer items than this are done before other processes have finished their imports."""


@runtime_checkable
class Engine(Protocol):
    """Other processes that run steps: `Processes` of this machine, or a `Cluster`.

    Attributes:
        near: they cost their start, and share this machine's cores.
        workers: how many tasks run at once.
        executor: runs functions there.
    """

    @property
    def near(self) -> bool: ...  # noqa: D102

    @property
    def workers(self) -> int: ...  # noqa: D102

    @property
    def executor(self) -> Executor: ...  # noqa: D102

    def submit(self, step: Step) -> Future[Done]: ...  # noqa: D102

    def reports(self) -> Iterable[Report]: ...  # noqa: D102

    def explained(self, error: Exception, name: str) -> Exception: ...  # noqa: D102

    def close(self, *, at_once: bool) -> None: ...  # noqa: D102


class Pool:
    """Worker processes, started once there is enough work for them; one worker = this process.

    In another process, a pool is that process alone.

    Args:
        workers: number of processes; None for the number of cores, or what the engine has.
        engine: a cluster, in place of processes of this machine; it is closed with the pool.
    """

    def __init__(self, workers: int | None = None, engine: Engine | None = None) -> None:
        if workers is not None and workers < 1:
            raise DataError(f"workers is {workers}; give 1 or more, or leave it out for one per core")
        self.workers = engine.workers if engine else workers or os.cpu_count() or 1
        self._engine = engine

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._engine is not None:
            self._engine.close(at_once=kind is not None)

    def __reduce__(self) -> tuple[type[Pool], tuple[int]]:
        return Pool, (1,)

    @property
    def engine(self) -> Engine:
        """The other processes, started when they are first asked for."""
        if self._engine is None:
            from rpl_data.pipeline.processes import Processes

            self._engine = Processes(self.workers)
        return self._engine

    @property
    def is_near(self) -> bool:
        """Whether the processes are, or would be, of this machine."""
        return self._engine is None or self._engine.near

    def reports(self) -> Iterable[Report]:
        """What steps in other processes said since this was last asked."""
        return () if self._engine is None else self._engine.reports()

    def explained(self, error: Exception, name: str) -> Exception:
        """What a fault of a step means for a person."""
        return error if self._engine is None else self._engine.explained(error, name)

    def is_worth(self, count: int) -> bool:
        """Whether other processes would be done sooner with so many items than this one."""
        return not self.is_near or (self.workers > 1 and count >= WORTH_A_POOL)

    def ranges(self, count: int) -> list[tuple[int, int]]:
        """Pairs (start, stop) that divide `count` items into tasks; a single task runs in this process."""
        if not self.is_worth(count):
            return [(0, count)]
        size = max(1, min(RANGE, -(-count // self.workers)))
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
        executor = self.engine.executor
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


def collect(work: Callable[..., Iterator[Result]], task: tuple[Any, ...]) -> list[Result]:
    """Collect what a task yields in a list that can be sent to another process."""
    return list(work(*task))

"""Steps on processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.queues import SimpleQueue
from multiprocessing.synchronize import Event

from rpl_data.pipeline.ledger import Step
from rpl_data.pipeline.worker import Done, EngineLost, Report, packed, run_packed

_reports: SimpleQueue[Report]
_stop: Event
"""In a worker process: where reports go, and whether the build has ended."""


class Processes:
    """Worker processes, started as they are needed."""

    near = True

    def __init__(self, workers: int) -> None:
        # Not forked: Open3D's threads do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self._reports: SimpleQueue[Report] = context.SimpleQueue()
        self._stop = context.Event()
        arguments = (self._reports, self._stop)
        self.workers = workers
        self.executor = ProcessPoolExecutor(workers, context, initializer=begin, initargs=arguments)

    def submit(self, step: Step) -> Future[Done]:
        """Run a step in one of the processes."""
        return self.executor.submit(run_here, packed(step.run), step.name)

    def reports(self) -> Iterator[Report]:
        """What steps said since this was last asked."""
        while not self._reports.empty():
            yield self._reports.get()

    def explained(self, error: Exception, name: str) -> Exception:
        """What a fault means for a person."""
        if isinstance(error, BrokenProcessPool):
            return EngineLost(
                f"a worker process was ended from outside while {name} was at work, mostly for lack of "
                "memory: use fewer `--workers` and run the command again, finished steps stay finished; in a "
                'script of your own, for lack of `if __name__ == "__main__":` before what it runs'
            )
        return error

    def close(self, *, at_once: bool) -> None:
        """End the processes; with `at_once`, steps stop at their next frame."""
        if at_once:
            self._stop.set()
        self.executor.shutdown(wait=True, cancel_futures=True)


def begin(reports: SimpleQueue[Report], stop: Event) -> None:
    """Prepare a worker process: Ctrl-C is for the one that started it, and it ends when that one does."""
    global _reports, _stop
    _reports, _stop = reports, stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A killed build must not leave processes that write into the workspace of the next one."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def run_here(content: bytes, name: str) -> Done:
    """Run a step in this worker process."""
    return run_packed(content, name, _reports.put, _stop.is_set)

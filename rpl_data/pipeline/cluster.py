"""Steps on the workers of a Dask cluster, which see recordings and workspace at the same paths.

The cluster keeps nothing: which steps are done is in the workspace's ledger alone, written by the process
that started the build. So workers, scheduler and that process may be killed at any time.
"""

from __future__ import annotations

import ctypes
import logging
import math
import re
import threading
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from rpl_data.files import read_text, remove, write_text
from rpl_data.pipeline.ledger import Step
from rpl_data.pipeline.worker import Done, EngineLost, Report, packed, run_packed
from rpl_data.types import DataError
from rpl_data.version import installed_version
from rpl_data.workspace.workspace import Workspace

CONNECT_S, WORKERS_S = 10, 60
"""How long a scheduler may take to answer, and its first worker to arrive."""
LOOK_EVERY_S = 1.0
"""How often a step looks whether its build is still the one that works in the workspace: another one, perhaps
without the cluster, cannot tell it to stop."""


class Cluster:
    """The workers of a Dask scheduler.

    Args:
        address: of the scheduler, `tcp://HOST:PORT`; or `local:N`, N processes of this machine.
        workspace: that the steps are of.

    Raises:
        DataError: the scheduler does not answer, has no workers, or these cannot do the work.
    """

    near = False

    def __init__(self, address: str, workspace: Workspace) -> None:
        self._address, self._root = address, str(workspace.root.absolute())
        self._mark: Path | None = None
        self._local, self._client = _connected(_distributed(), address)
        try:
            self._refuse_unfit()
            while sum(self._client.run(stop_steps, self._root).values()):
                time.sleep(0.2)  # what a killed build left at work here ends at its next frame
        except BaseException:
            self.close(at_once=False)
            raise
        self.workers = sum(self._client.nthreads().values())
        self.executor: Executor = self._client.get_executor(pure=False)
        self._topic, self._queue = f"rpl-{uuid.uuid4().hex}", SimpleQueue[Report]()
        self._client.subscribe_topic(self._topic, self._heard)
        self._mark = workspace.cluster_build
        write_text(self._mark, self._topic)

    def submit(self, step: Step) -> Future[Done]:
        """Run a step on one of the workers; on another one where that is lost."""
        return self.executor.submit(run_on_worker, packed(step.run), step.name, self._root, self._topic)

    def _heard(self, event: tuple[float, Any]) -> None:
        name, done, total = event[1]
        self._queue.put((name, done, total))

    def reports(self) -> Iterator[Report]:
        """What steps said since this was last asked."""
        while not self._queue.empty():
            yield self._queue.get()

    def explained(self, error: Exception, name: str) -> Exception:
        """What a fault means for a person."""
        if isinstance(error, CancelledError):
            return EngineLost(
                f"the Dask scheduler {self._address} was lost while {name} was at work; start it and its "
                "workers again, and run the command again: finished steps stay finished"
            )
        if isinstance(error, _distributed().KilledWorker):
            return DataError(
                f"{name} was tried on several workers, and each died of it, mostly for lack of memory; start "
                "workers with more, or fewer on each machine"
            )
        return error

    def close(self, *, at_once: bool) -> None:
        """Leave the cluster; with `at_once`, steps stop at their next frame."""
        if self._mark is not None:
            with suppress(OSError):
                remove(self._mark)
        if at_once and self._client.status == "running":
            with suppress(Exception):  # whatever is lost meanwhile: the next build asks again
                self._client.run(stop_steps, self._root)
        self._client.close()
        if self._local is not None:
            self._local.close()

    def _refuse_unfit(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise DataError(
                f"the Dask scheduler {self._address} has no workers; start some: `dask worker "
                f"{self._address} --nworkers 4 --nthreads 1`"
            ) from error
        for worker, (version, sees) in self._client.run(what_it_has, self._root).items():
            if version != installed_version():
                raise DataError(
                    f"worker {worker} has rpl-data {version}, and this is {installed_version()}; install the "
                    "same version on both"
                )
            if not sees:
                raise DataError(
                    f"worker {worker} does not see the workspace {self._root}; put it on a file system that "
                    "all workers mount at the same path"
                )


def _distributed() -> Any:
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise DataError(
            "--dask needs the package distributed, which is not installed: pip install 'rpl-data[dask]'"
        ) from error
    return distributed


def _connected(distributed: Any, address: str) -> tuple[Any, Any]:
    """The cluster of this machine, if one was asked for, and the client."""
    local = re.fullmatch(r"local:([1-9]\d*)", address)
    if local is not None:
        cluster = distributed.LocalCluster(
            n_workers=int(local[1]),
            threads_per_worker=1,
            memory_limit=0,  # no step is ended for its memory that would not be without Dask
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        )
        return cluster, distributed.Client(cluster, set_as_default=False)
    if "://" not in address:
        raise DataError(f"--dask {address}: expected tcp://HOST:PORT of a scheduler, or local:N")
    try:
        return None, distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # TypeError: tls:// without certificates
        raise DataError(
            f"no Dask scheduler answers at {address}: {error}; start one with `dask scheduler`, and give the "
            "address that it says"
        ) from error


# On a worker --------------------------------------------------------------------------------------

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt, of malloc.h."""
KEPT_BYTES, LARGEST_BYTES = 128 << 20, 32 << 20
"""Free memory that a worker keeps, and the largest piece that it takes from there: the most that malloc
would choose by itself."""

_at_work: list[tuple[str, threading.Event]] = []
"""Of each step that this worker is running: its workspace, and what is set to stop it."""


def run_on_worker(content: bytes, name: str, root: str, topic: str) -> Done:
    """Run a step in this worker."""
    from distributed import get_worker

    keep_freed_memory()
    worker, mine = get_worker(), (root, threading.Event())
    mark, looked_s = Workspace(Path(root)).cluster_build, -math.inf

    def is_stopped() -> bool:
        nonlocal looked_s
        if time.monotonic() - looked_s >= LOOK_EVERY_S:
            looked_s = time.monotonic()
            if not mark.is_file() or read_text(mark) != topic:
                mine[1].set()
        return mine[1].is_set()

    _at_work.append(mine)
    try:
        return run_packed(content, name, lambda said: worker.log_event(topic, said), is_stopped)
    finally:
        _at_work.remove(mine)


def keep_freed_memory() -> None:
    """Have this process keep memory for its next array, as one that Dask did not start does.

    Dask's nannies start workers with MALLOC_TRIM_THRESHOLD_=65536, so that every array of an image's size is
    taken from the kernel anew and page by page: a sixth of the CPU time of a build.
    """
    with suppress(OSError, AttributeError, TypeError):  # where malloc is not glibc's, nothing is to be done
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, LARGEST_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


def stop_steps(root: str) -> int:
    """Tell the steps of a workspace to stop; how many are still at work."""
    mine = [stop for other, stop in _at_work if other == root]
    for stop in mine:
        stop.set()
    return len(mine)


def what_it_has(root: str) -> tuple[str, bool]:
    """The version of rpl-data here, and whether this worker sees a workspace."""
    return installed_version(), Path(root).is_dir()

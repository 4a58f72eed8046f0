"""A step at work in another process: it says how far it is, and stops when it is told to."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable
from typing import Any

from rpl_data.pipeline.ledger import Outcome
from rpl_data.types import DataError

REPORT_EVERY_S = 0.5
"""A step says how far it is at most this often: each report travels to the process that started the build."""

Report = tuple[str, int, int]
"""Name of a step, frames done, frames in all."""
Done = tuple[Outcome, float]
"""What a step returned, and the seconds it took."""


class Stopped(Exception):
    """The build that started this step has ended; nothing half-written remains."""


class EngineLost(DataError):
    """The processes that ran steps are gone; no step can go on."""


def packed(run: Callable[..., Any]) -> bytes:
    """What a step does, as bytes for another process: a function within a function, with what it knows."""
    import cloudpickle

    return bytes(cloudpickle.dumps(run))


def run_packed(
    content: bytes, name: str, report: Callable[[Report], None], is_stopped: Callable[[], bool]
) -> Done:
    """Run what was packed of a step.

    Raises:
        Stopped: `is_stopped()` became true.
    """
    if is_stopped():
        raise Stopped(name)
    run = pickle.loads(content)
    started = reported = time.perf_counter()

    def advance(done: int, total: int) -> None:
        nonlocal reported
        if is_stopped():
            raise Stopped(name)
        now = time.perf_counter()
        if now - reported >= REPORT_EVERY_S:
            reported = now
            report((name, done, total))

    report((name, 0, 0))
    outcome = run(advance)
    return outcome, time.perf_counter() - started

"""Builds started from the page: one at a time, reported to every page, stopped on request."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal

from rpl_data.annotate.news import News
from rpl_data.annotate.work import Tell
from rpl_data.types import DataError, UnsureError

STAGES = ("segment", "label", "export", "report")
"""Stages that can be started; earlier stages that are out of date run as well. The last makes everything."""
TELL_EVERY_S = 0.2

FIND = "find"
"""The job that places a known object in a scene without clicks."""
OPEN = "open"
"""The job that reads a recording into a workspace of its own."""

Run = Callable[[str, Tell], list[str]]
State = Literal["running", "stopping", "done", "failed", "stopped", "unsure"]


class Stopped(Exception):
    """The user stopped the job."""


@dataclass(frozen=True)
class Job:
    """The state of a build.

    Attributes:
        number: number of the job on this server.
        stage: the last stage that was requested.
        what: the stage and the scene or object being processed; `done` of `total` frames, total 0 = unknown.
        lines: the results, for the user.
        error: what went wrong and what to do.
        scene: where an object is looked for; empty for a build.
        frame, keypoint: the click that would tell, where the job ended unsure.
    """

    number: int
    stage: str
    state: State = "running"
    what: str = ""
    done: int = 0
    total: int = 0
    lines: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0
    scene: str = ""
    frame: int | None = None
    keypoint: int | None = None

    @property
    def at_work(self) -> bool:
        """Whether it has not ended yet."""
        return self.state in ("running", "stopping")


class Jobs:
    """The job of a workspace: the running one, or the last one."""

    def __init__(self, run: Run, news: News) -> None:
        self._build, self._news = run, news
        self._lock = threading.Lock()
        self._job: Job | None = None
        self._told_s = 0.0

    def now(self) -> Job | None:
        """The running job, or how the last one ended."""
        return self._job

    def start(self, stage: str) -> Job:
        """Run what is out of date up to a stage, in its own thread.

        Raises:
            DataError: there is no such stage, or a job is already running.
        """
        if stage not in STAGES:
            raise DataError(f"there is no job {stage!r}; expected one of {', '.join(STAGES)}")
        return self.start_work(stage, partial(self._build, stage))

    def start_work(self, stage: str, work: Callable[[Tell], list[str]], *, scene: str = "") -> Job:
        """Run some work in its own thread.

        Args:
            stage: what it is called.
            scene: where an object is looked for.

        Raises:
            DataError: a job is already running.
        """
        with self._lock:
            if self._job is not None and self._job.at_work:
                raise DataError(f"the job {self._job.stage} is running; wait until it ends, or stop it first")
            number = 1 if self._job is None else self._job.number + 1
            self._job = Job(number, stage, scene=scene)
        self._tell()
        threading.Thread(target=self._run, args=(work,), daemon=True).start()
        return self._job

    def stop(self) -> Job | None:
        """Ask the job to stop; what it finished stays."""
        with self._lock:
            if self._job is not None and self._job.state == "running":
                self._job = replace(self._job, state="stopping")
        self._tell()
        return self._job

    def _run(self, work: Callable[[Tell], list[str]]) -> None:
        started = time.perf_counter()
        try:
            lines = tuple(work(self._progress))
            self._end(started, state="done", lines=lines)
        except Stopped:
            self._end(started, state="stopped")
        except UnsureError as error:
            self._end(started, state="unsure", error=str(error), frame=error.frame, keypoint=error.keypoint)
        except DataError as error:
            self._end(started, state="failed", error=str(error))
        except Exception as error:  # a bug: the page stays open and says where to look
            traceback.print_exc()
            text = f"{type(error).__name__}: {error}; this is a bug, see the terminal for where it occurred"
            self._end(started, state="failed", error=text)

    def _progress(self, what: str, done: int, total: int) -> None:
        with self._lock:
            assert self._job is not None
            if self._job.state == "stopping":
                raise Stopped
            self._job = replace(self._job, what=what, done=done, total=total)
        if time.monotonic() - self._told_s > TELL_EVERY_S:
            self._tell()

    def _end(self, started: float, **changes: Any) -> None:
        with self._lock:
            assert self._job is not None
            self._job = replace(self._job, seconds=round(time.perf_counter() - started, 1), **changes)
        self._tell()

    def _tell(self) -> None:
        self._told_s = time.monotonic()
        if self._job is not None:
            self._news.tell("job", asdict(self._job))

"""Notices what other programs do to the workspace, builds and clicks, and tells the open pages."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rpl_data.annotate.session import Session
from rpl_data.files import read_json
from rpl_data.json_arrays import Json
from rpl_data.types import DataError

EVERY_S = 2.0


class Watch:
    """Looks at the ledger and the logs of clicks every few seconds, in a thread of its own.

    Args:
        at_work: whether a job of this server is running, which writes the ledger too.
    """

    def __init__(self, session: Session, at_work: Callable[[], bool]) -> None:
        self._session, self._at_work = session, at_work
        self._closed = threading.Event()
        self._stamp, self._steps = self._stamp_now(), self._steps_now()
        self._revisions: dict[str, int] = {}

    def start(self) -> None:
        """Look until `close`."""
        threading.Thread(target=self._run, daemon=True).start()

    def close(self) -> None:
        """End the thread."""
        self._closed.set()

    def own(self) -> None:
        """Take the ledger as it is now for our own."""
        self._stamp, self._steps = self._stamp_now(), self._steps_now()

    def look(self) -> None:
        """Tell the pages what changed since the last look."""
        self._look_at_clicks()
        if self._at_work() or self._stamp_now() == self._stamp:
            return
        before = self._steps
        self.own()
        changed = [name for name, entry in self._steps.items() if before.get(name) != entry]
        self._session.forget()
        self._session.news.tell("built", changed)

    def _look_at_clicks(self) -> None:
        for name, number in self._session.revisions().items():
            if self._revisions.get(name) != number:  # a page that knows it already hears nothing new
                self._session.news.tell("object", name, number)
            self._revisions[name] = number

    def _run(self) -> None:
        while not self._closed.wait(EVERY_S):
            try:
                self.look()
            except DataError:
                continue  # a file is being replaced, or the workspace is: requests say what is wrong

    def _stamp_now(self) -> tuple[int, int] | None:
        try:
            status = self._session.workspace.stages_file.stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_size

    def _steps_now(self) -> Json:
        """The entries of the ledger, by step; none while it cannot be read."""
        try:
            return dict(read_json(self._session.workspace.stages_file))
        except (DataError, TypeError, ValueError):
            return {}

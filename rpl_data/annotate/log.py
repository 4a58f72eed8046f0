"""The server's log of one object: revisions and conflicts; nothing is confirmed before it is saved."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from rpl_data.annotate.actions import LOCAL, checked
from rpl_data.annotate.stores.scenes import SceneStore
from rpl_data.clicks.log import Annotation, Event, effective, replay
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


class Conflict(DataError):
    """Another page changed what this action relies on, so it was not saved."""


class NotSaved(DataError):
    """The action could not be written to disk."""


@dataclass(frozen=True)
class Revision:
    """The state of a log after a number of events.

    Attributes:
        number: number of events in the log.
        undo, redo: events that the next undo takes back and the next redo restores; None = nothing.
    """

    number: int
    annotation: Annotation
    undo: Event | None
    redo: Event | None


class ObjectLog:
    """Reads and extends the log of an object; other processes may extend the file too."""

    def __init__(self, workspace: Workspace, name: str, scenes: SceneStore) -> None:
        self.workspace, self.name, self.scenes = workspace, name, scenes
        self._lock = threading.RLock()
        self._stamp: tuple[int, int] | None = None
        self._events: list[Event] = []
        self._current = Revision(0, Annotation(name, (), ()), None, None)

    def now(self) -> Revision:
        """The state of the log on disk."""
        with self._lock:
            stamp = self._stamp_now()
            if stamp != self._stamp:
                self._take(self.workspace.load_events(self.name))
                self._stamp = stamp
            return self._current

    def append(self, actions: Sequence[dict[str, object]], *, seen: int) -> Revision:
        """Save actions of a page that last saw revision `seen`; they are safely on disk on return.

        An action that is already in the log (its answer was lost, so it was sent again) is skipped.

        Raises:
            Conflict: what they rely on has changed since.
            NotSaved: the log could not be written.
            DataError: an action is not valid here.
        """
        with self._lock:
            before = self.now()
            known = {event["id"] for event in self._events[-500:] if "id" in event}
            new = [action for action in actions if _id_of(action) not in known]
            self._refuse_conflict(new, seen)
            for action in new:
                self._append_one(action)
            return self.now() if new else before

    def _append_one(self, action: dict[str, object]) -> None:
        event = checked(action, self.now().annotation, self.scenes)
        if (known_as := _id_of(action)) is not None:
            event["id"] = known_as
        event["time_s"] = round(time.time(), 3)
        replay(self.name, [*self._events, event])  # an event that cannot be replayed never enters
        try:
            self.workspace.append_events(self.name, [event])
        except DataError as error:
            raise NotSaved(str(error)) from error
        self._take([*self._events, event])
        self._stamp = self._stamp_now()

    def _refuse_conflict(self, actions: Sequence[dict[str, object]], seen: int) -> None:
        """Clicks may overlap with other clicks; undo and renumbering must have seen everything."""
        since = self._events[seen:] if seen <= len(self._events) else [{"op": "?"}]
        both = [event.get("op") for event in (*since, *actions)]
        if since and actions and any(op not in LOCAL for op in both):
            raise Conflict(
                f"{self.name} was changed elsewhere in the meantime; this was not saved. "
                "Look at what is there now, and do it again if you still want it"
            )

    def _take(self, events: list[Event]) -> None:
        done, undone = effective(self.name, events)
        self._events = events
        self._current = Revision(
            len(events),
            replay(self.name, events),
            done[-1] if done else None,
            undone[-1] if undone else None,
        )

    def _stamp_now(self) -> tuple[int, int] | None:
        try:
            status = self.workspace.clicks_file(self.name).stat()
        except FileNotFoundError:
            return None
        return status.st_size, status.st_mtime_ns


def _id_of(action: dict[str, object]) -> str | None:
    """What a page calls an action, to know it again; None where it has no name that could be one."""
    found = action.get("id")
    return found[:60] if isinstance(found, str) else None

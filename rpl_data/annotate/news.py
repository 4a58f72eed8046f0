"""Report changes to all open pages as server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator

HEARTBEAT_S = 10.0
"""Interval of the heartbeat: a page that hears nothing for longer has lost the connection."""
MOST_LISTENERS = 64
"""Every one costs a little of every click; no person has so many pages open."""
MOST_WAITING = 500
"""Messages for a page that does not read them; then its stream ends, and it asks for everything anew."""


class News:
    """Messages that any thread can send; pages receive them in the server's event loop."""

    def __init__(self) -> None:
        self._listeners: dict[asyncio.Queue[str | None], asyncio.AbstractEventLoop] = {}

    def tell(self, kind: str, *what: object) -> None:
        """Send a message to all pages, without waiting for slow ones."""
        message = f"data: {json.dumps([kind, *what])}\n\n"
        for queue, loop in list(self._listeners.items()):
            loop.call_soon_threadsafe(_put, queue, message)

    @property
    def is_full(self) -> bool:
        """No further page can listen."""
        return len(self._listeners) >= MOST_LISTENERS

    def close(self) -> None:
        """End all streams, so that the server can stop."""
        for queue, loop in list(self._listeners.items()):
            loop.call_soon_threadsafe(_put, queue, None)

    async def stream(self) -> AsyncIterator[str]:
        """Yield the messages sent from now on, with a heartbeat."""
        queue: asyncio.Queue[str | None] = asyncio.Queue(MOST_WAITING)
        self._listeners[queue] = asyncio.get_running_loop()
        try:
            yield 'data: ["hello"]\n\n'
            while True:
                try:
                    message = await asyncio.wait_for(queue.get(), HEARTBEAT_S)
                except TimeoutError:
                    message = 'data: ["beat"]\n\n'
                if message is None:
                    return
                yield message
        finally:
            del self._listeners[queue]


def _put(queue: asyncio.Queue[str | None], message: str | None) -> None:
    """Queue a message; a queue that is full is emptied and its stream ended."""
    if queue.full() or message is None:
        while not queue.empty():
            queue.get_nowait()
        message = None
    queue.put_nowait(message)

"""Changes, told to all open pages as server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator

HEARTBEAT_S = 10.0
"""A page that hears nothing for longer knows that the connection is gone."""


class News:
    """Told from any thread, heard in the event loop of the server."""

    def __init__(self) -> None:
        self._listeners: dict[asyncio.Queue[str | None], asyncio.AbstractEventLoop] = {}

    def tell(self, kind: str, *what: object) -> None:
        """Tell all pages; slow ones are not waited for."""
        message = f"data: {json.dumps([kind, *what])}\n\n"
        for queue, loop in list(self._listeners.items()):
            loop.call_soon_threadsafe(queue.put_nowait, message)

    def close(self) -> None:
        """End all streams, so that the server can stop."""
        for queue, loop in list(self._listeners.items()):
            loop.call_soon_threadsafe(queue.put_nowait, None)

    async def stream(self) -> AsyncIterator[str]:
        """What is told from now on, with a heartbeat."""
        queue: asyncio.Queue[str | None] = asyncio.Queue()
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

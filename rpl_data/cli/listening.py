"""Where a page is served: its socket, and what serves it."""

from __future__ import annotations

import errno
import socket
from dataclasses import replace
from typing import TYPE_CHECKING

from rpl_data.annotate import Address
from rpl_data.types import DataError

if TYPE_CHECKING:
    from starlette.types import ASGIApp
    from uvicorn import Server

NEXT_PORTS = 20
"""So many ports behind the one asked for are tried when it is taken."""


def listening(address: Address) -> tuple[socket.socket, Address]:
    """A socket that listens, and where: at the next free port when the one asked for is taken.

    Raises:
        DataError: the address cannot be listened on.
    """
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    for port in range(address.port, min(address.port + NEXT_PORTS, 65536)):
        try:
            taken = socket.create_server((address.host, port), family=family)
        except OSError as error:
            why = error
            if error.errno == errno.EADDRINUSE:
                continue
            break
        # A socket made here names no protocol, so asyncio would leave Nagle's delay on: 40 ms per answer.
        taken.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return taken, replace(address, port=port)
    raise DataError(
        f"cannot listen on {address.host} port {address.port}: {why.strerror or why}; choose another --port"
    ) from why


def server_of(app: ASGIApp) -> Server:
    """What serves an application."""
    import uvicorn

    config = uvicorn.Config(
        app, log_level="warning", access_log=False, timeout_graceful_shutdown=1, ws="none"
    )
    return uvicorn.Server(config)

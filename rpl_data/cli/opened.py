"""Workspaces that are opened from the page: each is served at a port of its own, by this process."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from rpl_data.annotate import Address
from rpl_data.annotate.opening import Opening
from rpl_data.annotate.work import Tell
from rpl_data.cli.annotate import work_of
from rpl_data.cli.listening import listening, server_of
from rpl_data.cli.new_recipe import recipe_for
from rpl_data.pipeline.build import build
from rpl_data.pipeline.progress import Progress
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

if TYPE_CHECKING:
    from starlette.types import ASGIApp
    from uvicorn import Server

    from rpl_data.annotate.session import Session

MOST = 12
"""Workspaces served at once."""


class Opened:
    """The workspaces that one `rpl annotate` serves.

    Args:
        address: where the first one is; the others get the next free ports, and the same token.
        folder: what pages may open lies below it; None where they may open nothing.
    """

    def __init__(self, address: Address, folder: Path | None) -> None:
        self._address = address
        self._opening = Opening(folder, self.port_of, take_in)
        self._lock = threading.Lock()
        self._ports: dict[Path, int] = {}
        self._running: list[tuple[Server, Session, threading.Thread]] = []

    def app(self, workspace: Path, address: Address) -> tuple[Session, ASGIApp]:
        """The application of a workspace; DataError when this is none."""
        from rpl_data.annotate.server import make_app
        from rpl_data.annotate.session import Session

        root = Workspace(workspace)
        session = Session(root, work_of(root))
        app = make_app(session, address, self._opening)
        self._ports.setdefault(workspace.resolve(), address.port)
        return session, app

    def port_of(self, workspace: Path) -> int:
        """The port of a workspace, which is served from now on.

        Raises:
            DataError: this is no workspace, or too many are open.
        """
        with self._lock:
            if workspace not in self._ports:
                if len(self._ports) >= MOST:
                    raise DataError(f"{MOST} workspaces are open already; start `rpl annotate` again")
                self._serve(workspace)
            return self._ports[workspace]

    def _serve(self, workspace: Path) -> None:
        taken, address = listening(replace(self._address, port=self._address.port + 1))
        try:
            session, app = self.app(workspace, address)
        except BaseException:
            taken.close()
            raise
        server = server_of(app)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [taken]}, daemon=True)
        self._running.append((server, session, thread))
        thread.start()

    def close(self) -> None:
        """End the servers of all workspaces but the first."""
        for server, session, _ in self._running:
            session.close()
            server.should_exit = True
        for _, _, thread in self._running:
            thread.join(timeout=5)


def take_in(recording: Path, workspace: Path, name: str, keypoints: str, tell: Tell) -> list[str]:
    """Read a recording into a new workspace, as `rpl import` of it does; what the steps had to say."""
    lines: list[str] = []

    def told(progress: Progress) -> None:
        tell(f"{progress.stage} {progress.item}".strip(), progress.done, progress.total)
        if progress.state == "ran":
            lines.extend(progress.outcome.messages)

    tell(f"looking at {recording.name}", 0, 0)
    recipe = recipe_for(recording, workspace, object=name or None, keypoints=keypoints or None)
    build(recipe, Workspace(workspace), until="clicks", tell=told)
    return lines


def folder_of(workspace: Path, address: Address, folder: Path | None) -> Path | None:
    """The folder below which pages may open: the one given, else on this machine that around the workspace.

    Raises:
        DataError: there is no such folder.
    """
    if folder is not None and not folder.is_dir():
        raise DataError(f"--folder {folder}: there is no such folder; name the one that the page may open")
    if folder is not None or address.token is not None:
        return folder
    return workspace.resolve().parent


def serve(
    workspace: Path,
    address: Address,
    taken: socket.socket,
    *,
    folder: Path | None = None,
    ready: Callable[[], None],
) -> None:
    """Serve the page until Ctrl-C.

    Args:
        workspace: its folder.
        address: where `taken` listens.
        taken: the socket.
        folder: what the page may open lies below it; see `folder_of`.
        ready: called when the workspace was found to be one.

    Raises:
        DataError: this is no workspace.
    """
    opened = Opened(address, folder_of(workspace, address, folder))
    session, app = opened.app(workspace, address)
    server = server_of(app)
    exits = server.handle_exit

    def end(number: int, frame: FrameType | None) -> None:
        session.close()  # first the streams of open pages, which would be cut off with an error each
        exits(number, frame)

    server.handle_exit = end  # type: ignore[assignment, method-assign]
    ready()
    try:
        server.run(sockets=[taken])
    finally:
        opened.close()
    raise KeyboardInterrupt  # only a signal ends it, and asyncio sometimes swallows the exception of Ctrl-C

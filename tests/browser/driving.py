"""Driving the page: the server as a process, places in the image, what was saved."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, expect

from rpl_data.workspace.workspace import Workspace

SHOWN = '#picture[data-frame]:not([data-frame=""])'
"""The picture, once a frame is drawn on it."""


class Server:
    """`rpl annotate` in a process of its own."""

    def __init__(self, workspace: Path) -> None:
        self.workspace = workspace
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/"
        self.start()

    def start(self) -> None:
        command = [
            sys.executable,
            "-m",
            "rpl_data.cli.main",
            "annotate",
            str(self.workspace),
            "--port",
            str(self.port),
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        for _ in range(600):
            try:
                urllib.request.urlopen(self.url, timeout=5).close()
                return
            except OSError:
                assert self.process.poll() is None, "the server ended"
                time.sleep(0.1)
        raise AssertionError("the server did not answer")

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


class ServerHere:
    """The same application in a thread of the tests: it starts at once, but cannot be killed."""

    def __init__(self, workspace: Path) -> None:
        from rpl_data.cli.annotate import address_of
        from rpl_data.cli.listening import server_of
        from rpl_data.cli.opened import Opened

        self.workspace = workspace
        taken = socket.create_server(("127.0.0.1", 0))
        place = address_of("127.0.0.1", taken.getsockname()[1])
        self.url = place.url
        self.opened = Opened(place, workspace.parent)
        self.server = server_of(self.opened.app(workspace, place)[1])
        self.thread = threading.Thread(target=self.server.run, kwargs={"sockets": [taken]})
        self.thread.start()

    def kill(self) -> None:
        self.opened.close()
        self.server.should_exit = True
        self.thread.join()


def toured(url: str) -> Any:
    """The cookie of a browser that has seen the tour of the page."""
    return {"name": "rpl_tour", "value": "seen", "url": url}


def is_ours(url: str, server: Server | ServerHere) -> bool:
    return url.startswith((server.url, "data:", "blob:"))


def wait_until(page: Page, condition: str, *, arg: Any = None, timeout_ms: float = 30_000) -> None:
    """Wait until a condition `({ app }, arg) => ...` on the page's state holds.

    It may not be async: Playwright takes the promise for a yes.
    """
    page.evaluate("async () => { window.store = await import('/static/state/store.js'); }")
    page.wait_for_function(f"(arg) => ({condition})(window.store, arg)", arg=arg, timeout=timeout_ms)


def view(page: Page) -> dict[str, float]:
    """Zoom, and where the image's corner is in the page."""
    return page.evaluate(
        """async () => {
            const { view } = await import("/static/image/view.js");
            const box = document.getElementById("marks").getBoundingClientRect();
            return { zoom: view.zoom, x: box.x + view.left, y: box.y + view.top };
        }"""
    )


def zoom_to(page: Page, zoom: float, u: float, v: float) -> None:
    """Zoom at a pixel with the wheel until the page says that it is enough, then exactly."""
    page.mouse.move(*on_page(page, u, v))
    while view(page)["zoom"] < zoom:
        page.mouse.wheel(0, -120)
        page.wait_for_timeout(30)
    x, y = on_page(page, u, v)
    page.evaluate(
        """async ([zoom, x, y]) => {
            const { view } = await import("/static/image/view.js");
            const { zoomBy } = await import("/static/image/canvas.js");
            const box = document.getElementById("marks").getBoundingClientRect();
            zoomBy(zoom / view.zoom, x - box.x, y - box.y);
        }""",
        [zoom, x, y],
    )


def on_page(page: Page, u: float, v: float) -> tuple[float, float]:
    at = view(page)
    return (u + 0.5) * at["zoom"] + at["x"], (v + 0.5) * at["zoom"] + at["y"]


def saved(page: Page) -> None:
    expect(page.locator("#saved")).to_have_text("all saved")


def clicks(server: Server | ServerHere) -> dict[tuple[int, str, int], tuple[float, float]]:
    annotation = Workspace(server.workspace).load_annotation("carton")
    return {(c.keypoint, c.scene, c.frame): (c.u_px, c.v_px) for c in annotation.clicks}


def place(page: Page, u: float, v: float) -> None:
    page.mouse.click(*on_page(page, u, v))
    saved(page)


def in_plot(page: Page, point_mm: tuple[float, float, float]) -> tuple[float, float]:
    """Where a point of the 3D view is on the page, by the matrices it is drawn with."""
    x, y = page.evaluate(
        """(point) => {
            const plot = document.getElementById("plot"), scene = plot._fullLayout.scene._scene;
            const { model, view, projection } = scene.glplot.cameraParams, box = plot.getBoundingClientRect();
            const by = (m, v) => [0, 1, 2, 3].map((r) => v.reduce((sum, x, i) => sum + m[4 * i + r] * x, 0));
            const scaled = [...point.map((value, i) => value * scene.dataScale[i]), 1];
            const [u, v, , w] = by(projection, by(view, by(model, scaled)));
            return [box.x + (0.5 + u / w / 2) * box.width, box.y + (0.5 - v / w / 2) * box.height];
        }""",
        list(point_mm),
    )
    return x, y

"""Show what the camera sees in the browser: colour and depth side by side, as a stream of JPEG images."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from rpl_data.capture.camera import Shot
from rpl_data.types import DataError

HOST = "127.0.0.1"
RATE_HZ = 10.0
HEIGHT = 360
FAR_M = 2.0
"""Depth that is shown in the colour for the largest distance."""

PAGE = """<!doctype html><meta charset="utf-8"><title>rpl capture</title>
<style>body{margin:0;background:#111;color:#eee;font:22px sans-serif;text-align:center}
img{max-width:100%}p{margin:.6em}</style>
<img src="/stream" alt="colour and depth"><p id="word">waiting for the camera</p>
<script>
setInterval(async () => {
  const word = document.getElementById("word");
  try { word.textContent = await (await fetch("/word")).text(); }
  catch { word.textContent = "the recording has ended"; }
}, 250);
</script>"""


class Preview:
    """A web page on this machine, served while the block lasts; `show` receives the images."""

    def __init__(self, port: int, *, metres_per_unit: float = 0.001) -> None:
        self.url = f"http://{HOST}:{port}/"
        self.metres_per_unit = metres_per_unit
        self._port = port
        self._word = "waiting for the camera"
        self._jpeg = b""
        self._shown_at = 0.0
        self._news = threading.Condition()
        self._open = True

    def show(self, shot: Shot, word: str) -> None:
        """Show an image; those that come faster than `RATE_HZ` only update the status line."""
        self._word = word
        now = time.monotonic()
        if now - self._shown_at < 1 / RATE_HZ:
            return
        self._shown_at = now
        picture = side_by_side(shot.color, shot.depth, self.metres_per_unit)
        jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        with self._news:
            self._jpeg = jpeg
            self._news.notify_all()

    def __enter__(self) -> Preview:
        import uvicorn

        config = uvicorn.Config(
            self._app(), log_level="warning", access_log=False, timeout_graceful_shutdown=1, ws="none"
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, args=([_listening(self._port)],), daemon=True
        )
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False
        with self._news:
            self._news.notify_all()
        self._server.should_exit = True
        self._thread.join()

    def _app(self) -> Any:
        from fastapi import FastAPI
        from fastapi.responses import HTMLResponse, PlainTextResponse, StreamingResponse
        from starlette.middleware.trustedhost import TrustedHostMiddleware

        app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
        # A foreign site must not reach this camera under a host name that resolves to this machine.
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
        parts = "multipart/x-mixed-replace; boundary=frame"
        app.add_api_route("/", lambda: HTMLResponse(PAGE))
        app.add_api_route("/word", lambda: PlainTextResponse(self._word))
        app.add_api_route("/stream", lambda: StreamingResponse(self._parts(), media_type=parts))
        return app

    def _parts(self) -> Iterator[bytes]:
        """Yield every new image as a part of the stream."""
        last = b""
        while self._open:
            with self._news:
                if self._jpeg is last:
                    self._news.wait(timeout=1.0)
                if self._jpeg is last:
                    continue
                last = self._jpeg
            yield b"--frame\r\nContent-Type: image/jpeg\r\n\r\n" + last + b"\r\n"


def side_by_side(
    color: UInt8[np.ndarray, "height width 3"],
    depth: UInt16[np.ndarray, "rows columns"],
    metres_per_unit: float,
) -> UInt8[np.ndarray, "shown wide 3"]:
    """Colour beside depth, `HEIGHT` rows high, RGB; near is red, far is blue, no depth is black."""
    scale = HEIGHT / color.shape[0]
    small = cv2.resize(color, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    raw = cv2.resize(depth, (small.shape[1], small.shape[0]), interpolation=cv2.INTER_NEAREST)
    nearness = 255 - np.clip(raw * (metres_per_unit / FAR_M * 255), 0, 255)
    painted = cv2.applyColorMap(nearness.astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    painted = np.where(raw[..., None] > 0, painted, 0).astype(np.uint8)
    return np.concatenate([small, painted], axis=1)


def _listening(port: int) -> Any:
    import socket

    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise DataError(
            f"cannot show the preview at {HOST} port {port}: {error.strerror or error}; choose another --port"
        ) from error

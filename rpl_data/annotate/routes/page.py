"""The page itself, plotly.js out of its package, and the stream of changes."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse, StreamingResponse
from fastapi.staticfiles import StaticFiles

from rpl_data.annotate.session import Session

STATIC = Path(__file__).parents[1] / "static"

KEEP = {"Cache-Control": "private, max-age=3600"}
"""A recording's pictures do not change during a session; later, their stamp is compared."""


def add_page(app: FastAPI, session: Session) -> None:
    """The page itself, plotly.js out of its package, and the stream of changes."""

    @app.get("/")
    def page() -> FileResponse:
        return FileResponse(STATIC / "index.html", headers={"Cache-Control": "no-cache"})

    @app.get("/plotly.js")
    def plotly() -> FileResponse:
        import plotly as package

        return FileResponse(Path(package.__file__).parent / "package_data" / "plotly.min.js", headers=KEEP)

    @app.get("/api/news")
    async def news() -> StreamingResponse:
        if session.news.is_full:
            raise HTTPException(503, "too many pages are open; close some of them")
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(session.news.stream(), media_type="text/event-stream", headers=headers)

    app.mount("/static", StaticFiles(directory=STATIC))

"""The web server of the annotation page: routes only. What they do is in the modules beside it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, JSONResponse, Response, StreamingResponse
from fastapi.staticfiles import StaticFiles
from pydantic import BaseModel
from starlette.middleware.gzip import GZipMiddleware

from rpl_data.annotate.clicks_routes import clicks_routes
from rpl_data.annotate.contact_routes import contact_routes
from rpl_data.annotate.guard import Guard
from rpl_data.annotate.images import depth_tile
from rpl_data.annotate.job_routes import job_routes
from rpl_data.annotate.log import Conflict, NotSaved
from rpl_data.annotate.model_routes import model_routes
from rpl_data.annotate.payload import Json, object_payload, result_payload, scene_payload
from rpl_data.annotate.scenes import poses_table
from rpl_data.annotate.session import Session
from rpl_data.annotate.solid_routes import solid_routes
from rpl_data.annotate.work import Place
from rpl_data.types import DataError

STATIC = Path(__file__).parent / "static"
KEEP = {"Cache-Control": "private, max-age=3600"}
"""Pictures of a recording do not change while one looks at it; afterwards their stamp is compared."""


class Actions(BaseModel):
    """What a page did, having seen a revision of the object's log."""

    seen: int
    actions: list[dict[str, Any]]


class NewObject(BaseModel):
    """An object to be added."""

    name: str
    keypoints: list[str]


def make_app(session: Session, place: Place) -> FastAPI:
    """The application of one workspace, behind its guard."""

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        yield
        session.close()

    app = FastAPI(lifespan=life, openapi_url=None, docs_url=None, redoc_url=None)
    app.add_middleware(GZipMiddleware, minimum_size=800, compresslevel=5)
    app.add_middleware(Guard, place=place)
    for kind, status in ((Conflict, 409), (NotSaved, 507), (DataError, 422)):
        app.add_exception_handler(kind, _answer(status))
    _add_scenes(app, session)
    _add_objects(app, session)
    app.include_router(solid_routes(session))
    app.include_router(clicks_routes(session))
    app.include_router(job_routes(session))
    app.include_router(contact_routes(session))
    app.include_router(model_routes(session))
    _add_page(app, session)
    return app


def _answer(status: int) -> Callable[[Request, Exception], JSONResponse]:
    def answer(request: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"error": str(error)}, status)

    return answer


def _add_page(app: FastAPI, session: Session) -> None:
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
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(session.news.stream(), media_type="text/event-stream", headers=headers)

    app.mount("/static", StaticFiles(directory=STATIC))


def _add_scenes(app: FastAPI, session: Session) -> None:
    @app.get("/api/workspace")
    def workspace() -> Json:
        return {
            "name": session.workspace.root.resolve().name,
            "scenes": session.scenes.names(),
            "objects": session.objects(),
        }

    @app.get("/api/scenes/{scene}")
    def scene_of(scene: str) -> Json:
        return scene_payload(session.scenes.get(scene))

    @app.get("/api/scenes/{scene}/poses")
    def poses(scene: str) -> Response:
        table = poses_table(session.scenes.get(scene))
        return Response(table.astype("<f4").tobytes(), media_type="application/octet-stream", headers=KEEP)

    @app.get("/api/scenes/{scene}/frames/{frame:int}.jpg")
    def picture(request: Request, scene: str, frame: int, width: int = 0) -> Response:
        stamp = session.pictures.stamp(scene, frame)
        headers = {**KEEP, "ETag": stamp}
        if request.headers.get("if-none-match") == stamp:
            return Response(status_code=304, headers=headers)
        content = session.pictures.jpeg(scene, frame, max(0, width))
        return Response(content, media_type="image/jpeg", headers=headers)

    @app.get("/api/scenes/{scene}/frames/{frame}.depth")
    def depth(scene: str, frame: int, column: int, row: int) -> Response:
        units = session.scenes.get(scene).scene.metres_per_unit
        content = depth_tile(session.scenes.depth_m(scene, frame), units, column, row)
        return Response(content, media_type="application/octet-stream", headers=KEEP)

    @app.get("/api/scenes/{scene}/frames/{frame}.look.jpg")
    def look(scene: str, frame: int, u_px: float, v_px: float) -> Response:
        content = session.pictures.look(scene, frame, u_px, v_px)
        return Response(content, media_type="image/jpeg", headers=KEEP)

    @app.get("/api/scenes/{scene}/frames/{frame}.mask.png")
    def mask(scene: str, frame: int, object: str) -> Response:
        content = session.masks.png(scene, frame, object)
        headers = {"Cache-Control": "no-cache"}
        if content is None:
            return Response(status_code=204, headers=headers)
        return Response(content, media_type="image/png", headers=headers)


def _add_objects(app: FastAPI, session: Session) -> None:
    @app.post("/api/objects")
    def add(new: NewObject) -> Json:
        session.add_object(new.name, new.keypoints)
        return {"objects": session.objects()}

    @app.get("/api/objects/{name}")
    def state(name: str) -> Json:
        return object_payload(session.log(name).now())

    @app.post("/api/objects/{name}")
    def act(name: str, done: Actions) -> Json:
        return object_payload(session.act(name, done.actions, seen=done.seen))

    @app.get("/api/objects/{name}/result")
    def result(name: str) -> Json:
        return result_payload(session.result(name), session.scenes.names())

    @app.get("/api/objects/{name}/suggestions/{scene}")
    def suggestions(name: str, scene: str) -> list[Json]:
        return [asdict(found) for found in session.suggestions(name, scene)]

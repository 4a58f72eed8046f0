"""The web server of the annotation page: it only wires up the routes and the guard."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.middleware.gzip import GZipMiddleware

from rpl_data.annotate.guard import Guard
from rpl_data.annotate.log import Conflict, NotSaved
from rpl_data.annotate.opening import Opening
from rpl_data.annotate.routes.clicks import clicks_routes
from rpl_data.annotate.routes.contact import contact_routes
from rpl_data.annotate.routes.jobs import job_routes
from rpl_data.annotate.routes.models import model_routes
from rpl_data.annotate.routes.objects import add_objects
from rpl_data.annotate.routes.opening import opening_routes
from rpl_data.annotate.routes.page import add_page
from rpl_data.annotate.routes.scenes import add_scenes
from rpl_data.annotate.routes.solid import solid_routes
from rpl_data.annotate.session import Session
from rpl_data.annotate.work import Address
from rpl_data.types import DataError


def make_app(session: Session, address: Address, opening: Opening | None = None) -> FastAPI:
    """Make the application of one workspace, behind its guard.

    Args:
        opening: what its page may open besides; nothing when None.
    """

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        for does in session.when_opened:
            does()
        yield
        session.close()

    app = FastAPI(lifespan=life, openapi_url=None, docs_url=None, redoc_url=None)
    app.add_middleware(GZipMiddleware, minimum_size=800, compresslevel=5)
    app.add_middleware(Guard, address=address)
    for kind, status in ((Conflict, 409), (NotSaved, 507), (DataError, 422)):
        app.add_exception_handler(kind, _answer(status))
    app.add_exception_handler(RequestValidationError, _name_fields)
    add_scenes(app, session)
    add_objects(app, session)
    app.include_router(solid_routes(session))
    app.include_router(clicks_routes(session))
    jobs, routes = job_routes(session)
    app.include_router(routes)
    if opening is not None:
        app.include_router(opening_routes(session, opening, jobs))
    app.include_router(contact_routes(session))
    app.include_router(model_routes(session))
    add_page(app, session)
    return app


def _answer(status: int) -> Callable[[Request, Exception], JSONResponse]:
    def answer(request: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"error": str(error)}, status)

    return answer


def _name_fields(request: Request, error: Exception) -> JSONResponse:
    """Which fields of a request are wrong, in words; what was sent is not sent back."""
    assert isinstance(error, RequestValidationError)
    faults = [f"{'.'.join(map(str, fault['loc'][1:]))}: {fault['msg']}" for fault in error.errors()[:5]]
    return JSONResponse({"error": f"the request is wrong: {'; '.join(faults)}"}, 422)

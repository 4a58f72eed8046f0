"""Routes of the 3D view."""

from __future__ import annotations

from fastapi import APIRouter

from rpl_data.annotate.session import Session
from rpl_data.annotate.surfaces import (
    SurfaceStore,
    dense_payload,
    surface_payload,
    surroundings,
)
from rpl_data.json_arrays import Json


def solid_routes(session: Session) -> APIRouter:
    """Routes: scene surfaces near an object, and its dense model."""
    routes = APIRouter()
    store = SurfaceStore(session.scenes)

    @routes.get("/api/objects/{name}/surfaces/{scene:path}")
    def surface(name: str, scene: str) -> Json | None:
        ball = surroundings(session.result(name, checked=False), scene)
        if ball is None:
            return None
        clicked = [c.frame for c in session.log(name).now().annotation.clicks if c.scene == scene]
        frames = [found.frame for found in session.suggestions(name, scene)]
        return surface_payload(store.near(scene, ball, sorted({*clicked[:2], *frames})))

    @routes.get("/api/objects/{name}/dense")
    def dense(name: str) -> Json | None:
        session.log(name)
        return dense_payload(session.workspace, name)

    return routes

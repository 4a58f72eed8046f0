"""Routes of scenes: their frames, depth, poses and masks."""

from __future__ import annotations

from fastapi import FastAPI, Request
from fastapi.responses import Response
from pydantic import FiniteFloat

from rpl_data.annotate.payload import scene_payload
from rpl_data.annotate.routes.page import KEEP
from rpl_data.annotate.session import Session
from rpl_data.annotate.stores.pictures import depth_tile
from rpl_data.annotate.stores.scenes import poses_table
from rpl_data.json_arrays import Json


def add_scenes(app: FastAPI, session: Session) -> None:
    """Routes of the scenes: their list, poses, pictures, depth and masks."""

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
        headers = {"Cache-Control": "no-cache"}  # a build may correct them
        content = table.astype("<f4").tobytes()
        return Response(content, media_type="application/octet-stream", headers=headers)

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
    def look(scene: str, frame: int, u_px: FiniteFloat, v_px: FiniteFloat) -> Response:
        content = session.pictures.look(scene, frame, u_px, v_px)
        return Response(content, media_type="image/jpeg", headers=KEEP)

    @app.get("/api/scenes/{scene}/frames/{frame}.mask.png")
    def mask(scene: str, frame: int, object: str) -> Response:
        content = session.masks.png(scene, frame, object)
        headers = {"Cache-Control": "no-cache"}
        if content is None:
            return Response(status_code=204, headers=headers)
        return Response(content, media_type="image/png", headers=headers)

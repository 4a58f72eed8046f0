"""Routes of the contact sheet."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter
from fastapi.responses import Response
from pydantic import BaseModel

from rpl_data.annotate.contact import ContactSheet
from rpl_data.annotate.session import Session
from rpl_data.json_arrays import Json
from rpl_data.types import DataError


class LeftOut(BaseModel):
    """Whether a frame is excluded from the exported dataset."""

    frame: int
    left_out: bool


def contact_routes(session: Session) -> APIRouter:
    """Routes: labelled frames, labels as pictures, and the frames excluded from the export."""
    routes = APIRouter()
    sheet = ContactSheet(session)

    @routes.get("/api/labels/{scene}")
    def frames(scene: str) -> Json:
        found = sheet.frames(scene)
        left_out = session.workspace.load_left_out(session.workspace.parts().video_of(scene))
        return {"frames": [asdict(item) | {"left_out": item.frame in left_out} for item in found]}

    @routes.get("/api/labels/{scene}/{frame}.jpg")
    def picture(scene: str, frame: int, width: int = 320, whole: bool = False) -> Response:
        content = sheet.jpeg(scene, frame, width, whole=whole)
        return Response(content, media_type="image/jpeg", headers={"Cache-Control": "no-cache"})

    @routes.post("/api/labels/{scene}")
    def leave_out(scene: str, wanted: LeftOut) -> Json:
        if wanted.frame not in {item.frame for item in sheet.frames(scene)}:
            raise DataError(f"scene {scene} has no label of frame {wanted.frame}")
        video = session.workspace.parts().video_of(scene)
        left_out = set(session.workspace.load_left_out(video))
        (left_out.add if wanted.left_out else left_out.discard)(wanted.frame)
        session.workspace.save_left_out(video, left_out)
        session.news.tell("left_out", scene)
        return frames(scene)

    return routes

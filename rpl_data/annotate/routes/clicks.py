"""Routes to export and import clicks as a file."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse, Response
from pydantic import BaseModel

from rpl_data.annotate.session import Session
from rpl_data.clicks.log import events_to
from rpl_data.clicks.table import clicks_from_csv, clicks_to_csv
from rpl_data.json_arrays import Json


class ClicksFile(BaseModel):
    """A CSV file that the user chose."""

    name: str
    text: str


def clicks_routes(session: Session) -> APIRouter:
    """Routes: export the clicks, and read a file into the actions that would add its clicks."""
    routes = APIRouter()

    @routes.get("/api/objects/{name}/clicks.csv")
    def export(name: str) -> Response:
        annotation = session.log(name).now().annotation
        text = clicks_to_csv(annotation.clicks, annotation.keypoints)
        return PlainTextResponse(text, media_type="text/csv", headers={"Cache-Control": "no-store"})

    @routes.post("/api/objects/{name}/clicks/read")
    def read(name: str, file: ClicksFile) -> Json:
        annotation = session.log(name).now().annotation
        clicks = clicks_from_csv(
            file.text, source=file.name, object_name=name, keypoints=annotation.keypoints
        )
        for click in clicks:
            session.scenes.refuse_outside(click)
        return {"actions": events_to(annotation, annotation.keypoints, clicks)}

    return routes

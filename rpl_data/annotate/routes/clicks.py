"""Routes to export and import clicks as a file."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse, Response
from pydantic import BaseModel

from rpl_data.annotate.session import Session
from rpl_data.clicks.incoming import incoming
from rpl_data.clicks.table import clicks_from_csv, clicks_to_csv
from rpl_data.json_arrays import Json


class ClicksFile(BaseModel):
    """A CSV file that the user chose."""

    name: str
    text: str


def clicks_routes(session: Session) -> APIRouter:
    """Routes: export the clicks, and read a file into the actions that add its clicks or replace others."""
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
        found = {
            name: incoming(annotation, annotation.keypoints, clicks, replaces=replaces)
            for name, replaces in (("add", False), ("replace", True))
        }
        said = {
            name: {"actions": list(change.events), "says": str(change), "removed": change.removed}
            for name, change in found.items()
        }
        return {**said, "clicks": len(clicks)}

    return routes

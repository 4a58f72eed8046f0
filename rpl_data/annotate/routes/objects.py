"""Routes of objects: their clicks, results and suggestions."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fastapi import FastAPI
from pydantic import BaseModel

from rpl_data.annotate.payload import object_payload, result_payload
from rpl_data.annotate.session import Session
from rpl_data.json_arrays import Json


class Actions(BaseModel):
    """Actions of a page, and the revision of the object's log that it last saw."""

    seen: int
    actions: list[dict[str, Any]]


class NewObject(BaseModel):
    """An object to be added."""

    name: str
    keypoints: list[str]


def add_objects(app: FastAPI, session: Session) -> None:
    """Routes of the objects: their logs, results and suggestions."""

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
    def result(name: str, checked: bool = True) -> Json:
        return result_payload(session.result(name, checked=checked), session.scenes.names())

    @app.get("/api/objects/{name}/suggestions/{scene:path}")
    def suggestions(name: str, scene: str) -> list[Json]:
        return [asdict(found) for found in session.suggestions(name, scene)]

"""Routes that open another workspace, or a recording, below the folder that the server may open."""

from __future__ import annotations

from functools import partial

from fastapi import APIRouter
from pydantic import BaseModel

from rpl_data.annotate.jobs import OPEN, Jobs
from rpl_data.annotate.opening import Opening, is_workspace
from rpl_data.annotate.session import Session
from rpl_data.json_arrays import Json
from rpl_data.types import DataError


class Wanted(BaseModel):
    """What is to be opened; object and keypoints of a recording may be empty."""

    path: str
    object: str = ""
    keypoints: str = ""


def opening_routes(session: Session, opening: Opening, jobs: Jobs) -> APIRouter:
    """Routes: list the workspaces that can be opened, and open one or read a recording."""
    routes = APIRouter()

    @routes.get("/api/opening")
    def listed() -> Json:
        if opening.folder is None:
            return {"folder": None, "workspaces": []}
        folder, here = opening.folder.resolve(), session.workspace.root.resolve()
        found = [
            {"path": str(path), "name": str(path.relative_to(folder)), "here": path == here}
            for path in opening.workspaces()
        ]
        return {"folder": str(folder), "workspaces": found}

    @routes.post("/api/opening")
    def open_it(wanted: Wanted) -> Json:
        path = opening.allowed(wanted.path)
        if is_workspace(path):
            return {"port": opening.serve(path)}
        if not path.exists():
            raise DataError(f"there is nothing at {path}; give a workspace or a recording that is there")
        workspace = opening.new_workspace(path)
        if workspace.exists():
            there = f"{workspace}, where the workspace of {path.name} belongs, is there already"
            raise DataError(f"{there}: open that, or move it away")
        said = wanted.object.strip(), wanted.keypoints.strip()
        jobs.start_work(OPEN, partial(opening.take_in, path, workspace, *said))
        return {"workspace": str(workspace)}

    return routes

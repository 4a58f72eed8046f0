"""Routes to load a known model, and to export the sparse model as a file."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, Response
from pydantic import FiniteFloat
from starlette.concurrency import run_in_threadpool

from rpl_data.annotate.model import MESHES, given_mesh_payload, keep_mesh, read_known_points
from rpl_data.annotate.session import Session
from rpl_data.files import remove
from rpl_data.formats.models.sparse_model import points_in_first_scene, write_sparse_model
from rpl_data.json_arrays import Json
from rpl_data.types import DataError


def model_routes(session: Session) -> APIRouter:
    """Routes: load a known model or a mesh, and export the sparse model."""
    routes = APIRouter()

    @routes.post("/api/objects/{name}/model")
    async def load(request: Request, name: str, file: str, metres_per_unit: FiniteFloat = 1.0) -> Json:
        content = await request.body()
        return await run_in_threadpool(read, name, file, content, metres_per_unit)

    def read(name: str, file: str, content: bytes, metres_per_unit: float) -> Json:
        annotation = session.log(name).now().annotation
        if not 1e-6 <= metres_per_unit <= 1e3:
            raise DataError(f"{metres_per_unit} is not a unit; expected metres per unit: 1, or 0.001 for mm")
        if Path(file).suffix.lower() in MESHES:
            keep_mesh(session.workspace, name, file, content, metres_per_unit=metres_per_unit)
            session.news.tell("mesh", name)
            return {"actions": []}
        actions = read_known_points(file, content, annotation, metres_per_unit=metres_per_unit)
        return {"actions": actions}

    @routes.get("/api/objects/{name}/given")
    def given(name: str) -> Json | None:
        session.log(name)
        return given_mesh_payload(session.workspace, name)

    @routes.delete("/api/objects/{name}/given")
    def forget(name: str) -> Json:
        session.log(name)
        remove(session.workspace.given_mesh_file(name))
        session.news.tell("mesh", name)
        return {}

    @routes.get("/api/objects/{name}/sparse_model.txt")
    def sparse_model(name: str) -> Response:
        result = session.result(name)
        solution = result.live.solution
        if solution is None:
            raise DataError(f"{name} has no model yet; mark its keypoints first")
        world_from_object = solution.scene_from_object[min(solution.scene_from_object)]
        grasp = None if result.grasp is None else world_from_object @ result.grasp
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "sparse_model.txt"
            write_sparse_model(path, points_in_first_scene(solution), grasp)
            text = path.read_text()
        return PlainTextResponse(text, headers={"Cache-Control": "no-store"})

    return routes

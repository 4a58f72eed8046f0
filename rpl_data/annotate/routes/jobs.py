"""Routes to start, stop and watch builds."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

from fastapi import APIRouter
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel

from rpl_data.annotate.jobs import FIND, Jobs
from rpl_data.annotate.session import Session
from rpl_data.annotate.watch import Watch
from rpl_data.annotate.work import Tell
from rpl_data.json_arrays import Json
from rpl_data.types import DataError


class Wanted(BaseModel):
    """A job that the user requested: a stage, or to find an object in a scene."""

    stage: str
    object: str = ""
    scene: str = ""


def job_routes(session: Session) -> tuple[Jobs, APIRouter]:
    """The jobs of a session, and routes: start, stop and watch a build."""
    routes = APIRouter()

    def run(stage: str, tell: Tell) -> list[str]:
        try:
            return session.work.run(stage, tell)
        finally:
            session.forget()
            watch.own()

    def at_work() -> bool:
        job = jobs.now()
        return job is not None and job.at_work

    jobs = Jobs(run, session.news)
    watch = Watch(session, at_work)
    session.when_opened.append(watch.start)
    session.when_closed += [jobs.stop, watch.close]

    def state() -> Json:
        job = jobs.now()
        unmarked = [name for name in session.objects() if not session.log(name).now().annotation.clicks]
        return {"job": None if job is None else asdict(job), "unmarked": unmarked}

    @routes.get("/api/jobs")
    def now() -> Json:
        return {**state(), "fresh": {} if at_work() else dict(session.work.fresh())}

    @routes.get("/api/report.html")
    def report() -> Response:
        """Sent as a file: on a page of this server its own scripts would not run."""
        path = session.workspace.report
        if not path.exists():
            raise DataError("there is no report yet; make it first")
        name = f"{session.workspace.root.resolve().name}_report.html"
        return FileResponse(path, filename=name, headers={"Cache-Control": "no-store"})

    @routes.post("/api/jobs")
    def start(wanted: Wanted) -> Json:
        if wanted.stage == FIND:
            session.log(wanted.object)
            session.scenes.get(wanted.scene)
            find = partial(session.find, wanted.object, wanted.scene)
            jobs.start_work(FIND, find, scene=wanted.scene)
        else:
            jobs.start(wanted.stage)
        return state()

    @routes.delete("/api/jobs")
    def stop() -> Json:
        jobs.stop()
        return state()

    return jobs, routes

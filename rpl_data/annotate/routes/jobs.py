"""Routes to start, stop and watch builds."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

from fastapi import APIRouter
from pydantic import BaseModel

from rpl_data.annotate.jobs import FIND, Jobs
from rpl_data.annotate.session import Session
from rpl_data.annotate.work import Tell
from rpl_data.json_arrays import Json


class Wanted(BaseModel):
    """A job that the user requested: a stage, or to find an object in a scene."""

    stage: str
    object: str = ""
    scene: str = ""


def job_routes(session: Session) -> APIRouter:
    """Routes: start, stop and watch a build."""
    routes = APIRouter()

    def run(stage: str, tell: Tell) -> list[str]:
        try:
            return session.work.run(stage, tell)
        finally:
            session.scenes.forget()

    jobs = Jobs(run, session.news)
    session.when_closed.append(jobs.stop)

    def state() -> Json:
        job = jobs.now()
        unmarked = [name for name in session.objects() if not session.log(name).now().annotation.clicks]
        return {"job": None if job is None else asdict(job), "unmarked": unmarked}

    @routes.get("/api/jobs")
    def now() -> Json:
        job = jobs.now()
        at_work = job is not None and job.at_work
        return {**state(), "fresh": {} if at_work else dict(session.work.fresh())}

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

    return routes

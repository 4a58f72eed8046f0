"""Builds from the page: one at a time, with progress, stopped when asked, errors in words; the crop box."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from annotate_client import act, client_of
from built_once import moved_copy
from fastapi.testclient import TestClient

from rpl_data.annotate.jobs import Jobs
from rpl_data.annotate.news import News
from rpl_data.annotate.work import Tell
from rpl_data.files import locked
from rpl_data.meshes import load_cloud, load_mesh
from rpl_data.pipeline.ledger import Ledger
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def root(plain_build: Path, tmp_path: Path) -> Path:
    """A workspace that is built to its labels, its recording beside it."""
    workspace = Workspace(moved_copy(plain_build, tmp_path / "plain") / "ws")
    ledger = Ledger(workspace.stages_file)
    for stage in ("export", "report"):
        ledger.keep_only(stage, ())
    return workspace.root


@pytest.fixture
def client(root: Path) -> TestClient:
    return client_of(root)


def jobs_that(run: Callable[[str, Tell], list[str]]) -> Jobs:
    return Jobs(run, News())


def ended(jobs: Jobs) -> Any:
    for _ in range(3000):
        job = jobs.now()
        if job is not None and not job.at_work:
            return job
        time.sleep(0.01)
    raise AssertionError("the job does not end")


def wait(client: TestClient) -> Any:
    for _ in range(1800):
        state = client.get("/api/jobs").json()
        if state["job"]["state"] not in ("running", "stopping"):
            return state
        time.sleep(0.1)
    raise AssertionError("the job does not end")


def test_a_job_says_where_it_is_and_what_came_out() -> None:
    go, at = threading.Event(), threading.Event()

    def run(stage: str, tell: Tell) -> list[str]:
        tell("label 00", 3, 10)
        at.set()
        assert go.wait(30)
        return [f"{stage} is there"]

    jobs = jobs_that(run)
    jobs.start("label")
    assert at.wait(30)
    now = jobs.now()
    assert now is not None and (now.what, now.done, now.total, now.state) == ("label 00", 3, 10, "running")
    with pytest.raises(DataError, match="the job label is running"):
        jobs.start("export")
    go.set()
    assert (ended(jobs).state, ended(jobs).lines) == ("done", ("label is there",))
    assert jobs.start("export").number == 2


def test_a_job_stops_at_its_next_word() -> None:
    def run(stage: str, tell: Tell) -> list[str]:
        for number in range(1000):
            tell("label 00", number, 1000)
            time.sleep(0.01)
        return []

    jobs = jobs_that(run)
    jobs.start("label")
    jobs.stop()
    job = ended(jobs)
    assert job.state == "stopped" and job.done < 900


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (DataError("scene 03 shares too little; click more"), "click more"),
        (KeyError("x"), "this is a bug, see the terminal"),
    ],
)
def test_what_went_wrong_is_said(error: Exception, words: str) -> None:
    def run(stage: str, tell: Tell) -> list[str]:
        raise error

    jobs = jobs_that(run)
    jobs.start("export")
    assert ended(jobs).state == "failed" and words in ended(jobs).error


def test_the_page_is_told_what_is_up_to_date(client: TestClient) -> None:
    state = client.get("/api/jobs").json()
    assert state["job"] is None and state["unmarked"] == []
    assert state["fresh"]["segment"] and state["fresh"]["label"] and not state["fresh"].get("export")
    mark = client.get("/api/objects/carton").json()["clicks"][0]
    act(client, {**mark, "op": "move", "u_px": mark["u_px"] + 0.25})
    assert not client.get("/api/jobs").json()["fresh"].get("segment")
    act(client, {"op": "undo"})
    assert client.get("/api/jobs").json()["fresh"]["label"], "what was undone again makes nothing old"


def test_an_error_of_a_stage_reaches_the_page(root: Path, client: TestClient) -> None:
    client.post("/api/objects", json={"name": "cup", "keypoints": ["rim", "handle", "foot"]})
    assert client.get("/api/jobs").json()["unmarked"] == ["cup"]
    assert client.post("/api/jobs", json={"stage": "label"}).status_code == 200
    state = wait(client)
    assert state["job"]["state"] == "failed" and "object cup has no clicks" in state["job"]["error"]
    assert client.post("/api/jobs", json={"stage": "format"}).status_code == 422


def test_a_crop_box_cuts_the_dense_model_and_nothing_before_it(root: Path, client: TestClient) -> None:
    workspace = Workspace(root)
    whole = load_mesh(workspace.mesh_file("carton")).vertices
    low, high = whole.min(axis=0) - 0.02, whole.max(axis=0) + 0.02
    axis = int(np.argmax(high - low))
    high[axis] = whole[:, axis].mean() + 0.02
    before = workspace.surface_file("00").stat().st_mtime_ns
    act(client, {"op": "crop", "low_m": low.tolist(), "high_m": high.tolist()})
    client.post("/api/jobs", json={"stage": "segment"})
    assert wait(client)["job"]["state"] == "done"
    assert workspace.surface_file("00").stat().st_mtime_ns == before
    points = load_cloud(workspace.cloud_file("carton")).points
    assert (points <= high).all() and (points >= low).all()
    assert points[:, axis].max() > high[axis] - 0.01  # cut at the box, not elsewhere


def test_two_builds_never_run_in_one_workspace(root: Path) -> None:
    client = client_of(root)
    with locked(Workspace(root).build_lock, "held"):
        client.post("/api/jobs", json={"stage": "export"})
        state = wait(client)
    assert state["job"]["state"] == "failed" and "another build is running" in state["job"]["error"]

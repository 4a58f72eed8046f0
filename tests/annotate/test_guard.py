"""What the server refuses before and behind its routes: other pages, numbers that are none, too much."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from annotate_client import OBJECT, act, click, client_of
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient

from rpl_data.annotate import guard
from rpl_data.annotate.news import MOST_LISTENERS, MOST_WAITING, News

LOOK = "/api/scenes/00/frames/0.look.jpg"
FOREIGN = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
NO_NUMBERS = ["nan", "NaN", "inf", "-Infinity", "1e999"]


@pytest.fixture
def client(root: Path) -> TestClient:
    return client_of(root)


def routes_of(client: TestClient) -> Iterator[APIRoute]:
    waiting = list(client.app.routes)  # type: ignore[attr-defined]
    while waiting:
        route = waiting.pop()
        waiting += getattr(route, "routes", None) or getattr(
            getattr(route, "original_router", None), "routes", []
        )
        if isinstance(route, APIRoute):
            yield route


def test_no_route_takes_a_number_that_is_not_finite(client: TestClient) -> None:
    asked = 0
    for route in routes_of(client):
        path = route.path.replace(":int", "").replace(":path", "").format(scene="00", frame=0, name="carton")
        numbers = [p.name for p in route.dependant.query_params if "float" in str(p.field_info.annotation)]
        for name in numbers:
            for value in NO_NUMBERS:
                answer = client.request(
                    next(iter(route.methods)), path, params={"file": "a.ply", name: value}
                )
                assert answer.status_code == 422 and name in answer.json()["error"], (path, value)
                asked += 1
    assert asked >= 3 * len(NO_NUMBERS), "the routes with numbers were not found"


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999", "1" + 400 * "0", "9" * 5000])
def test_no_body_brings_one_in(client: TestClient, root: Path, value: str) -> None:
    log = (root / "objects/carton/clicks.jsonl").read_bytes()
    one = json.dumps({"seen": 0, "actions": [click(0, 1.0, 2.0)]})
    for body in (one.replace("1.0", value), one.replace('"seen": 0', f'"seen": {value}')):
        answer = client.post(OBJECT, content=body, headers={"Content-Type": "application/json"})
        assert 400 <= answer.status_code < 500, answer.text
    assert (root / "objects/carton/clicks.jsonl").read_bytes() == log


@pytest.mark.parametrize(
    "action",
    [
        {"op": ["click"]}, {"op": "click", "keypoint": "0", "scene": "00", "frame": 0, "u_px": 1, "v_px": 1},
        click(0, 1.0, 2.0) | {"frame": "x"}, click(0, 1.0, 2.0) | {"frame": 0.5},
        click(0, 1.0, 2.0) | {"scene": 7},
        click(0, 1.0, 2.0) | {"u_px": "x"}, click(0, 1.0, 2.0) | {"u_px": True},
        {"op": "skip", "keypoint": 0, "scene": "../00"}, {"op": "keypoints", "names": "abc"},
        {"op": "keypoints", "names": [1, 2, 3]}, {"op": "batch", "events": [7]},
        {"op": "batch", "events": {}},
        {"op": "order", "order": "01"}, {"op": "model", "points": [[1, 2]]}, {"op": "model", "points": 3},
        {"op": "crop", "low_m": "abc", "high_m": [1, 1, 1]}, {"op": "grasp", "scene": "00", "frame": None},
    ],
)  # fmt: skip
def test_an_action_of_the_wrong_shape_is_refused_in_words(
    client: TestClient, root: Path, action: dict[str, Any]
) -> None:
    log = (root / "objects/carton/clicks.jsonl").read_bytes()
    assert act(client, action, status=422)["error"]
    assert (root / "objects/carton/clicks.jsonl").read_bytes() == log


def test_an_action_with_a_strange_name_of_its_own_is_saved_once_each_time(client: TestClient) -> None:
    state = act(client, click(0, 10.0, 20.0, id={"a": 1}), click(0, 11.0, 20.0, id=[2]))
    assert [(c["u_px"], c["v_px"]) for c in state["clicks"] if (c["keypoint"], c["frame"]) == (0, 0)][0][
        0
    ] == 11


def test_another_site_may_only_open_the_page_itself_in_a_tab(client: TestClient) -> None:
    assert client.get("/", headers=FOREIGN | {"Sec-Fetch-Dest": "document"}).status_code == 200
    for dest in ("iframe", "frame", "object", "embed"):
        assert client.get("/", headers=FOREIGN | {"Sec-Fetch-Dest": dest}).status_code == 403
    for path in (f"{LOOK}?u_px=1&v_px=1", "/api/workspace", "/static/app.js", OBJECT):
        assert client.get(path, headers=FOREIGN | {"Sec-Fetch-Dest": "document"}).status_code == 403
    assert client.post("/", headers=FOREIGN | {"Sec-Fetch-Dest": "document"}).status_code == 403


def run_alone(coroutine: Coroutine[Any, Any, None]) -> None:
    """In a thread of its own: the browser of other tests keeps a loop running in this one."""
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, coroutine).result()


@pytest.mark.parametrize("length", ["\xb2", "9" * 5000, "-1", "nan", ""])
def test_a_length_that_is_no_number_is_refused(client: TestClient, length: str) -> None:
    """Straight to the application: the network layer would refuse most of them before."""
    found: list[int] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        found.append(message.get("status", 0))

    host = httpx.URL(str(client.base_url)).netloc
    headers = [(b"host", host), (b"content-length", length.encode("latin-1"))]
    scope = {"type": "http", "method": "POST", "path": OBJECT, "query_string": b"", "headers": headers}
    run_alone(client.app(scope, receive, send))  # type: ignore[arg-type]
    assert found[0] == 413


def test_bodies_at_once_are_bounded_together(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "MOST_BYTES_AT_ONCE", 1000)
    answer = client.post(f"{OBJECT}/model?file=a.ply", content=b"x" * 1001)
    assert answer.status_code == 429 and "send this one again" in answer.text
    assert client.post(f"{OBJECT}/model?file=a.ply", content=b"x" * 999).status_code == 422, "counted once"


def test_a_body_of_unknown_length_is_cut_off(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "MOST_BYTES", 1000)
    for path in (OBJECT, f"{OBJECT}/model?file=a.ply"):
        answer = client.post(path, content=(b"x" * 100 for _ in range(20)))
        assert answer.status_code == 413 and "Content-Security-Policy" in answer.headers


def test_listeners_are_bounded_and_one_that_does_not_read_is_let_go() -> None:
    async def scenario() -> None:
        news = News()
        streams = [news.stream() for _ in range(MOST_LISTENERS)]
        for stream in streams:
            assert "hello" in await anext(stream)
        assert news.is_full
        for number in range(MOST_WAITING + 2):
            news.tell("object", number)
        await asyncio.sleep(0)
        with pytest.raises(StopAsyncIteration):
            await anext(streams[0])
        assert not news.is_full

    run_alone(scenario())

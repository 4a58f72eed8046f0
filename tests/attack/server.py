"""Requests that nobody's page sends, many at once: 4xx, never 500, and the server goes on."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import json
import os
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from attack.damage import STRANGE

HOST = "127.0.0.1:8017"
NUMBERS = ("nan", "inf", "-1", "1e999", "99999999999999999999", "", "x", "0", "1.5", "%00", "..")
OPS = (
    "click", "move", "delete", "skip", "unskip", "keypoints", "order", "model", "grasp", "crop", "batch",
    "undo", "redo",
)  # fmt: skip
FIELDS = (
    "keypoint", "scene", "frame", "u_px", "v_px", "names", "order", "points", "low_m", "high_m", "events",
    "id", "toward_u_px", "toward_v_px", "source",
)  # fmt: skip
CLICKS = "object,keypoint,scene,frame,u_px,v_px\ncarton,0,00,0,5,5\n"
ODD_HEADERS = (
    b"content-length", b"cookie", b"origin", b"host", b"content-type", b"range", b"if-none-match",
    b"sec-fetch-site", b"accept-encoding", b"if-modified-since",
)  # fmt: skip
ODD_VALUES = (
    b"", b"\xb2", b"-1", b"9" * 5000, b"nan", b"a{b=1", b"rpl_token", b"bytes=0-", b"bytes=9-1,5-",
    b"\xff\xfe", b"http://127.0.0.1:8017", b"null", b"cross-site", b"multipart/form-data", b"x" * 20_000,
)  # fmt: skip
MOST_GROWTH_BYTES = 64 * 2**20
"""Of this process over the second half of the requests: the first fills caches of bounded size."""
GOOD = {
    "keypoint": 0,
    "scene": "00",
    "frame": 0,
    "u_px": 5.0,
    "v_px": 5.0,
    "names": ["a", "b", "c"],
    "order": [0],
}


def request(chance: random.Random, seen: int) -> tuple[str, str, bytes]:
    """Method, address and body of a request to a page that has seen revision `seen` of the log."""
    number = lambda: chance.choice((*NUMBERS, *"0123450123"))  # noqa: E731
    scene, name = (
        chance.choice(("00", "00", "00", "01", "..", "%2e%2e", "x", "%00")),
        chance.choice(("carton", "carton", "carton", "cup", "..", "%ff")),
    )
    gets = (
        f"/api/scenes/{scene}/frames/{number()}.look.jpg?u_px={number()}&v_px={number()}",
        f"/api/scenes/{scene}/frames/{number()}.depth?column={number()}&row={number()}",
        f"/api/scenes/{scene}/frames/{number()}.jpg?width={number()}",
        f"/api/scenes/{scene}/frames/{number()}.mask.png?object={name}", f"/api/scenes/{scene}/poses",
        f"/api/objects/{name}/surfaces/{scene}", f"/api/objects/{name}/result", f"/api/labels/{scene}",
        f"/api/labels/{scene}/{number()}.jpg?width={number()}", f"/static/{scene}", f"/api/objects/{name}",
        f"/api/objects/{name}/suggestions/{scene}", f"/api/objects/{name}/dense",
        f"/api/objects/{name}/given", "/", "/plotly.js", "/api/news", "/api/workspace", "/api/jobs",
        f"/api/scenes/{scene}", f"/api/objects/{name}/clicks.csv", f"/api/objects/{name}/sparse_model.txt",
        f"/api/objects/{name}/result?checked={number()}", f"/{scene}/{name}",
    )  # fmt: skip
    match chance.randrange(6):
        case 0 | 1:
            return chance.choice(("GET", "GET", "DELETE", "PUT")), chance.choice(gets), b""
        case 2:
            kind = chance.choice((".ply", ".pp", ".txt", ".off", ""))
            return (
                "POST",
                f"/api/objects/{name}/model?file=a{kind}&metres_per_unit={number()}",
                chance.randbytes(200),
            )
        case 3:
            path, fields = chance.choice(
                (
                    ("/api/jobs", {"stage": "fly"}),
                    ("/api/objects", {"name": "mug", "keypoints": ["a", "b", "c"]}),
                    (f"/api/labels/{scene}", {"frame": 0, "left_out": False}),
                    (f"/api/objects/{name}/clicks/read", {"name": "a.csv", "text": CLICKS}),
                )
            )
            fields = {**fields, chance.choice(list(fields)): chance.choice(STRANGE)}
            return "POST", path, json.dumps(fields).encode()
        case _:
            return "POST", f"/api/objects/{name}", _actions(chance, seen)


def headers_of(chance: random.Random) -> list[tuple[bytes, bytes]]:
    """Headers of a request, at times with one that is odd."""
    usual = {b"host": HOST.encode(), b"content-type": b"application/json"}
    if chance.random() < 0.2:
        usual[chance.choice(ODD_HEADERS)] = chance.choice(ODD_VALUES)
    return list(usual.items())


def _actions(chance: random.Random, seen: int) -> bytes:
    action: dict[str, Any] = {"op": chance.choice(OPS), **GOOD}
    for _ in range(chance.choice((0, 1, 1, 3))):
        action[chance.choice(FIELDS)] = chance.choice(STRANGE)
    known = seen if chance.random() < 0.9 else chance.choice((0, -1, 10**9, "x", None, 10**30))
    body: Any = {"seen": known, "actions": [action]}
    if chance.random() < 0.1:
        body = chance.choice(STRANGE)
    text = json.dumps(body)
    return ("[" * 100_000 if chance.random() < 0.02 else text).encode()


def attack(workspace: Path, requests: int, at_once: int, tell: Callable[[str], None]) -> Counter[str]:
    """Send so many requests, so many at once; the number of answers by status."""
    from rpl_data.annotate.server import make_app
    from rpl_data.annotate.session import Session
    from rpl_data.cli.annotate import address_of, work_of
    from rpl_data.workspace.workspace import Workspace

    session = Session(Workspace(workspace), work_of(Workspace(workspace)))
    here = address_of("127.0.0.1", 8017)
    apps = make_app(session, here), make_app(session, replace(here, token="secret"))
    counts: Counter[str] = Counter()

    async def send(number: int, gate: asyncio.Semaphore) -> None:
        async with gate:
            method, address, body = request(random.Random(number), session.log("carton").now().number)
            app = apps[number % 8 == 7]
            try:
                headers = headers_of(random.Random(-1 - number))
                status = await asyncio.wait_for(_status(app, method, address, body, headers), 300)
            except Exception as error:  # what the application did not catch
                status = 500
                tell(f"{type(error).__name__}: {error!s:.200}: {method} {address} {body[:300]!r}")
        counts[
            f"annotation server: {status // 100}xx" if status < 500 else f"annotation server: {status}"
        ] += 1

    async def all_of_them(numbers: range) -> None:
        gate = asyncio.Semaphore(at_once)
        await asyncio.gather(*(send(number, gate) for number in numbers))

    asyncio.run(all_of_them(range(requests // 2)))
    before = _resident_bytes()
    asyncio.run(all_of_them(range(requests // 2, requests)))
    growth = _resident_bytes() - before
    counts["annotation server: MB more after the second half"] = max(growth, 0) // 2**20
    if growth > MOST_GROWTH_BYTES:
        counts["annotation server: memory not back, lost"] += 1
    return counts


def _resident_bytes() -> int:
    """Memory of this process once what is free was given back."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


async def _status(
    app: Any, method: str, address: str, body: bytes, headers: list[tuple[bytes, bytes]]
) -> int:
    """The status of one request, sent to the application without a network."""
    path, _, query = address.partition("?")
    from urllib.parse import unquote

    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "scheme": "http",
        "path": unquote(path, errors="surrogateescape").encode("utf-8", "replace").decode(),
        "raw_path": path.encode(), "query_string": query.encode(), "headers": headers, "root_path": "",
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8017),
    }  # fmt: skip
    found: list[int] = []
    sent = False

    async def receive() -> dict[str, Any]:
        nonlocal sent
        if sent:
            while not found:
                await asyncio.sleep(0.1)
            await asyncio.sleep(1)  # then the page is closed: what streams ends
            return {"type": "http.disconnect"}
        sent = True
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            found.append(message["status"])

    await app(scope, receive, send)
    return found[0]

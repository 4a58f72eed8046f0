"""A client of the annotation server, for the tests of its routes."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from rpl_data.annotate import Address
from rpl_data.annotate.server import make_app
from rpl_data.annotate.session import Session
from rpl_data.cli.annotate import address_of, work_of
from rpl_data.workspace.workspace import Workspace

HERE = "http://127.0.0.1:8017"

OBJECT = "/api/objects/carton"


def client_of(root: Path, address: Address | None = None) -> TestClient:
    workspace = Workspace(root)
    app = make_app(Session(workspace, work_of(workspace)), address or address_of("127.0.0.1", 8017))
    return TestClient(app, base_url=HERE, raise_server_exceptions=False)


def act(client: TestClient, *actions: dict[str, Any], seen: int | None = None, status: int = 200) -> Any:
    if seen is None:
        seen = client.get(OBJECT).json()["revision"]
    answer = client.post(OBJECT, json={"seen": seen, "actions": list(actions)})
    assert answer.status_code == status, answer.text
    return answer.json()


def click(keypoint: int, u_px: float, v_px: float, *, scene: str = "00", frame: int = 0, **more: Any) -> Any:
    where = {"keypoint": keypoint, "scene": scene, "frame": frame}
    return {"op": "click", **where, "u_px": u_px, "v_px": v_px, **more}


def marks(state: Any) -> dict[tuple[int, str, int], tuple[float, float]]:
    return {(c["keypoint"], c["scene"], c["frame"]): (c["u_px"], c["v_px"]) for c in state["clicks"]}


def unpacked(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, 3).astype(float)

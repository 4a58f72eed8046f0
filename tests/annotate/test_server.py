"""The annotation server: what it saves, what it refuses, what it says about the clicks."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from annotate_client import HERE, OBJECT, act, click, client_of, marks
from fastapi.testclient import TestClient

from rpl_data.annotate.server import make_app
from rpl_data.annotate.session import Session
from rpl_data.cli.annotate import address_of, work_of
from rpl_data.types import DataError, Solution
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def client(root: Path) -> TestClient:
    return client_of(root)


# Actions and the log ------------------------------------------------------------------------------


def test_an_acknowledged_action_is_on_the_disk(client: TestClient, root: Path) -> None:
    state = act(client, click(0, 100.125, 80.5, id="a-0"))
    last = json.loads((root / "objects/carton/clicks.jsonl").read_text().splitlines()[-1])
    assert (last["op"], last["u_px"], last["v_px"], last["id"]) == ("click", 100.125, 80.5, "a-0")
    assert marks(state)[0, "00", 0] == (100.125, 80.5)
    assert marks(client_of(root).get(OBJECT).json()) == marks(state)


def test_undo_and_redo_without_limit(client: TestClient) -> None:
    first = client.get(OBJECT).json()
    for number in range(12):
        act(client, click(1, 50.0 + number, 60.0))
    for _ in range(12):
        state = act(client, {"op": "undo"})
    assert marks(state) == marks(first) and state["redo"].startswith("the click on keypoint 1")
    for _ in range(12):
        state = act(client, {"op": "redo"})
    assert marks(state)[1, "00", 0] == (61.0, 60.0) and state["redo"] is None


def test_an_action_that_is_sent_twice_is_done_once(client: TestClient) -> None:
    act(client, click(1, 50.0, 60.0, id="t-1"), click(1, 51.0, 60.0, id="t-2"))
    once = act(client, {"op": "undo", "id": "t-3"})
    twice = act(client, {"op": "undo", "id": "t-3"}, seen=once["revision"] - 1)
    assert twice == once and marks(twice)[1, "00", 0] == (50.0, 60.0)


def test_two_tabs_may_click_but_not_undo_what_they_have_not_seen(client: TestClient) -> None:
    seen = client.get(OBJECT).json()["revision"]
    act(client, click(0, 50.0, 60.0), seen=seen)
    both = act(client, click(1, 70.0, 60.0), seen=seen)
    assert {(0, "00", 0), (1, "00", 0)} <= marks(both).keys()
    refused = act(client, {"op": "undo"}, seen=seen, status=409)
    assert "changed elsewhere" in refused["error"]
    act(client, {"op": "order", "order": [1, 0]}, seen=seen, status=409)


def test_another_process_may_extend_the_log(client: TestClient, root: Path) -> None:
    before = client.get(OBJECT).json()
    Workspace(root).append_events("carton", [click(2, 33.0, 44.0)])
    after = client.get(OBJECT).json()
    assert after["revision"] == before["revision"] + 1 and marks(after)[2, "00", 0] == (33.0, 44.0)


def test_keypoints_keep_their_clicks_when_reordered_renamed_and_added(client: TestClient) -> None:
    first = client.get(OBJECT).json()
    names = [k["name"] for k in first["keypoints"]]
    order = [len(names) - 1, *range(len(names) - 1)]
    moved = act(client, {"op": "order", "order": order})
    assert [k["name"] for k in moved["keypoints"]] == [names[k] for k in order]
    assert {(order[k], s, f): uv for (k, s, f), uv in marks(moved).items()} == marks(first)
    added = act(client, {"op": "keypoints", "names": [*names, "knob"]})
    assert added["keypoints"][-1]["name"] == "knob" and marks(added) == marks(moved)
    assert len(act(client, {"op": "order", "order": [0, 1, 2]})["keypoints"]) == 3


def test_skipping_is_undone_by_a_click(client: TestClient) -> None:
    assert act(client, {"op": "skip", "keypoint": 3, "scene": "02"})["skipped"] == [[3, "02"]]
    assert act(client, click(3, 5.0, 5.0, scene="02"))["skipped"] == []


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ({"op": "format"}, "unknown action 'format'"),
        ({"op": "click", "keypoint": 0}, "incomplete"),
        (click(80, 1.0, 1.0), "no keypoint number 80"),
        (click(0, 1.0, 1.0, scene="../00"), "no scene"),
        (click(0, 1.0, 1.0, frame=99), "no frame 99"),
        (click(0, 320.0, 1.0), "outside the image of 320 x 240"),
        (click(0, 1.0, 1.0) | {"u_px": "nan"}, "not a finite number"),
        ({"op": "keypoints", "names": ["a", "a"]}, "two keypoints"),
        ({"op": "keypoints", "names": []}, "1 to 200"),
        ({"op": "crop", "low_m": [0, 0, 0], "high_m": [1, 1, 0]}, "below"),
        ({"op": "batch", "events": [{"op": "undo"}]}, "batch"),
    ],
)
def test_actions_that_mean_nothing_are_refused(
    client: TestClient, root: Path, action: dict[str, Any], message: str
) -> None:
    log = (root / "objects/carton/clicks.jsonl").read_bytes()
    assert message in act(client, action, status=422)["error"]
    assert (root / "objects/carton/clicks.jsonl").read_bytes() == log


def test_a_full_disk_is_said_and_nothing_is_half_saved(
    client: TestClient, root: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    path = root / "objects/carton/clicks.jsonl"
    before = client.get(OBJECT).json()
    with full_disk(path.stat().st_size + 20):
        error = act(client, click(0, 9.0, 9.0), seen=before["revision"], status=507)
    assert "not saved" in error["error"]
    assert client.get(OBJECT).json() == before
    assert marks(act(client, click(0, 9.0, 9.0)))[0, "00", 0] == (9.0, 9.0)


# Results ------------------------------------------------------------------------------------------


def test_the_result_is_that_of_the_library(client: TestClient, tiny_workspace: Workspace) -> None:
    result = client.get(OBJECT + "/result").json()
    solution = tiny_workspace.load_solution("carton")
    np.testing.assert_allclose(result["points_m"], solution.model.points_object, atol=1e-6)
    for scene, place in solution.scene_from_object.items():
        np.testing.assert_allclose(np.reshape(result["scene_from_object"][scene], (4, 4)), place, atol=1e-6)
    assert {s["state"] for s in result["scenes"].values()} == {"tied"}
    assert result["next"]["action"] == "label"


def test_a_bad_click_is_named_and_is_the_next_step(client: TestClient) -> None:
    state = client.get(OBJECT).json()
    wrong = state["clicks"][0]
    act(client, {**wrong, "op": "move", "u_px": wrong["u_px"] + 60.0})
    result = client.get(OBJECT + "/result").json()
    bad = [r for r in result["clicks"] if r["outlier"]]
    assert [(r["keypoint"], r["scene"], r["frame"]) for r in bad] == [
        (wrong["keypoint"], wrong["scene"], wrong["frame"])
    ]
    assert result["scenes"][wrong["scene"]]["state"] == "bad"
    assert bad[0]["reason"] in result["next"]["text"] and result["next"]["frame"] == wrong["frame"]


def test_a_newer_click_ends_the_check_of_an_older_one(root: Path) -> None:
    """The check that runs is given up, and the answer is that of the newer click, unchecked."""
    workspace = Workspace(root)
    session = Session(workspace, work_of(workspace))
    asked = []

    def move_a_click(to_px: float) -> None:
        session.act("carton", [click(0, to_px, 80.0)], seen=session.log("carton").now().number)

    def clicked_meanwhile(go_on: Callable[[], None]) -> Solution:
        move_a_click(101.0)
        while True:
            asked.append(1)
            go_on()

    move_a_click(100.0)
    first = session.result("carton", checked=False)
    session._results["carton"] = replace(first, live=replace(first.live, check=clicked_meanwhile))
    then = session.result("carton")
    assert asked == [1] and then.revision.number == first.revision.number + 1
    assert then.live.check is not None and session.result("carton").live.check is None


def test_the_solution_comes_before_the_check_of_its_clicks(client: TestClient) -> None:
    click = next(c for c in client.get(OBJECT).json()["clicks"])
    moved = {**click, "op": "move", "u_px": click["u_px"] + 60, "id": "a"}
    client.post(OBJECT, json={"seen": client.get(OBJECT).json()["revision"], "actions": [moved]})
    first = client.get(OBJECT + "/result?checked=false").json()
    assert first["checking"]
    assert first["statements"] == []
    assert first["next"]["text"].startswith("checking")
    assert first["next"]["action"] is None
    assert {scene["state"] for scene in first["scenes"].values()} == {"checking"}
    then = client.get(OBJECT + "/result").json()
    assert not then["checking"]
    assert then["statements"]
    assert then["points_m"] == first["points_m"]


def test_a_loose_scene_does_not_hold_the_others_back(client: TestClient) -> None:
    state = client.get(OBJECT).json()
    for mark in state["clicks"]:
        if mark["scene"] == "02" and mark["keypoint"] > 1:
            act(client, {"op": "delete", **{k: mark[k] for k in ("keypoint", "scene", "frame")}})
    result = client.get(OBJECT + "/result").json()
    assert sorted(result["scene_from_object"]) == ["00", "01"]
    assert result["scenes"]["02"]["state"] == "few" and "at least 3 are needed" in result["loose"]["02"]
    assert result["next"]["text"].startswith("scene 0")
    assert {p["scene"] for p in result["lifted"]} == {"02"}


def test_without_clicks_it_says_where_to_begin(client: TestClient) -> None:
    for mark in client.get(OBJECT).json()["clicks"]:
        act(client, {"op": "delete", **{k: mark[k] for k in ("keypoint", "scene", "frame")}})
    result = client.get(OBJECT + "/result").json()
    assert result["points_m"] is None and result["next"]["scene"] == "00" and result["next"]["keypoint"] == 0


def test_suggested_frames_are_frames_of_the_scene(client: TestClient) -> None:
    found = client.get(OBJECT + "/suggestions/01").json()
    assert found and {s["frame"] for s in found} <= set(range(6))
    assert any("near" in s["why"] for s in found)


def test_a_new_object_is_kept_in_the_recipe(client: TestClient, root: Path) -> None:
    answer = client.post("/api/objects", json={"name": "cup", "keypoints": ["rim", "handle", "foot"]})
    assert answer.json()["objects"] == ["carton", "cup"]
    assert [k["name"] for k in client_of(root).get("/api/objects/cup").json()["keypoints"]] == [
        "rim", "handle", "foot"
    ]  # fmt: skip
    assert client.get(OBJECT).json()["clicks"]
    for name in ("cup", "../x", "", "a/b", ".hidden"):
        assert client.post("/api/objects", json={"name": name, "keypoints": list("abc")}).status_code == 422


# Pictures -----------------------------------------------------------------------------------------


def test_pictures_are_no_larger_than_asked_and_cached(client: TestClient) -> None:
    path = "/api/scenes/00/frames/2.jpg"
    small, whole = client.get(path + "?width=96"), client.get(path)
    assert small.status_code == whole.status_code == 200, small.text
    assert cv2.imdecode(np.frombuffer(small.content, np.uint8), 1).shape == (72, 96, 3)
    assert cv2.imdecode(np.frombuffer(whole.content, np.uint8), 1).shape == (240, 320, 3)
    assert "max-age" in small.headers["cache-control"]
    again = client.get(path + "?width=96", headers={"If-None-Match": small.headers["etag"]})
    assert again.status_code == 304 and not again.content


def test_depth_and_poses_are_those_of_the_recording(client: TestClient, tiny_workspace: Workspace) -> None:
    from rpl_data.images import read_depth_m

    scene = tiny_workspace.load_scene("01")
    depth_m = np.pad(read_depth_m(scene, scene.frame(3)), 16)
    for column, row in ((0, 0), (1, 0), (2, 1), (9, 9)):
        answer = client.get(f"/api/scenes/01/frames/3.depth?column={column}&row={row}")
        tile = np.frombuffer(answer.content, "<u2").reshape(160, 160) * scene.metres_per_unit
        expected = depth_m[128 * row : 128 * row + 160, 128 * column : 128 * column + 160]
        np.testing.assert_allclose(tile[: expected.shape[0], : expected.shape[1]], expected, atol=1e-6)
        assert tile.sum() == pytest.approx(expected.sum())
    table = np.frombuffer(client.get("/api/scenes/01/poses").content, "<f4").reshape(-1, 8)
    poses = tiny_workspace.load_trajectory(scene)
    np.testing.assert_array_equal(table[:, 0], poses.frames)
    np.testing.assert_allclose(table[:, 1:4], poses.scene_from_camera[:, :3, 3], atol=1e-6)


def test_answers_are_compressed(client: TestClient) -> None:
    answer = client.get("/static/app.js", headers={"Accept-Encoding": "gzip"})
    assert answer.headers["content-encoding"] == "gzip"


def test_masks_of_the_labels_lie_over_the_picture(client: TestClient, tiny_workspace: Workspace) -> None:
    from pycocotools import mask as coco

    label = list(tiny_workspace.load_labels("01"))[-1]
    found = client.get(f"/api/scenes/01/frames/{label.frame}.mask.png?object=carton")
    picture = cv2.imdecode(np.frombuffer(found.content, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(picture[..., 3] > 0, coco.decode(label.instances[0].mask) > 0)
    for path in ("01/frames/999.mask.png?object=carton", f"01/frames/{label.frame}.mask.png?object=cup"):
        assert client.get(f"/api/scenes/{path}").status_code == 204


# Who may ask --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:8017"},
        {"Host": "127.0.0.1:9999"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:9999"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    ],
)
def test_foreign_pages_are_refused(client: TestClient, headers: dict[str, str]) -> None:
    answer = client.get("/api/workspace", headers=headers)
    assert answer.status_code == 403 and answer.text.startswith("refused: ")
    assert client.get("/api/workspace", headers={"Origin": HERE}).status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "/static/../server.py",
        "/static/%2e%2e/server.py",
        "/static/..%2fserver.py",
        "/static//etc/passwd",
        "/api/scenes/..%2f..%2fx/poses",
        "/api/scenes/%2e%2e/frames/0.jpg",
        "/api/objects/..%2f..%2fcarton",
    ],
)
def test_paths_lead_nowhere_else(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code in (404, 422), answer.text
    assert "import" not in answer.text and "root:" not in answer.text


def test_too_much_is_refused(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rpl_data.annotate.guard.MOST_BYTES", 1000)
    assert client.post(OBJECT, content=b"x" * 1001).status_code == 413

    def pieces() -> Any:
        for _ in range(30):
            yield b"x" * 100

    assert client.post(OBJECT, content=pieces()).status_code == 413


def test_another_address_wants_the_token(root: Path) -> None:
    place = address_of("192.168.1.5", 8017)
    assert place.token is not None and place.token in place.url
    app = make_app(Session(Workspace(root), work_of(Workspace(root))), place)
    there = TestClient(app, base_url="http://192.168.1.5:8017")
    assert there.get("/").status_code == 403
    assert there.get("/?token=wrong").status_code == 403
    # Another server of this machine may have set any cookie, which the browser sends here as well.
    for cookie in ("a{b=1", "a:b=1; rpl_token=x", "rpl_token", ";;="):
        assert there.get("/", headers={"Cookie": cookie}).status_code == 403
    assert there.get(f"/?token={place.token}").status_code == 200  # and from then on by the cookie
    assert there.get("/api/workspace").json()["objects"] == ["carton"]


def test_only_this_machine_needs_no_token() -> None:
    assert address_of("127.0.0.1", 1).token is None and address_of("localhost", 1).token is None
    assert address_of("0.0.0.0", 1).token is not None
    with pytest.raises(DataError, match="port 0"):
        address_of("127.0.0.1", 0)


def test_nothing_is_fetched_from_elsewhere(client: TestClient) -> None:
    answer = client.get("/")
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    static = Path(__file__).parents[2] / "rpl_data/annotate/static"
    for path in static.rglob("*.*"):
        text = path.read_text().replace("http://www.w3.org", "")
        assert "http://" not in text and "https://" not in text, path

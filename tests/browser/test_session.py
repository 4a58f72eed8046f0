"""A full session, as the page itself advises: from a recording without clicks to an exported dataset."""

from __future__ import annotations

from typing import Any

import numpy as np
from driving import Server, clicks, place, saved, wait_until
from playwright.sync_api import Page, expect
from pycocotools.coco import COCO

from rpl_data.types import InstanceLabel
from rpl_data.workspace.workspace import Workspace

MOST_ACTIONS = 60
STATE = """async () => {
    const { app, frame } = await import("/static/state/store.js");
    return { next: app.next, scene: app.scene, frame: frame(), keypoint: app.keypoint, waiting: app.waiting,
        stale: app.result?.revision !== app.state?.revision || app.result.checking };
}"""

PRESS = """({ app }, [key, offered]) => {
    if (![app.next?.action, app.next?.view].includes(offered)) return false;
    document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
    return true;
}"""

Truth = dict[tuple[str, int], InstanceLabel]


def truth_of(workspace: Workspace) -> Truth:
    """The true label of every frame that shows the object."""
    truth = Workspace(workspace.truth)
    return {
        (label.scene, label.frame): label.instances[0]
        for scene in truth.labelled_scene_names()
        for label in truth.load_labels(scene)
        if label.instances
    }


def settled(page: Page) -> dict[str, Any]:
    """The state of the page when it knows the result of the last action."""
    for _ in range(1200):
        state: dict[str, Any] = page.evaluate(STATE)
        if state["next"] and not state["waiting"] and not state["stale"]:
            return state
        page.wait_for_timeout(50)
    raise AssertionError("the page does not come to rest")


def taken_there(page: Page) -> dict[str, Any]:
    """Press the key that leads to the next step; the state there."""
    page.keyboard.press("g")
    for _ in range(200):
        state = settled(page)
        if (state["scene"], state["keypoint"]) == (state["next"]["scene"], state["next"]["keypoint"]):
            return state
        page.wait_for_timeout(50)
    raise AssertionError(f"G leads to {state['scene']}, {state['keypoint']}: {state['next']['text']}")


def mark_as_advised(page: Page, server: Server, truth: Truth) -> int:
    """Do what the next step asks for until it asks for the labels; returns how many actions that took."""
    for action in range(MOST_ACTIONS):
        state = settled(page)
        if state["next"]["action"] == "label":
            return action
        assert state["next"]["keypoint"] is not None, state["next"]["text"]
        state = taken_there(page)
        keypoint, scene = state["keypoint"], state["scene"]
        seen = [f for (s, f), label in truth.items() if s == scene and label.visibility[keypoint] == 2]
        if not seen:
            page.keyboard.press("s")
            saved(page)
            continue
        new = [frame for frame in seen if (keypoint, scene, frame) not in clicks(server)]
        wanted = min(new or seen, key=lambda frame: abs(frame - state["frame"]))
        for _ in range(abs(wanted - state["frame"])):
            page.keyboard.press("." if wanted > state["frame"] else ",")
        expect(page.locator("#picture")).to_have_attribute("data-frame", f"{scene}/{wanted}")
        u_px, v_px = truth[scene, wanted].keypoints_px[keypoint]
        place(page, float(u_px), float(v_px))
    raise AssertionError(f"not done after {MOST_ACTIONS} actions: {state['next']['text']}")


def press_when(page: Page, key: str, offered: str) -> None:
    """Press a key in the very moment in which the next step offers this: G waits while clicks are checked."""
    wait_until(page, PRESS, arg=[key, offered])


def test_a_session_from_no_click_to_the_dataset(
    page: Page, server: Server, tiny_workspace: Workspace
) -> None:
    truth = truth_of(tiny_workspace)
    assert Workspace(server.workspace).load_annotation("carton").clicks == ()
    mark_as_advised(page, server, truth)
    expect(page.locator("#scenes .good")).to_have_count(3)
    page.keyboard.press("v")
    page.wait_for_selector("#plot[data-drawn]")
    with page.expect_response(lambda answer: answer.request.method == "POST"):
        page.keyboard.press("g")  # dense model and labels
    page.reload()  # the job goes on without the page
    expect(page.locator("#next-text")).to_contain_text("look through", timeout=120_000)
    expect(page.locator("#job-label")).to_be_disabled()
    press_when(page, "g", "labels")
    expect(page.locator("#sheet figure")).to_have_count(6)
    page.wait_for_function("() => document.querySelector('#sheet img').naturalWidth > 0")
    page.get_by_label("export frame 2").uncheck()
    expect(page.locator("#sheet figure.out")).to_have_count(1)
    press_when(page, "g", "export")
    expect(page.locator("#next-text")).to_contain_text("done", timeout=180_000)
    assert page.evaluate(
        "document.getElementById('jobs').scrollWidth <= document.getElementById('jobs').clientWidth"
    )
    check_dataset(Workspace(server.workspace), truth)


def test_a_job_that_cannot_run_says_what_to_do(page: Page) -> None:
    page.locator("#job-label").click()
    said = page.locator("#jobs [role=alert]")
    expect(said).to_contain_text("object carton has no clicks; mark them", timeout=60_000)
    expect(page.locator("#job-label")).to_be_enabled()


def check_dataset(workspace: Workspace, truth: Truth) -> None:
    """The exported files are COCO's, lack what was left out, and lie on the truth."""
    off_px, frames = [], set()
    for path in sorted(workspace.export("coco").glob("*.json")):
        coco = COCO(str(path))
        for annotation in coco.loadAnns(coco.getAnnIds()):
            image = coco.loadImgs(annotation["image_id"])[0]
            assert (workspace.export("coco") / image["file_name"]).exists()
            frames.add((image["scene"], image["frame"]))
            u, v, visible = np.reshape(annotation["keypoints"], (-1, 3)).T
            label = truth[image["scene"], image["frame"]]
            both = (visible == 2) & (label.visibility == 2)
            off_px += np.linalg.norm(np.column_stack([u, v]) - label.keypoints_px, axis=1)[both].tolist()
    assert len(frames) == len(truth) - 1
    # A pixel is 2 to 3 mm here, as good as the depth is; how exact labels are is measured elsewhere.
    assert np.median(off_px) < 2.5 and np.percentile(off_px, 95) < 8

"""Marking keypoints in a real browser: clicks land where they are aimed, and nothing is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from driving import SHOWN, Server, clicks, on_page, place, saved, toured, view, zoom_to
from playwright.sync_api import Browser, Page, expect

from rpl_data.geometry import invert, project, transform
from rpl_data.workspace.workspace import Workspace

TOLERANCE_PX = {1: 0.25, 8: 0.05}


@pytest.mark.parametrize("zoom", [1, 8])
def test_clicks_are_read_back_where_they_were_aimed(page: Page, server: Server, zoom: int) -> None:
    aimed = [(150.0, 110.0), (161.25, 117.5), (140.75, 100.125)]
    zoom_to(page, zoom, 150.0, 110.0)
    for u, v in aimed:
        place(page, u, v)
    found = [uv for _, uv in sorted(clicks(server).items())]
    np.testing.assert_allclose(found, aimed, atol=TOLERANCE_PX[zoom])


def test_the_next_keypoint_is_selected_and_marks_can_be_dragged_deleted_undone(
    page: Page, server: Server
) -> None:
    place(page, 100.0, 90.0)
    place(page, 120.0, 95.0)
    expect(page.locator("#keypoints li[aria-current=true] .name")).to_have_text("keypoint 2")
    page.mouse.move(*on_page(page, 100.0, 90.0))
    page.mouse.down()
    page.mouse.move(*on_page(page, 108.0, 92.0), steps=4)
    page.mouse.up()
    saved(page)
    (_, first), (_, second) = sorted(clicks(server).items())
    np.testing.assert_allclose([first, second], [(108.0, 92.0), (120.0, 95.0)], atol=0.25)
    page.keyboard.press("Delete")  # the dragged one is selected
    saved(page)
    assert [k for k, _, _ in clicks(server)] == [1]
    for expected in ([0, 1], [0, 1], [0], []):
        page.keyboard.press("Control+z")
        saved(page)
        assert sorted(k for k, _, _ in clicks(server)) == expected
    for _ in range(2):
        page.keyboard.press("Control+Shift+Z")
        saved(page)
    assert sorted(k for k, _, _ in clicks(server)) == [0, 1]


def test_a_pen_hovers_marks_and_drags_like_a_mouse(page: Page, server: Server) -> None:
    session = page.context.new_cdp_session(page)

    def pen(kind: str, u: float, v: float) -> None:
        x, y = on_page(page, u, v)
        pressed = {"button": "left", "clickCount": 1} if kind != "mouseMoved" else {}
        touching = {"buttons": 1, "force": 0.5} if kind == "mousePressed" else {}
        pointer = {"type": kind, "x": x, "y": y, "pointerType": "pen", **pressed, **touching}
        session.send("Input.dispatchMouseEvent", pointer)

    page.evaluate(
        "addEventListener('pointerdown', (e) => (window.kinds ??= new Set()).add(e.pointerType), true)"
    )
    pen("mouseMoved", 99.0, 90.0)
    expect(page.locator("#loupe")).to_be_visible()  # above the tablet, before it touches
    pen("mousePressed", 100.0, 90.0)
    pen("mouseReleased", 100.0, 90.0)
    saved(page)
    np.testing.assert_allclose(list(clicks(server).values()), [(100.0, 90.0)], atol=0.25)
    pen("mousePressed", 100.0, 90.0)
    for u in (104.0, 108.0, 112.0):
        pen("mouseMoved", u, 92.0)
    pen("mouseReleased", 112.0, 92.0)
    saved(page)
    np.testing.assert_allclose(list(clicks(server).values()), [(112.0, 92.0)], atol=0.25)
    assert page.evaluate("[...window.kinds]") == ["pen"]


def test_panning_marks_nothing(page: Page, server: Server) -> None:
    before = view(page)
    page.mouse.move(*on_page(page, 100.0, 90.0))
    page.mouse.down()
    page.mouse.move(*on_page(page, 150.0, 120.0), steps=4)
    page.mouse.up()
    after = view(page)
    assert after["x"] - before["x"] == pytest.approx(50 * before["zoom"], abs=0.5)
    assert clicks(server) == {}


@pytest.mark.parametrize("server", ["process"], indirect=True)
def test_a_page_comes_back_where_it_was_after_kill(page: Page, server: Server) -> None:
    place(page, 100.0, 90.0)
    page.keyboard.press(".")
    server.kill()
    page.mouse.click(*on_page(page, 130.0, 100.0))
    expect(page.locator("#saved")).to_have_text("connection lost · 1 not saved")
    server.start()
    expect(page.locator("#saved")).to_have_text("all saved")
    assert len(clicks(server)) == 2
    frame = page.locator("#frame-text").inner_text()
    page.reload()
    page.wait_for_selector(SHOWN)
    expect(page.locator("#frame-text")).to_have_text(frame)
    expect(page.locator("#keypoints li[aria-current=true] .name")).to_have_text("keypoint 2")


def test_two_tabs_show_the_same(page: Page, server: Server) -> None:
    other = page.context.new_page()
    other.goto(server.url)
    other.wait_for_selector(SHOWN)
    place(page, 100.0, 90.0)
    done = other.locator("#keypoints .good")
    expect(done).to_have_text(["✓"])
    other.mouse.click(*on_page(other, 140.0, 95.0))
    expect(page.locator("#keypoints .good")).to_have_count(1)  # the same keypoint, moved: it was selected
    saved(other)
    assert [(k, scene) for k, scene, _ in clicks(server)] == [(0, "00")]


def test_keypoints_by_keyboard_alone(page: Page, server: Server) -> None:
    page.keyboard.press("1")
    for key in ("ArrowRight", "ArrowRight", "Shift+ArrowDown", "Enter"):
        page.keyboard.press(key)
    saved(page)
    zoom = view(page)["zoom"]
    ((key, uv),) = clicks(server).items()
    assert key[0] == 1
    np.testing.assert_allclose(uv, (159.5 + 2 / zoom, 119.5 + 10 / zoom), atol=0.01)
    page.keyboard.press("?")
    expect(page.locator("dialog")).to_contain_text("mark the selected keypoint at the cursor")
    page.keyboard.press("Escape")
    page.keyboard.press("a")
    page.keyboard.type("knob")
    page.keyboard.press("Enter")
    expect(page.locator("#keypoints li[aria-current=true] .name")).to_have_text("knob")
    page.keyboard.press("s")
    expect(page.locator("#keypoints li").last).to_contain_text("skipped")
    page.keyboard.press("PageDown")
    expect(page.locator("#frame-text")).to_contain_text("scene 01")


def test_the_model_is_projected_as_the_library_does(
    browser: Browser, server: Server, tiny_workspace: Workspace
) -> None:
    clicked = tiny_workspace.load_annotation("carton").clicks
    Workspace(server.workspace).append_events(
        "carton",
        [{"op": "click", **{k: v for k, v in vars(c).items() if k != "object"}} for c in clicked],
    )
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.context.add_cookies([toured(server.url)])
    page.goto(server.url)
    page.wait_for_selector(SHOWN)
    expect(page.locator("#scenes .good")).to_have_count(3)
    found: Any = page.evaluate(
        """async () => {
            const { projectedKeypoints } = await import("/static/image/marks.js");
            const { openScene } = await import("/static/image/frames.js");
            for (const name of ["00", "01", "02"]) await openScene(name);
            return ["00", "01", "02"].map((s) => [0, 1, 2, 3, 4, 5].map((row) => projectedKeypoints(s, row)));
        }"""
    )
    solution = tiny_workspace.load_solution("carton")
    for name, rows in zip(("00", "01", "02"), found, strict=True):
        scene = tiny_workspace.load_scene(name)
        for pose, row in zip(tiny_workspace.load_trajectory(scene).scene_from_camera, rows, strict=True):
            camera_from_object = invert(pose) @ solution.scene_from_object[name]
            points = transform(camera_from_object, solution.model.points_object)
            np.testing.assert_allclose(row, project(scene.intrinsics, points), atol=0.5)
    page.close()


def test_another_instance_in_a_scene_is_marked_by_itself(page: Page, server: Server) -> None:
    place(page, 100.0, 90.0)
    page.locator("#new-instance").click()
    expect(page.locator("#scenes li[aria-current=true] .name")).to_have_text("00/2")
    place(page, 130.0, 100.0)
    expect(page.locator("#saved")).to_have_text("all saved")
    marked = Workspace(server.workspace).load_annotation("carton").clicks
    assert [click.scene for click in marked] == ["00", "00/2"]
    page.reload()
    expect(page.locator("#scenes .name").first).to_have_text("00")
    expect(page.locator("#scenes li[aria-current=true] .name")).to_have_text("00/2")

"""Nothing is lost: full disks, reloads, other people, several objects; and what was not saved is said."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
from driving import SHOWN, Server, clicks, on_page, place, saved
from playwright.sync_api import Page, Request, Route, expect

from rpl_data.clicks.log import keypoints_event
from rpl_data.clicks.table import clicks_to_csv
from rpl_data.workspace.workspace import Workspace


def is_sent(request: Request) -> bool:
    """Whether the page sends something, and does not only ask."""
    return request.method == "POST"


def log_of(server: Server) -> Path:
    return Workspace(server.workspace).clicks_file("carton")


@pytest.mark.parametrize("server", ["process"], indirect=True)
def test_a_full_disk_is_said_and_what_waits_is_saved_later(page: Page, server: Server) -> None:
    place(page, 100.0, 90.0)
    before, pid = log_of(server).read_bytes(), server.process.pid
    unlimited = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (len(before) + 20, unlimited[1]))
    page.mouse.click(*on_page(page, 130.0, 100.0))
    expect(page.locator("#alert")).to_contain_text("Not saved")
    expect(page.locator("#alert")).to_contain_text("click keypoint 1 in scene 00, frame")
    page.mouse.click(*on_page(page, 140.0, 100.0))
    expect(page.locator("#saved")).to_have_text("2 not saved")
    assert log_of(server).read_bytes() == before
    resource.prlimit(pid, resource.RLIMIT_FSIZE, unlimited)
    # The page tries again by itself, too, and may take the button away while it is pressed.
    page.locator("#alert button", has_text="Try again").dispatch_event("click")
    saved(page)
    expect(page.locator("#alert")).to_be_hidden()
    assert sorted(k for k, _, _ in clicks(server)) == [0, 1, 2]


def test_what_was_not_sent_survives_a_reload_and_is_saved_once(page: Page, server: Server) -> None:
    asked: list[str] = []
    page.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
    page.route(
        "**/api/objects/carton", lambda route: route.abort() if is_sent(route.request) else route.continue_()
    )
    page.mouse.click(*on_page(page, 100.0, 90.0))
    page.mouse.click(*on_page(page, 130.0, 100.0))
    expect(page.locator("#saved")).to_have_text("connection lost · 2 not saved")
    assert clicks(server) == {}
    page.reload()
    page.wait_for_selector(SHOWN)
    page.unroute("**/api/objects/carton")
    saved(page)
    expect(page.locator("#keypoints .good")).to_have_count(2)
    assert asked == ["beforeunload"]
    events = [event["op"] for event in Workspace(server.workspace).load_events("carton")]
    assert events.count("click") == 2


def test_an_undo_on_top_of_what_one_has_not_seen_is_refused(page: Page, server: Server) -> None:
    place(page, 100.0, 90.0)
    names = Workspace(server.workspace).load_annotation("carton").keypoints
    other = {"op": "click", "keypoint": 5, "scene": "01", "frame": 2, "u_px": 50.0, "v_px": 60.0}
    Workspace(server.workspace).append_events("carton", [other])  # another program, unheard of by the page
    page.keyboard.press("Control+z")
    expect(page.locator("#alert")).to_contain_text("changed elsewhere")
    assert len(clicks(server)) == 2
    page.locator("#alert button", has_text="Close").click()
    renamed = keypoints_event(["lid", *names[1:]])
    Workspace(server.workspace).append_events("carton", [renamed])
    page.mouse.click(*on_page(page, 140.0, 95.0))
    expect(page.locator("#alert")).to_contain_text("Not done (click keypoint 1")
    expect(page.locator("#keypoints .name").first).to_have_text("lid")


def test_objects_have_their_own_clicks(page: Page, server: Server) -> None:
    place(page, 100.0, 90.0)
    page.locator("#new-object").click()
    page.keyboard.type("cup")
    page.keyboard.press("Tab")
    page.keyboard.type("rim, foot, handle")
    page.keyboard.press("Enter")
    expect(page.locator("#keypoints .name")).to_have_text(["rim", "foot", "handle"])
    page.mouse.click(*on_page(page, 130.0, 100.0))
    page.locator("#object").select_option("carton")
    expect(page.locator("#keypoints .name").first).to_have_text("keypoint 0")
    place(page, 150.0, 90.0)
    cup = Workspace(server.workspace).load_annotation("cup")
    assert [(c.keypoint, c.scene) for c in cup.clicks] == [(0, "00")]
    assert sorted(k for k, _, _ in clicks(server)) == [0, 1]
    held: list[Route] = []
    page.route("**/api/objects/cup", lambda route: held.append(route))
    with page.expect_request("**/api/objects/cup"):  # as when another tab changed the cup a moment ago
        page.evaluate('import("/static/state/log.js").then((log) => { log.load("cup"); })')
    with page.expect_response("**/api/objects/carton"):
        page.locator("#object").select_option("carton")
    with page.expect_response("**/api/objects/cup"):
        held[0].continue_()
    page.evaluate("new Promise((drawn) => setTimeout(drawn, 100))")
    expect(page.locator("#keypoints .name").first).to_have_text("keypoint 0", timeout=1)


def test_clicks_go_out_and_come_in_as_csv(page: Page, server: Server, tmp_path: Path) -> None:
    place(page, 100.0, 90.0)
    place(page, 130.0, 100.0)
    page.keyboard.press("o")
    with page.expect_download() as download:
        page.locator("dialog button", has_text="Export clicks").click()
    annotation = Workspace(server.workspace).load_annotation("carton")
    assert Path(download.value.path()).read_text() == clicks_to_csv(annotation.clicks, annotation.keypoints)
    wanted = tmp_path / "clicks.csv"
    wanted.write_text("object,keypoint,scene,frame,u_px,v_px\ncarton,2,01,3,77.5,66.25\ncarton,1,00,0,9,9\n")
    with page.expect_file_chooser() as chooser:
        page.keyboard.press("o")
        page.locator("dialog button", has_text="Import clicks").click()
    chooser.value.set_files(wanted)
    expect(page.locator("dialog")).to_contain_text("clicks.csv holds 2 clicks on carton")
    expect(page.locator("dialog")).to_contain_text("2 clicks added; 2 stay as before")
    page.locator("dialog button", has_text="Replace what is here").click()
    expect(page.locator("#alert")).to_have_text("clicks.csv: 2 clicks added, 2 removed.Close")
    expect(page.locator("#undo")).to_have_attribute("title", "undo several changes at once")
    assert clicks(server).keys() == {(2, "01", 3), (1, "00", 0)}
    np.testing.assert_array_equal(clicks(server)[2, "01", 3], (77.5, 66.25))
    wanted.write_text("object,keypoint,scene,frame,u_px,v_px\ncarton,2,01,99,77.5,66.25\n")
    with page.expect_file_chooser() as chooser:
        page.keyboard.press("o")
        page.locator("dialog button", has_text="Import clicks").click()
    chooser.value.set_files(wanted)
    expect(page.locator("#alert")).to_contain_text("no frame 99")
    page.keyboard.press("Control+z")
    saved(page)
    first, _ = (uv for _, uv in sorted(clicks(server).items()))
    np.testing.assert_allclose(first, (100.0, 90.0), atol=0.25)

"""Flows beside marking: a scene begun anew, a grasp, other programs at work, a picture that never moves."""

from __future__ import annotations

import json

from driving import ServerHere, on_page, place, saved
from playwright.sync_api import Page, expect

from rpl_data.clicks.log import click_event
from rpl_data.types import Click
from rpl_data.workspace.workspace import Workspace

BOX = "(id) => { const { x, y, width, height } = document.getElementById(id).getBoundingClientRect();" + (
    " return [x, y, width, height]; }"
)

PROBLEM = """(text) => {
    const asked = window.fetch;
    window.problem = text;
    window.fetch = async (path, ...options) => {
        const answer = await asked(path, ...options);
        if (!/[/]result/.test(path)) return answer;
        return new Response(JSON.stringify({ ...(await answer.json()), grasp_problem: window.problem }));
    };
}"""


def test_a_scene_is_reset_and_undone(page: Page, server: ServerHere) -> None:
    page.evaluate(PROBLEM, "")  # before any result is asked for, since an answer may come late
    stage = page.evaluate(BOX, "stage")
    for u in (100.0, 120.0, 140.0):
        place(page, u, 90.0)
        assert page.evaluate(BOX, "stage") == stage, "no hint moves the picture"
    page.keyboard.press("s")
    saved(page)
    page.get_by_role("button", name="reset").click()
    expect(page.locator("dialog")).to_contain_text("remove 3 clicks and 1 skipped of carton there?")
    page.keyboard.press("Enter")
    expect(page.locator("#scenes li[aria-current=true]")).to_contain_text("nothing yet")
    saved(page)
    annotation = Workspace(server.workspace).load_annotation("carton")
    assert not annotation.clicks and not annotation.skipped
    page.keyboard.press("Control+z")
    saved(page)
    annotation = Workspace(server.workspace).load_annotation("carton")
    assert len(annotation.clicks) == 3 and len(annotation.skipped) == 1

    page.locator("#scenes li > button").nth(1).click()
    expect(page.locator("#frame-text")).to_contain_text("scene 01")
    page.keyboard.press("Shift+S")  # the object is not in this scene
    expect(page.locator("#scenes li[aria-current=true]")).to_contain_text("not here")
    saved(page)
    annotation = Workspace(server.workspace).load_annotation("carton")
    assert len([scene for _, scene in annotation.skipped if scene == "01"]) == len(annotation.keypoints)

    page.evaluate("window.problem = 'there is no depth'")
    page.locator("#grasp").click()
    page.mouse.click(*on_page(page, 150.0, 120.0))
    page.mouse.click(*on_page(page, 180.0, 118.0))
    saved(page)
    assert Workspace(server.workspace).load_annotation("carton").grasp is not None
    expect(page.locator("#alert")).to_contain_text("there is no depth")
    page.evaluate("window.problem = ''")
    page.locator("#grasp-remove").click()
    expect(page.locator("#alert")).to_be_hidden()  # what was said of it holds no longer
    saved(page)
    assert Workspace(server.workspace).load_annotation("carton").grasp is None
    page.evaluate(
        """async () => {
            const { alertOnce } = await import("/static/state/log.js");
            alertOnce("Not saved: the disk is full. ".repeat(12));
        }"""
    )
    expect(page.locator("#alert")).to_be_visible()
    assert page.evaluate(BOX, "stage") == stage, "and no alert"
    build = page.evaluate(BOX, "jobs")
    assert build[1] + build[3] <= 720, "Build is in the window whatever stands above it"


def test_what_other_programs_do_is_said(page: Page, server: ServerHere) -> None:
    workspace = Workspace(server.workspace)
    place(page, 100.0, 90.0)
    workspace.append_events("carton", [click_event(Click("carton", 5, "01", 2, 50.0, 60.0))])
    expect(page.locator("#undo")).to_have_attribute("title", "undo the click on keypoint 5")
    ledger = json.loads(workspace.stages_file.read_text())
    ledger["drift/00"] = {**ledger["clicks/carton"], "seconds": 1.0}
    workspace.stages_file.write_text(json.dumps(ledger))
    said = page.locator("#elsewhere")
    expect(said).to_contain_text("Another program built here until")
    expect(said).to_contain_text("drift 00")
    expect(page.locator("#saved")).to_have_text("all saved")

"""A known object found on the page without clicks, and a page whose workspace was replaced."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from built_once import moved_copy
from driving import SHOWN, ServerHere, place, toured
from playwright.sync_api import Browser, Page, Route, expect

from rpl_data.workspace.workspace import Workspace

REDRAWN = """async () => {
    const { change } = await import("/static/state/store.js");
    change({ elsewhere: { steps: ["solve"], time: "noon" } });
}"""


@pytest.fixture
def known(known_model: Path, tmp_path: Path) -> Workspace:
    """A workspace in which the carton has its dense model, and no click in scene 02."""
    return Workspace(moved_copy(known_model, tmp_path / "known") / "ws")


def test_a_known_object_is_found_without_clicks(browser: Browser, known: Workspace) -> None:
    server = ServerHere(known.root)
    page = browser.new_page()
    page.context.add_cookies([toured(server.url)])
    try:
        page.goto(f"{server.url}#scene=02")
        page.wait_for_selector(SHOWN)
        page.locator("#job-find").click()
        expect(page.locator("#scenes")).to_contain_text("found ±", timeout=120_000)
        expect(page.locator("#jobs")).to_contain_text("carton was placed automatically in scene 02")
        expect(page.locator("#jobs")).to_contain_text(" px) off")
        row = page.locator("#result table tr").filter(has=page.get_by_role("button", name="02", exact=True))
        expect(row.locator("td").nth(3)).to_have_text(_px(known))
        expect(page.locator("#job-find")).to_have_count(0)
    finally:
        page.close()
        server.kill()


def _px(workspace: Workspace) -> str:
    """The px that the message of the placement states, to a digit."""
    entry = json.loads(workspace.stages_file.read_text())["solve/carton"]
    (line,) = [line for line in entry["outcome"]["messages"] if "placed automatically" in line]
    return line.split("(")[-1].split(" px")[0]


def test_where_it_is_unsure_one_click_is_asked_for(page: Page) -> None:
    job = {
        "number": 1, "stage": "find", "state": "unsure", "what": "", "done": 0, "total": 0, "lines": [],
        "error": "two poses are nearly as good", "seconds": 1, "scene": "01", "frame": 3, "keypoint": 2,
    }  # fmt: skip

    def ended(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "job": job})

    page.route("**/api/jobs", ended)  # whenever the page asks, it hears of this job
    place(page, 100.0, 90.0)  # what is up to date may be another thing now, so it asks
    expect(page.locator("#jobs")).to_contain_text("Not sure: two poses are nearly as good")
    page.locator("#job-ask").hover()
    page.mouse.down()
    page.evaluate(REDRAWN)  # news while the button is pressed do not take it away
    page.mouse.up()
    expect(page.locator("#frame-text")).to_contain_text("scene 01 · frame 3")
    selected = "async () => (await import('/static/state/store.js')).app.keypoint"
    assert page.evaluate(selected) == 2
    expect(page.locator("#elsewhere")).to_contain_text("until noon: solve")  # and are shown afterwards
    page.unroute_all(behavior="ignoreErrors")


def test_a_page_whose_workspace_was_replaced_says_reload(page: Page) -> None:
    def another(route: Route) -> None:
        route.fulfill(json={"name": "ws", "scenes": ["00"], "objects": ["bowl"]})

    page.route("**/api/workspace", another)
    page.evaluate("async () => (await import('/static/state/news.js')).caughtUp()")
    said = "The workspace was replaced while this page was open: reload the page."
    expect(page.locator("#alert")).to_contain_text(said)
    open_object = "async () => (await import('/static/panels/objects.js')).openObject('bowl')"
    page.evaluate(open_object)
    page.keyboard.press("5")
    expect(page.locator("#alert")).to_contain_text("reload the page")

"""Another workspace and a recording, opened from the page; nothing beyond the folder it may open."""

from __future__ import annotations

import shutil

from driving import SHOWN, ServerHere, place, toured
from playwright.sync_api import Browser, expect

from rpl_data.workspace.workspace import Workspace

ASKED = """async (path) => {
    const { post } = await import("/static/state/api.js");
    return await post("/api/opening", { path }).then(() => "opened", (error) => error.message);
}"""


def test_a_workspace_beside_this_one_and_a_recording_are_opened(
    browser: Browser, server: ServerHere, tiny_workspace: Workspace
) -> None:
    page = browser.new_page()
    page.context.add_cookies([toured(server.url)])
    page.goto(server.url)
    page.wait_for_selector(SHOWN)
    beside = server.workspace.parent / "mugs"
    shutil.copytree(server.workspace, beside)
    recording = server.workspace.parent / "desk"
    shutil.copytree(tiny_workspace.recording, recording, ignore=shutil.ignore_patterns("truth", "clicks.csv"))
    (server.workspace.parent / "out").symlink_to(tiny_workspace.root)
    for outside in (str(tiny_workspace.root), "../", "out", "/etc/passwd"):
        assert "can be opened from this page" in page.evaluate(ASKED, outside)
    assert "there is nothing at" in page.evaluate(ASKED, "none")

    page.locator("#open").click()
    expect(page.locator("dialog .entry")).to_have_text(["mugs"])
    page.keyboard.press("Enter")
    page.wait_for_url(lambda url: not url.startswith(server.url))
    page.wait_for_selector(SHOWN)
    expect(page.locator("#workspace")).to_have_text("mugs")
    place(page, 100.0, 90.0)
    assert len(Workspace(beside).load_annotation("carton").clicks) == 1
    assert not Workspace(server.workspace).load_annotation("carton").clicks

    page.keyboard.press("Shift+O")
    page.get_by_label("folder or file").fill("desk")
    page.get_by_label("object", exact=True).last.fill("box")
    page.get_by_label("keypoints", exact=True).fill("rim, foot, lid")
    page.keyboard.press("Enter")
    expect(page.locator("#workspace")).to_have_text("desk_workspace", timeout=60_000)
    expect(page.locator("#keypoints .name")).to_have_text(["rim", "foot", "lid"])
    expect(page.locator("#tour")).to_have_count(0)  # seen at another port
    page.context.close()

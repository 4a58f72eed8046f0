"""Pictures of the annotation page for the README: `python tests/browser/screenshots.py WORKSPACE DOCS`.

Not a test. WORKSPACE is the one that `make demo` builds; it is only read. The pictures are made of a
workspace on its recording, with the clicks of its simulated person, driven as a person would.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from conftest import FLAGS, chromium
from driving import SHOWN, Server, on_page, saved, toured, wait_until
from playwright.sync_api import Page, expect, sync_playwright

from rpl_data.clicks.log import click_event
from rpl_data.pipeline.build import build
from rpl_data.pipeline.recipe import LabelRecipe, ObjectRecipe, Recipe, SceneSource
from rpl_data.types import Click
from rpl_data.workspace.workspace import Workspace

OBJECT = "kettle"
PATIENT_MS = 600_000  # a build
SETTLED = """({ app }) => {
    return !app.waiting && app.result?.revision === app.state?.revision && !app.result.checking;
}"""


def main(demo: Path, docs: Path) -> None:
    """Make all pictures."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        workspace = unmarked(Workspace(demo), Workspace(Path(folder) / "kettle_on_desk"))
        clicks = Workspace(demo).load_annotation(OBJECT).clicks
        scenes = workspace.scene_names()
        keep(workspace, [c for c in clicks if c.scene != scenes[-1]])
        server = Server(workspace.root)
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        try:
            page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="light")
            page.context.add_cookies([toured(server.url)])
            page.goto(server.url, wait_until="commit")
            page.wait_for_selector(SHOWN)
            mark(page, docs, [c for c in clicks if c.scene == scenes[-1]])
            keep(workspace, [c for c in clicks if c.scene == scenes[-1]])
            page.reload()
            solid(page, docs)
            labels(page, docs)
        finally:
            browser.close()
            server.kill()


def unmarked(demo: Workspace, workspace: Workspace) -> Workspace:
    """The recording of the demo with one object and no clicks."""
    model = Workspace(demo.truth).load_solution(OBJECT).model
    recipe = Recipe(
        "kettle_on_desk",
        scenes=(SceneSource(demo.recording.resolve(), metres_per_unit=0.001),),
        objects=(ObjectRecipe(OBJECT, model.keypoints, skeleton=model.skeleton),),
        label=LabelRecipe("all"),
    )
    build(recipe, workspace, until="clicks", workers=1)
    return workspace


def keep(workspace: Workspace, clicks: list[Click]) -> None:
    """Add clicks to the log; what is clicked nowhere in a scene is not visible there."""
    there = {(click.keypoint, click.scene) for click in clicks}
    keypoints = range(len(workspace.load_annotation(OBJECT).keypoints))
    skips = [
        {"op": "skip", "keypoint": keypoint, "scene": scene}
        for scene in sorted({click.scene for click in clicks})
        for keypoint in keypoints
        if (keypoint, scene) not in there
    ]
    workspace.append_events(OBJECT, [*map(click_event, clicks), *skips])


def mark(page: Page, docs: Path, clicks: list[Click]) -> None:
    """Marking in the last scene, then a click on a wrong place and what the page says about it."""
    expect(page.locator("#scenes .good")).to_have_count(3, timeout=PATIENT_MS)
    page.locator("#scenes li").last.locator("button").click()
    expect(page.locator("#frame-text")).to_contain_text(f"scene {clicks[0].scene}")
    frames = [c.frame for c in clicks]
    frame = max(set(frames), key=frames.count)
    go_to(page, frame)
    here = [c for c in clicks if c.frame == frame]
    for click in here:
        select(page, click.keypoint)
        page.mouse.click(*on_page(page, click.u_px, click.v_px))
        saved(page)
    rest = [c for c in clicks if c.keypoint not in {h.keypoint for h in here}]
    aimed = rest[0]
    select(page, aimed.keypoint)
    go_to(page, aimed.frame)
    page.mouse.move(*on_page(page, aimed.u_px, aimed.v_px))
    picture(page, docs / "annotate_mark.jpg")
    more = list({c.keypoint: c for c in rest}.values())[:6]
    for click in more:
        select(page, click.keypoint)
        go_to(page, click.frame)
        page.mouse.click(*on_page(page, click.u_px, click.v_px))
        saved(page)
    wrong = more[0]
    select(page, wrong.keypoint)
    go_to(page, wrong.frame)
    page.mouse.move(*on_page(page, wrong.u_px, wrong.v_px))
    page.mouse.down()
    page.mouse.move(*on_page(page, wrong.u_px + 45, wrong.v_px + 20), steps=4)
    page.mouse.up()
    saved(page)
    expect(page.locator("#result .bad").first).to_be_visible(timeout=PATIENT_MS)
    picture(page, docs / "annotate_result.jpg")


def solid(page: Page, docs: Path) -> None:
    """The dense model among what every scene saw."""
    page.wait_for_selector(SHOWN)
    expect(page.locator("#scenes .good")).to_have_count(4, timeout=PATIENT_MS)
    page.locator("#job-label").click()
    expect(page.locator("#job-label")).to_be_disabled()
    expect(page.locator("#next-text")).to_contain_text("look through", timeout=PATIENT_MS)
    page.keyboard.press("v")
    page.wait_for_selector("#plot[data-drawn]")
    page.wait_for_function(
        "() => document.getElementById('plot').data.filter((t) => /^scene/.test(t.name)).length === 4"
    )
    picture(page, docs / "annotate_3d.jpg")


def labels(page: Page, docs: Path) -> None:
    """The contact sheet, before the export."""
    page.keyboard.press("g")
    page.wait_for_function(
        "() => [...document.querySelectorAll('#sheet img')].slice(0, 12).length === 12 &&"
        " [...document.querySelectorAll('#sheet img')].slice(0, 12).every((i) => i.naturalWidth)",
        timeout=PATIENT_MS,
    )
    picture(page, docs / "annotate_labels.jpg")


def select(page: Page, keypoint: int) -> None:
    page.locator("#keypoints li").nth(keypoint).locator("button").first.click()


def go_to(page: Page, frame: int) -> None:
    """Open a frame of the scene that is open, with the slider."""
    store = "const { app, rowOf } = await import('/static/state/store.js');"
    row = page.evaluate(f"async (frame) => {{ {store} return rowOf(app.scene, frame); }}", frame)
    page.locator("#scrub").fill(str(row))
    expect(page.locator("#picture")).to_have_attribute("data-frame", f"{scene_of(page)}/{frame}")


def scene_of(page: Page) -> str:
    return str(page.evaluate("async () => (await import('/static/state/store.js')).app.scene"))


def picture(page: Page, path: Path) -> None:
    wait_until(page, SETTLED, timeout_ms=PATIENT_MS)
    page.wait_for_timeout(1500)  # pictures and 3D that are still on their way
    page.screenshot(path=path, type="jpeg", quality=82)
    print(path, f"{path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
